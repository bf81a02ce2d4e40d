// SPDX-License-Identifier: GPL-3.0-or-later
// Sixteen floats at once, on every processor: clang's vector extensions plus the few operations they lack.
//
// A v16 is one AVX-512 register, two AVX registers, or four SSE or NEON registers; the arithmetic below is written
// once and the compiler splits it. Comparisons give an i16 whose lanes are all ones (true) or zero.
//
// NaN rules that the kernels rely on: vmin(a, b) and vmax(a, b) return b when a or b is NaN; a comparison with NaN is
// false.
//
// Built as C++ or CUDA, a "vector" is one float instead (cuda/lane.h).
#pragma once
#if defined(__cplusplus)
#include "cuda/lane.h"
#else
#include <stdint.h>
#if defined(__x86_64__)
#include <immintrin.h>
#elif defined(__ARM_NEON)
#include <arm_neon.h>
#endif

typedef float v16 __attribute__((vector_size(64), aligned(64)));
typedef int32_t i16 __attribute__((vector_size(64), aligned(64)));
enum { VECTOR = 16 };  // lanes

static inline v16 splat(float x) { return (v16){x, x, x, x, x, x, x, x, x, x, x, x, x, x, x, x}; }

// A vector anywhere in memory. (memcpy comes out in two halves, which are not at hand as a whole right after.)
typedef float loose16 __attribute__((vector_size(64), aligned(4)));
static inline v16 load16(const float *from) { return *(const loose16 *)from; }
static inline void store16(float *to, v16 x) { *(loose16 *)to = x; }

// Lanes of a where m is true, else of b.
static inline v16 choose(i16 m, v16 a, v16 b) { return (v16)((m & (i16)a) | (~m & (i16)b)); }

// Lanes of a where m is true, else 0 (whatever a holds there, NaN included).
static inline v16 keep(i16 m, v16 a) { return (v16)(m & (i16)a); }

// Is any lane true?
static inline int any(i16 m) {
#if defined(__AVX512F__)
    return _mm512_test_epi32_mask((__m512i)m, (__m512i)m) != 0;
#elif defined(__AVX2__)
    const __m256i *h = (const __m256i *)&m;
    const __m256i both = _mm256_or_si256(h[0], h[1]);
    return !_mm256_testz_si256(both, both);
#elif defined(__x86_64__)
    const __m128i *q = (const __m128i *)&m;
    return _mm_movemask_epi8(_mm_or_si128(_mm_or_si128(q[0], q[1]), _mm_or_si128(q[2], q[3]))) != 0;
#elif defined(__ARM_NEON)
    const uint32x4_t *q = (const uint32x4_t *)&m;
    return vmaxvq_u32(vorrq_u32(vorrq_u32(q[0], q[1]), vorrq_u32(q[2], q[3]))) != 0;
#else
    int32_t r = 0;
    for (int i = 0; i < 16; i++) r |= m[i];
    return r != 0;
#endif
}

#if defined(__AVX512F__)
static inline v16 vmin(v16 a, v16 b) { return (v16)_mm512_min_ps((__m512)a, (__m512)b); }
static inline v16 vmax(v16 a, v16 b) { return (v16)_mm512_max_ps((__m512)a, (__m512)b); }
#else
static inline v16 vmin(v16 a, v16 b) { return choose(a < b, a, b); }
static inline v16 vmax(v16 a, v16 b) { return choose(a > b, a, b); }
#endif

// Lane i = the word a[at[i]], whatever it stands for.
static inline i16 gather(const void *a, i16 at) {
#if defined(__AVX512F__)
    return (i16)_mm512_i32gather_epi32((__m512i)at, a, 4);
#else
    i16 r;
    for (int i = 0; i < 16; i++) r[i] = ((const int32_t *)a)[at[i]];
    return r;
#endif
}

static inline v16 vsqrt(v16 x) {
#if defined(__AVX512F__)
    return (v16)_mm512_sqrt_ps((__m512)x);
#else
    for (int i = 0; i < 16; i++) x[i] = __builtin_sqrtf(x[i]);
    return x;
#endif
}

// Sixteen doubles: for the few sums that float32 cannot hold.
typedef double d16 __attribute__((vector_size(128), aligned(128)));
static inline d16 widen(v16 x) { return __builtin_convertvector(x, d16); }
static inline v16 narrow(d16 x) { return __builtin_convertvector(x, v16); }
static inline d16 dsqrt(d16 x) {
    for (int i = 0; i < 16; i++) x[i] = __builtin_sqrt(x[i]);
    return x;
}

// 1/x to about 1e-7 for normal x (not for 0, infinity or subnormals). With AVX-512 an estimate and one Newton step;
// with AVX2 the same measured slower than the division.
static inline v16 reciprocal(v16 x) {
#if defined(__AVX512F__)
    const v16 r = (v16)_mm512_rcp14_ps((__m512)x);
    return r * (2.0f - x * r);
#else
    return 1.0f / x;
#endif
}

