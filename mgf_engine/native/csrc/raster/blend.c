// SPDX-License-Identifier: GPL-3.0-or-later
// Blends the Gaussians of every tile front to back into images. docs/kernels.md explains this file step by step.
//
// With transmittance T (1 at first) and alpha a of each Gaussian in turn, its weight is w = a T, then T <- T - w:
//     colour = sum w c,  alpha = 1 - T,  depth = sum w t*,  normal = sum w n,
//     median = the t* at which T passes 1/2 (0 when it never does),
//     distortion = sum over pairs i < j of w_i w_j (m_i - m_j)^2,  m = far / (far - near) (1 - near / t*).
// With M1 = sum w m and M2 = sum w m^2 over the Gaussians before i (their weights sum to 1 - T), the pairs that end at
// i add
//     w_i (m_i^2 (1 - T) - 2 m_i M1 + M2).
// Only differences of m matter, so each pixel's m is taken relative to that of the first Gaussian it takes
// (shifted_depth).
#include "raster/blend.h"
#include "common/export.h"

// What a block has gathered, a vector per output plane (planes.h); transmittance instead of alpha until the tile is
// done. Blocks one after the other: planes one after the other would lie 4 kB apart, where processors mix up what was
// just stored.
typedef struct {
    v16 of[OUT_PLANES], first;
} Block;

enum { HIT = 1, FULL = 2 };

// Adds one Gaussian to one block: 0 when no pixel took it, else HIT, and FULL with it when no pixel takes more.
INLINE int blend_block(Block *s, const float *g, v16 dx, v16 dy, const Camera *camera, float map_scale,
                       const int level) {
    const Response r = respond(g, dx, dy);
    const v16 before = s->of[OUT_ALPHA];
    const v16 t_star = response_depth(g, dx, dy, r.inv_a);
    const i16 taken = (r.power2 > g[REC_THRESHOLD]) & (before > T_STOP) & (t_star > camera->near);
    if (!any(taken)) return 0;
    const v16 a = vmin(g[REC_OPACITY] * exp2_16(r.power2), splat(ALPHA_MAX));
    const v16 w = keep(taken, a * before);
    const v16 after = before - w;
    const v16 depth = choose(taken, t_star, splat(camera->near));  // finite in every lane
    for (int c = 0; c < 3; c++) s->of[OUT_R + c] += w * g[REC_R + c];
    s->of[OUT_DEPTH] += w * depth;
    if (level >= LEVEL_ALL) {
        const v16 m = shifted_depth(reciprocal(depth), before, &s->first, map_scale);
        const v16 wm = w * m;
        for (int c = 0; c < 3; c++) s->of[OUT_NX + c] += w * g[REC_NX + c];
        s->of[OUT_MEDIAN] = choose((before > 0.5f) & (after <= 0.5f), depth, s->of[OUT_MEDIAN]);
        s->of[OUT_DISTORTION] += w * (m * (m * (1.0f - before) - 2.0f * s->of[OUT_M1]) + s->of[OUT_M2]);
        s->of[OUT_M1] += wm, s->of[OUT_M2] += wm * m;
    }
    s->of[OUT_ALPHA] = after;
    return any(after > T_STOP) ? HIT : HIT | FULL;
}

// One plane of a tile, block by block in memory, row by row in the image.
INLINE void store_plane(const Block *blocks, int of, float *plane, int64_t stride) {
    for (int b = 0; b < BLOCKS; b++)
        for (int row = 0; row < 4; row++)
            memcpy(plane + ((b >> 2) * 4 + row) * stride + (b & 3) * 4, (const float *)(blocks[b].of + of) + 4 * row,
                   4 * sizeof(float));
}

INLINE void blend_tile(int64_t tile, const Camera *camera, const float *records, const int32_t *gid,
                       const int32_t *slots, const int32_t *ranges, int64_t tiles_x, float *image, int64_t plane,
                       uint16_t *hits, const int level) {
    const float ox = (float)(tile % tiles_x) * TILE, oy = (float)(tile / tiles_x) * TILE;
    const float map_scale = camera->far * camera->near / (camera->far - camera->near);
    Block blocks[BLOCKS];
    memset(blocks, 0, sizeof blocks);
    uint32_t live = 0;
    for (int b = 0; b < BLOCKS; b++) {  // pixels outside the frame are full from the start
        const i16 inside = (COLUMN_X[b & 3] + ox < camera->width) & (ROW_Y[b >> 2] + oy < camera->height);
        blocks[b].of[OUT_ALPHA] = keep(inside, splat(1.0f));
        if (any(inside)) live |= 1u << b;
    }
    int32_t k = ranges[tile];
    const int32_t end = ranges[tile + 1];
    uint32_t coming =
        k < end ? blocks_of(records + (int64_t)gid[k] * REC_SIZE, ox, oy) : 0;  // the next Gaussian's, ahead of time
    for (; k < end && live; k++) {
        const float *g = records + (int64_t)gid[k] * REC_SIZE;
        prefetch_record(records, gid, k, end);
        const uint32_t touched = coming;
        if (k + 1 < end) coming = blocks_of(records + (int64_t)gid[k + 1] * REC_SIZE, ox, oy);
        const float x = ox - g[REC_CX], y = oy - g[REC_CY];
        uint32_t hit = 0;
        for (uint32_t todo = touched & live; todo; todo &= todo - 1) {
            const int b = __builtin_ctz(todo);
            const v16 dx = COLUMN_X[b & 3] + x, dy = ROW_Y[b >> 2] + y;
            const int did = blend_block(blocks + b, g, dx, dy, camera, map_scale, level);
            hit |= (uint32_t)(did & HIT) << b;
            if (did & FULL) live &= ~(1u << b);
        }
        hits[slots[k]] = (uint16_t)hit;
    }
    for (; k < end; k++) hits[slots[k]] = 0;
    const int64_t stride = tiles_x * TILE;
    float *corner = image + (tile / tiles_x) * TILE * stride + (tile % tiles_x) * TILE;
    for (int b = 0; b < BLOCKS; b++) blocks[b].of[OUT_ALPHA] = 1.0f - blocks[b].of[OUT_ALPHA];
    const int planes = level < LEVEL_ALL ? OUT_PLANES_BASIC : OUT_PLANES;
    for (int of = 0; of < planes; of++) store_plane(blocks, of, corner + of * plane, stride);
}

// image [OUT_PLANES or OUT_PLANES_BASIC, tiles_y * 16, tiles_x * 16]: every pixel of every tile is written.
// hits [slots]: for every entry of the lists the blocks in which it was blended, one bit each.
MGF_API void mgf_blend(int32_t *next, int64_t tiles, const Camera *camera, const float *records, const int32_t *gid,
                       const int32_t *slots, const int32_t *ranges, int64_t tiles_x, int64_t geometry, float *image,
                       uint16_t *hits) {
    const int64_t plane = tiles * TILE * TILE;
    for (int64_t tile; (tile = take_work(next)) < tiles;) {
        if (geometry)
            blend_tile(tile, camera, records, gid, slots, ranges, tiles_x, image, plane, hits, LEVEL_ALL);
        else
            blend_tile(tile, camera, records, gid, slots, ranges, tiles_x, image, plane, hits, LEVEL_DEPTH);
    }
}
