// SPDX-License-Identifier: GPL-3.0-or-later
// Blends the Gaussians of every tile front to back into images. The formulas are at the top of the C kernels' blend.c.
#include "cuda/blend.cuh"

#include "raster/footprint.h"

enum { BATCH = 64 };  // records staged at a time: 8 kB

// What a pixel gathers.
struct Gathered {
    float t, color[3], depth, median, normal[3], m1, m2, first, distortion;
};

// Which warps of the tile at (ox, oy) the footprint touches, one bit each. In each of the four rows of warps the
// footprint spans one interval (footprint.h, tile_columns); a warp is 8 columns of it.
static inline unsigned warps_of(const float *g, float ox, float oy) {
    const float y = 0.5f * (g[REC_Y0] + g[REC_Y1]) - oy, half_y = 0.5f * (g[REC_Y1] - g[REC_Y0]);
    const float x = 0.5f * (g[REC_X0] + g[REC_X1]) - ox, margin = 0.02f + 1e-3f * sqrtf(g[REC_WIDTH2]);
    unsigned found = 0;
    for (int row = 0; row < TILE / WARP_HEIGHT; row++) {
        const float top = row * WARP_HEIGHT + 0.48f - y,
                    bottom = top + (WARP_HEIGHT - 0.96f);  // pixel centres, less the margin
        if (!(top < half_y && bottom > -half_y)) continue;
        const float yr = within(g[REC_Y_RIGHT], top, bottom), yl = within(-g[REC_Y_RIGHT], top, bottom);
        const float wr = g[REC_WIDTH2] - g[REC_FALL] * yr * yr, wl = g[REC_WIDTH2] - g[REC_FALL] * yl * yl;
        const float right = x + g[REC_SLOPE] * yr + sqrtf(wr > 0 ? wr : 0) + margin;
        const float left = x + g[REC_SLOPE] * yl - sqrtf(wl > 0 ? wl : 0) - margin;
        if (left <= WARP_WIDTH - 0.5f && right >= 0.5f) found |= 1u << (2 * row);
        if (left <= 2 * WARP_WIDTH - 0.5f && right >= WARP_WIDTH + 0.5f) found |= 2u << (2 * row);
    }
    return found;
}

// Adds one Gaussian to a pixel; returns whether the pixel took it.
template <int LEVEL>
static inline bool blend_pixel(Gathered &s, const float4 *record, float px, float py, const Camera *camera,
                               float map_scale) {
    const Staged g = take(record);
    const float dx = px - g.of[REC_CX], dy = py - g.of[REC_CY];
    const Response r = respond(g.of, dx, dy);
    if (!(r.power2 > g.of[REC_THRESHOLD])) return false;
    const float depth = response_depth(g.of, dx, dy, r.inv_a);
    if (!(depth > camera->near)) return false;
    const float free_a = g.of[REC_OPACITY] * fast_exp2(r.power2), a = free_a < ALPHA_MAX ? free_a : ALPHA_MAX;
    const float before = s.t, w = a * before, after = before - w;
    for (int c = 0; c < 3; c++) s.color[c] += w * g.of[REC_R + c];
    s.depth += w * depth;
    if (LEVEL >= LEVEL_ALL) {
        const float m = shifted_depth(fast_reciprocal(depth), before, &s.first, map_scale), wm = w * m;
        for (int c = 0; c < 3; c++) s.normal[c] += w * g.of[REC_NX + c];
        if (before > 0.5f && after <= 0.5f) s.median = depth;
        s.distortion += w * (m * (m * (1.0f - before) - 2.0f * s.m1) + s.m2);
        s.m1 += wm, s.m2 += wm * m;
    }
    s.t = after;
    return true;
}

