// SPDX-License-Identifier: GPL-3.0-or-later
// What blending forward and backward share: a block is a tile of 16 x 16 pixels, a thread one pixel, a warp 8 x 4
// pixels. Records of the tile's list are staged in shared memory, some at a time; a warp looks only at Gaussians whose
// footprint meets its pixels.
#pragma once
#include "cuda/block.cuh"

#include "raster/blend_backward.h"
#include "raster/planes.h"
#include "raster/records.h"

enum { WARP_WIDTH = 8, WARP_HEIGHT = 4, FOURS = REC_SIZE / 4 };

// The thread's pixel inside the tile.
static inline int pixel_x() { return (THIS_WARP & 1) * WARP_WIDTH + (THREAD & 7); }
static inline int pixel_y() { return (THIS_WARP >> 1) * WARP_HEIGHT + (THIS_LANE >> 3); }

// The lists of all tiles and what is needed to blend them.
struct Lists {
    const float4 *records;  // [n, 8]
    const int *gid, *slots; // per entry
    const int *ranges;      // [tiles + 1]
    int tiles_x, tiles;
};

// The part of a record that blending reads, in registers: columns 0..REC_THRESHOLD.
union Staged {
    float4 four[6];
    float of[24];
};

static inline Staged take(const float4 *record) {
    Staged g;
    for (int f = 0; f < 6; f++) g.four[f] = record[f];
    return g;
}

// Copies `count` records of the list from entry `first` on; called by all threads in a phase, eight float4 a record.
static inline void stage_records(const Lists &lists, int first, int count, float4 (*staged)[FOURS]) {
    for (int f = THREAD; f < count * FOURS; f += BLOCK)
        staged[f / FOURS][f % FOURS] = lists.records[(int64_t)lists.gid[first + f / FOURS] * FOURS + f % FOURS];
}

// The response of one Gaussian at one pixel (records.h).
struct Response {
    float q, inv_a, power2;  // q, 1 / A, power * log2(e) <= 0
};

static inline Response respond(const float *g, float dx, float dy) {
    Response r;
    r.q = (g[REC_Q0] * dx + 2.0f * g[REC_Q1] * dy) * dx + g[REC_Q2] * dy * dy;
    const float a =
        (g[REC_A3] * dx + (2.0f * g[REC_A4] * dy + g[REC_A1])) * dx + (1.0f + (g[REC_A2] + g[REC_A5] * dy) * dy);
    r.inv_a = fast_reciprocal(a > 1e-12f ? a : 1e-12f);
    r.power2 = (-0.5f * LOG2_E) * r.q * r.inv_a;
    r.power2 = r.power2 < 0.0f ? r.power2 : 0.0f;
    return r;
}

// t* = B / A
static inline float response_depth(const float *g, float dx, float dy, float inv_a) {
    return (g[REC_B1] * dx + (g[REC_B0] + g[REC_B2] * dy)) * inv_a;
}

// Mapped depth less that of the first Gaussian that the pixel took; see the C kernels' blend.h for why.
static inline float shifted_depth(float inv_t, float before, float *first, float scale) {
    if (before >= 1.0f) *first = inv_t;
    return scale * (*first - inv_t);
}

// Is the pixel inside the frame? Those outside are full from the start.
static inline bool inside_frame(const Camera *camera, int x, int y) {
    return x < (int)camera->width && y < (int)camera->height;
}
