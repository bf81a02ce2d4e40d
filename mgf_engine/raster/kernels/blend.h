// SPDX-License-Identifier: GPL-3.0-or-later
// What blending forward and backward share: 4 x 4 pixel blocks, the response of one Gaussian in a block, image planes.
#pragma once
#include <string.h>

#include "records.h"
#include "vector.h"

// Planes of the image buffer. In an image without geometry only the first five exist.
enum {
    OUT_R, OUT_G, OUT_B, OUT_ALPHA, OUT_DEPTH, OUT_MEDIAN, OUT_NX, OUT_NY, OUT_NZ, OUT_DISTORTION,
    OUT_M1, OUT_M2,        // sum w m, sum w m^2 of the shifted mapped depth m (blend.c): kept for the backward pass
    OUT_PLANES,
    OUT_PLANES_BASIC = OUT_DEPTH + 1,
};

// Which outputs take part: colour and alpha; those and depth; everything.
enum { LEVEL_COLOUR, LEVEL_DEPTH, LEVEL_ALL };

enum { BLOCKS = 16 };      // a tile is 4 x 4 blocks of 4 x 4 pixels; a block is one v16, row by row

// Pixel centres of a block relative to its corner.
static const v16 BLOCK_X = {.5f, 1.5f, 2.5f, 3.5f, .5f, 1.5f, 2.5f, 3.5f, .5f, 1.5f, 2.5f, 3.5f, .5f, 1.5f, 2.5f, 3.5f};
static const v16 BLOCK_Y = {.5f, .5f, .5f, .5f, 1.5f, 1.5f, 1.5f, 1.5f, 2.5f, 2.5f, 2.5f, 2.5f, 3.5f, 3.5f, 3.5f, 3.5f};

#define INLINE static inline __attribute__((always_inline))

// The response of one Gaussian in the sixteen pixels of a block (records.h).
typedef struct {
    v16 q, inv_a;          // q and 1 / A
    v16 power2;            // power * log2(e) <= 0
} Response;

INLINE Response respond(const float *g, v16 dx, v16 dy) {
    Response r;
    r.q = (g[REC_Q0] * dx + 2.0f * g[REC_Q1] * dy) * dx + g[REC_Q2] * dy * dy;
    const v16 a = (g[REC_A3] * dx + (2.0f * g[REC_A4] * dy + g[REC_A1])) * dx + (1.0f + (g[REC_A2] + g[REC_A5] * dy) * dy);
    r.inv_a = reciprocal(vmax(a, splat(1e-12f)));
    r.power2 = vmin(splat(0.0f), (-0.5f * LOG2_E) * r.q * r.inv_a);
    return r;
}

// t* = B / A
INLINE v16 response_depth(const float *g, v16 dx, v16 dy, v16 inv_a) {
    return (g[REC_B1] * dx + (g[REC_B0] + g[REC_B2] * dy)) * inv_a;
}

// Mapped depth far / (far - near) (1 - near / t), less that of the first Gaussian that the pixel took (where *first, its 1 / t, is
// set when nothing was taken before). Distortion only needs differences, and these are small against the mapped depth itself:
// without the shift, surfaces closer than some 1e-2 of their depth would be lost in float32. scale = far near / (far - near).
INLINE v16 shifted_depth(v16 inv_t, v16 before, v16 *first, float scale) {
    *first = choose(before >= 1.0f, inv_t, *first);
    return scale * (*first - inv_t);
}

// Blocks of the tile at (ox, oy) that the extents of the footprint overlap, one bit each, row by row.
INLINE uint32_t blocks_of(const float *g, float ox, float oy) {
    int x0 = (int)__builtin_floorf(g[REC_X0] - ox), x1 = (int)__builtin_floorf(g[REC_X1] - ox);
    int y0 = (int)__builtin_floorf(g[REC_Y0] - oy), y1 = (int)__builtin_floorf(g[REC_Y1] - oy);
    if (x1 < 0 || y1 < 0 || x0 > TILE - 1 || y0 > TILE - 1) return 0;
    x0 = x0 < 0 ? 0 : x0 >> 2, x1 = x1 > TILE - 1 ? 3 : x1 >> 2;
    y0 = y0 < 0 ? 0 : y0 >> 2, y1 = y1 > TILE - 1 ? 3 : y1 >> 2;
    const uint32_t columns = ((2u << x1) - (1u << x0)) * 0x1111u, rows = (16u << (4 * y1)) - (1u << (4 * y0));
    return columns & rows;
}

// Records that come soon are fetched while the present one is blended.
INLINE void prefetch_record(const float *records, const int32_t *gid, int32_t k, int32_t end) {
    enum { AHEAD = 6 };
    if (k + AHEAD >= end) return;
    const float *g = records + (int64_t)gid[k + AHEAD] * REC_SIZE;
    __builtin_prefetch(g);
    __builtin_prefetch(g + 16);
}