template <int LEVEL> static inline void store_pixel(const Gathered &s, float *image, int64_t plane) {
    for (int c = 0; c < 3; c++) image[(OUT_R + c) * plane] = s.color[c];
    image[OUT_ALPHA * plane] = 1.0f - s.t, image[OUT_DEPTH * plane] = s.depth;
    if (LEVEL < LEVEL_ALL) return;
    image[OUT_MEDIAN * plane] = s.median, image[OUT_DISTORTION * plane] = s.distortion;
    for (int c = 0; c < 3; c++) image[(OUT_NX + c) * plane] = s.normal[c];
    image[OUT_M1 * plane] = s.m1, image[OUT_M2 * plane] = s.m2;
}

template <int LEVEL>
static inline void blend_tile(const Lists &lists, const Camera *camera, float *image, uint8_t *hits) {
    SHARED float4 staged[BATCH][FOURS];
    SHARED uint8_t touched[BATCH];      // warps that the footprint touches
    SHARED uint8_t took[BATCH][WARPS];  // warps in which a pixel took it
    SHARED int live[2];  // is any pixel not yet full? Two, used in turn: one is read while the other is cleared
    Own<Gathered> own;
    const int tile = BLOCK_X, start = lists.ranges[tile], end = lists.ranges[tile + 1];
    const int ox = tile % lists.tiles_x * TILE, oy = tile / lists.tiles_x * TILE;
    const float map_scale = camera->far * camera->near / (camera->far - camera->near);
    PHASE {
        const Gathered none = {};
        *own = none;
        own->t = inside_frame(camera, ox + pixel_x(), oy + pixel_y()) ? 1.0f : 0.0f;
        if (THREAD == 0) live[0] = live[1] = 0;
    }
    for (int first = start, turn = 0; first < end; first += BATCH, turn ^= 1) {
        const int count = end - first < BATCH ? end - first : BATCH;
        PHASE {
            stage_records(lists, first, count, staged);
            if (THREAD < count) {
                const float4 *record = lists.records + (int64_t)lists.gid[first + THREAD] * FOURS;
                touched[THREAD] = (uint8_t)warps_of((const float *)record, (float)ox, (float)oy);
                for (int w = 0; w < WARPS; w++) took[THREAD][w] = 0;
            }
        }
        PHASE {
            if (THREAD == 0) live[turn ^ 1] = 0;
            Gathered s = *own;
            const float px = (float)(ox + pixel_x()) + 0.5f, py = (float)(oy + pixel_y()) + 0.5f;
            for (int k = 0; k < count && s.t > T_STOP; k++)
                if ((touched[k] >> THIS_WARP & 1) && blend_pixel<LEVEL>(s, staged[k], px, py, camera, map_scale))
                    took[k][THIS_WARP] = 1;
            if (s.t > T_STOP) live[turn] = 1;
            *own = s;
        }
        PHASE {
            if (THREAD < count) {
                unsigned bits = 0;
                for (int w = 0; w < WARPS; w++) bits |= (unsigned)took[THREAD][w] << w;
                hits[lists.slots[first + THREAD]] = (uint8_t)bits;
            }
        }
        if (!live[turn]) break;  // hits of the rest are zero already
    }
    PHASE {
        const int64_t stride = (int64_t)lists.tiles_x * TILE, plane = (int64_t)lists.tiles * TILE * TILE;
        if (!inside_frame(camera, ox + pixel_x(), oy + pixel_y())) own->t = 1.0f;
        store_pixel<LEVEL>(*own, image + (oy + pixel_y()) * stride + ox + pixel_x(), plane);
    }
}

// image [OUT_PLANES or OUT_PLANES_BASIC, tiles_y * 16, tiles_x * 16]: every pixel of every tile is written. hits
// [slots], given as zeros: for every entry the warps in which it was blended, one bit each. grid: tiles.
KERNEL(blend_all, Lists lists, BY_VALUE Camera camera, float *image, uint8_t *hits) {
    blend_tile<LEVEL_ALL>(lists, &camera, image, hits);
}

KERNEL(blend_basic, Lists lists, BY_VALUE Camera camera, float *image, uint8_t *hits) {
    blend_tile<LEVEL_DEPTH>(lists, &camera, image, hits);
}
