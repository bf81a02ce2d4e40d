// SPDX-License-Identifier: GPL-3.0-or-later
// What the processor can do at best, to compare the kernels with: multiply-adds on registers alone.
#include "common/export.h"
#include "common/vector.h"

// Sixteen chains hide the latency of a multiply-add on every processor; fewer vectors than registers stay in them.
#if defined(__AVX512F__)
enum { CHAINS = 16 };
#else
enum { CHAINS = 4 };  // a v16 is several registers here
#endif

// Each piece of work is 2^16 rounds of one multiply-add per chain; result [1] keeps the compiler from leaving them out.
MGF_API void mgf_peak(int32_t *next, int64_t pieces, float *result) {
    v16 x[CHAINS];
    for (int c = 0; c < CHAINS; c++) x[c] = splat(1.0f + 1e-3f * c);
    const v16 scale = splat(0.9999f), step = splat(1e-4f);
    while (take_work(next) < pieces)
        for (int round = 0; round < 1 << 16; round++)
            for (int c = 0; c < CHAINS; c++) x[c] = x[c] * scale + step;
    v16 sum = splat(0.0f);
    for (int c = 0; c < CHAINS; c++) sum += x[c];
    *result = sum[0];
}

// Operations per piece of work; a multiply-add counts as two.
MGF_API int64_t mgf_peak_operations(void) { return (int64_t)2 * VECTOR * CHAINS << 16; }
