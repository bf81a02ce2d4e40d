// SPDX-License-Identifier: GPL-3.0-or-later
// What blending forward and backward share: 4 x 4 pixel blocks, the response of one Gaussian in a block.
#pragma once
#include <string.h>

#include "raster/planes.h"
#include "raster/records.h"
#include "common/vector.h"

enum { BLOCKS = 16 };      // a tile is 4 x 4 blocks of 4 x 4 pixels; a block is one v16, row by row

// Pixel centres relative to the tile's corner: x in the four columns of blocks, y in the four rows.
#define PIXELS_X(c) {c + .5f, c + 1.5f, c + 2.5f, c + 3.5f, c + .5f, c + 1.5f, c + 2.5f, c + 3.5f, \
                     c + .5f, c + 1.5f, c + 2.5f, c + 3.5f, c + .5f, c + 1.5f, c + 2.5f, c + 3.5f}
#define PIXELS_Y(c) {c + .5f, c + .5f, c + .5f, c + .5f, c + 1.5f, c + 1.5f, c + 1.5f, c + 1.5f, \
                     c + 2.5f, c + 2.5f, c + 2.5f, c + 2.5f, c + 3.5f, c + 3.5f, c + 3.5f, c + 3.5f}
static const v16 COLUMN_X[4] = {PIXELS_X(0), PIXELS_X(4), PIXELS_X(8), PIXELS_X(12)};
static const v16 ROW_Y[4] = {PIXELS_Y(0), PIXELS_Y(4), PIXELS_Y(8), PIXELS_Y(12)};

#define INLINE static inline __attribute__((always_inline))

// Has what a pointer points to read again from here on. A loop over the blocks would else keep two dozen copies of a
// record's floats, spread out to vectors, for which there are no registers; instructions take a float of memory for all
// lanes at no cost.
#define READ_ANEW(pointer) __asm__("" : "+r"(pointer))

// The response of one Gaussian in the sixteen pixels of a block (records.h).
typedef struct {
    v16 q, inv_a;          // q and 1 / A
    v16 power2;            // power * log2(e) <= 0
} Response;

INLINE Response respond(const float *g, v16 dx, v16 dy) {
    Response r;
    r.q = (g[REC_Q0] * dx + 2.0f * g[REC_Q1] * dy) * dx + g[REC_Q2] * dy * dy;
    const v16 a =
        (g[REC_A3] * dx + (2.0f * g[REC_A4] * dy + g[REC_A1])) * dx + (1.0f + (g[REC_A2] + g[REC_A5] * dy) * dy);
    r.inv_a = reciprocal(vmax(a, splat(1e-12f)));
    r.power2 = vmin(splat(0.0f), (-0.5f * LOG2_E) * r.q * r.inv_a);
    return r;
}

// t* = B / A
INLINE v16 response_depth(const float *g, v16 dx, v16 dy, v16 inv_a) {
    return (g[REC_B1] * dx + (g[REC_B0] + g[REC_B2] * dy)) * inv_a;
}

// Mapped depth far / (far - near) (1 - near / t), less that of the first Gaussian that the pixel took (where *first,
// its 1 / t, is set when nothing was taken before). Distortion only needs differences, and these are small against the
// mapped depth itself: without the shift, surfaces closer than some 1e-2 of their depth would be lost in float32. scale
// = far near / (far - near).
INLINE v16 shifted_depth(v16 inv_t, v16 before, v16 *first, float scale) {
    *first = choose(before >= 1.0f, inv_t, *first);
    return scale * (*first - inv_t);
}

typedef float v8 __attribute__((vector_size(32), aligned(32)));
typedef int32_t i8 __attribute__((vector_size(32), aligned(32)));

INLINE v8 choose8(i8 m, v8 a, v8 b) { return (v8)((m & (i8)a) | (~m & (i8)b)); }
INLINE v8 limit8(v8 x, v8 low, v8 high) {
    x = choose8(x > low, x, low);
    return choose8(x < high, x, high);
}
INLINE v8 sqrt8(v8 x) {
#if defined(__AVX2__)
    return (v8)_mm256_sqrt_ps((__m256)x);
#else
    for (int i = 0; i < 8; i++) x[i] = __builtin_sqrtf(x[i]);
    return x;
#endif
}
INLINE v8 floor8(v8 x) {
#if defined(__AVX2__)
    return (v8)_mm256_floor_ps((__m256)x);
#else
    for (int i = 0; i < 8; i++) x[i] = __builtin_floorf(x[i]);
    return x;
#endif
}

// Blocks of the tile at (ox, oy) that the footprint touches, one bit each, row by row. The footprint spans one interval
// of columns in each of the four rows of blocks (footprint.h, tile_columns): lanes 0-3 find its right end, lanes 4-7
// its left.
INLINE uint32_t blocks_of(const float *g, float ox, float oy) {
    const float y = 0.5f * (g[REC_Y0] + g[REC_Y1]) - oy, half_y = 0.5f * (g[REC_Y1] - g[REC_Y0]);
    const float x = 0.5f * (g[REC_X0] + g[REC_X1]) - ox;
    const v8 side = {1, 1, 1, 1, -1, -1, -1, -1};
    const v8 top = (v8){.48f, 4.48f, 8.48f, 12.48f, .48f, 4.48f, 8.48f, 12.48f} - y;  // half a pixel less the margin
    const v8 bottom = top + 3.04f;
    const i8 inside = (top < half_y) & (bottom > -half_y);
    const v8 at = limit8(side * g[REC_Y_RIGHT], top, bottom);
    const v8 square = g[REC_WIDTH2] - g[REC_FALL] * at * at;
    const v8 reach = sqrt8(choose8(square > 0.0f, square, (v8){0})) + (0.02f + 1e-3f * __builtin_sqrtf(g[REC_WIDTH2]));
    // right: last column = floor((end - 0.5) / 4); left: first column = ceil((end - 3.5) / 4) = floor((end - 0.5 + 0.25
    // - ..) / 4)
    const v8 end = x + g[REC_SLOPE] * at + side * reach;
    v8 column = floor8(side * (0.25f * end - (v8){.125f, .125f, .125f, .125f, .875f, .875f, .875f, .875f}));
    column = limit8(side * column + (v8){1, 1, 1, 1, 0, 0, 0, 0}, (v8){0}, (v8){4, 4, 4, 4, 4, 4, 4, 4});
    const i8 bits = (((i8){1, 1, 1, 1, 1, 1, 1, 1} << __builtin_convertvector(column, i8)) & inside)
                    << (i8){0, 4, 8, 12, 0, 4, 8, 12};
    return (uint32_t)((bits[0] - bits[4]) + (bits[1] - bits[5]) + (bits[2] - bits[6]) + (bits[3] - bits[7]));
}

// Records that come soon are fetched while the present one is blended.
INLINE void prefetch_record(const float *records, const int32_t *gid, int32_t k, int32_t end) {
    enum { AHEAD = 6 };
    if (k + AHEAD >= end) return;
    const float *g = records + (int64_t)gid[k + AHEAD] * REC_SIZE;
    __builtin_prefetch(g);
    __builtin_prefetch(g + 16);
}
