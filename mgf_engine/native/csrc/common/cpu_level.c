// SPDX-License-Identifier: GPL-3.0-or-later
// Which variant of this library the processor can run. Called from the baseline variant, before any other is loaded.
#include "common/export.h"

#if defined(__x86_64__)
#include <cpuid.h>

// Vector registers the operating system saves on a task switch (the XCR0 register).
static uint64_t saved_registers(void) {
    uint32_t low, high;
    __asm__ volatile("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
    return ((uint64_t)high << 32) | low;
}

// Level of the x86-64 microarchitecture ABI: 4 (AVX-512 F, BW, CD, DQ, VL), 3 (AVX2, FMA, BMI, F16C, MOVBE), else 1.
MGF_API int64_t mgf_cpu_level(void) {
    const uint32_t leaf1 =
        (1u << 12) | (1u << 22) | (1u << 27) | (1u << 28) | (1u << 29);  // FMA MOVBE OSXSAVE AVX F16C
    const uint32_t leaf7_v3 = (1u << 3) | (1u << 5) | (1u << 8);                             // BMI1 AVX2 BMI2
    const uint32_t leaf7_v4 = (1u << 16) | (1u << 17) | (1u << 28) | (1u << 30) | (1u << 31);  // F DQ CD BW VL
    uint32_t a, b, c, d;
    if (!__get_cpuid(1, &a, &b, &c, &d) || (c & leaf1) != leaf1) return 1;
    if ((saved_registers() & 0x6) != 0x6) return 1;
    if (!__get_cpuid_count(7, 0, &a, &b, &c, &d) || (b & leaf7_v3) != leaf7_v3) return 1;
    if ((b & leaf7_v4) != leaf7_v4 || (saved_registers() & 0xe6) != 0xe6) return 3;
    return 4;
}
#else
MGF_API int64_t mgf_cpu_level(void) { return 1; }
#endif