// 2^x for x in [-126, 127] (smaller x gives 2^-126), relative error 2e-7: 2^x = 2^i 2^f with i = round(x), and a
// polynomial of degree 5 (minimax on |f| <= 1/2) for 2^f.
static inline v16 exp2_16(v16 x) {
    x = vmax(x, splat(-126.0f));
#if defined(__AVX512F__)
    const v16 i = (v16)_mm512_roundscale_ps((__m512)x, _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC);
#else
    const v16 i = (x + 12582912.0f) - 12582912.0f;  // adding 1.5 * 2^23 rounds to a whole number
#endif
    const v16 f = x - i;
    v16 p = splat(1.3534167e-3f);
    p = p * f + 9.6184373e-3f;
    p = p * f + 5.5503324e-2f;
    p = p * f + 2.4022651e-1f;
    p = p * f + 6.9314718e-1f;
    p = p * f + 1.0f;
#if defined(__AVX512F__)
    return (v16)_mm512_scalef_ps((__m512)p, (__m512)i);
#else
    return (v16)((i16)p + (__builtin_convertvector(i, i16) << 23));  // add i to the exponent bits
#endif
}

// Which lanes of two vectors make up a third: for sums and turns of sixteen vectors at a time (rows.h).
#define LOW_PAIRS 0, 16, 1, 17, 4, 20, 5, 21, 8, 24, 9, 25, 12, 28, 13, 29
#define HIGH_PAIRS 2, 18, 3, 19, 6, 22, 7, 23, 10, 26, 11, 27, 14, 30, 15, 31
#define LOW_QUADS 0, 1, 16, 17, 4, 5, 20, 21, 8, 9, 24, 25, 12, 13, 28, 29
#define HIGH_QUADS 2, 3, 18, 19, 6, 7, 22, 23, 10, 11, 26, 27, 14, 15, 30, 31
#define LOW_HALVES 0, 1, 2, 3, 4, 5, 6, 7, 16, 17, 18, 19, 20, 21, 22, 23
#define HIGH_HALVES 8, 9, 10, 11, 12, 13, 14, 15, 24, 25, 26, 27, 28, 29, 30, 31
#define EVEN_QUARTERS 0, 1, 2, 3, 8, 9, 10, 11, 16, 17, 18, 19, 24, 25, 26, 27
#define ODD_QUARTERS 4, 5, 6, 7, 12, 13, 14, 15, 20, 21, 22, 23, 28, 29, 30, 31

// Adds neighbours of two vectors inside each group of four lanes: (a0+a2, b0+b2, a1+a3, b1+b3).
static inline v16 fold_pairs(v16 a, v16 b) {
    return __builtin_shufflevector(a, b, LOW_PAIRS) + __builtin_shufflevector(a, b, HIGH_PAIRS);
}

// Of two results of fold_pairs: in each group of four lanes the sums over that group of the four vectors behind them.
static inline v16 fold_quads(v16 ab, v16 cd) {
    return __builtin_shufflevector(ab, cd, LOW_QUADS) + __builtin_shufflevector(ab, cd, HIGH_QUADS);
}

// Sums of the four vectors in each group of four lanes; group g holds the part of the sum that comes from lanes
// 4g..4g+3.
static inline v16 partial_sums4(const v16 *a) { return fold_quads(fold_pairs(a[0], a[1]), fold_pairs(a[2], a[3])); }

// Lane i = the sum of the lanes of a[i]: sixteen sums for the price of five.
static inline v16 sums16(const v16 *a) {
    const v16 x0 = partial_sums4(a), x1 = partial_sums4(a + 4), x2 = partial_sums4(a + 8), x3 = partial_sums4(a + 12);
    const v16 y0 = __builtin_shufflevector(x0, x1, LOW_HALVES) + __builtin_shufflevector(x0, x1, HIGH_HALVES);
    const v16 y1 = __builtin_shufflevector(x2, x3, LOW_HALVES) + __builtin_shufflevector(x2, x3, HIGH_HALVES);
    return __builtin_shufflevector(y0, y1, EVEN_QUARTERS) + __builtin_shufflevector(y0, y1, ODD_QUARTERS);
}

// out[i] = the sum of the lanes of a[i], for eight vectors.
static inline void sums8(const v16 *a, float *out) {
    const v16 x0 = partial_sums4(a), x1 = partial_sums4(a + 4);
    const v16 y = __builtin_shufflevector(x0, x1, LOW_HALVES) + __builtin_shufflevector(x0, x1, HIGH_HALVES);
    for (int i = 0; i < 4; i++) out[i] = y[i] + y[i + 4], out[i + 4] = y[i + 8] + y[i + 12];
}
#endif  // __cplusplus
