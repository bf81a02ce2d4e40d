// SPDX-License-Identifier: GPL-3.0-or-later
// Gradients of blending, again front to back, from the final images alone. The formulas are at the top of the C
// kernels' blend_backward.c.
//
// Each entry of a list gets the sums of up to 24 numbers over the pixels that it touched. A warp adds its 32 pixels by
// shuffles (sum_columns), and leaves one row of sums per entry in shared memory; then the block adds the rows of its
// warps in order and writes them to the entry's slot. No atomics: the same input gives the same bits.
#include "cuda/blend.cuh"

enum { BATCH = 32 };  // entries at a time: 4 kB of records and 24 kB of sums

// Gradients of the images, [.., height, width] without padding; null where there is none.
struct ImageGradients {
    const float *color, *alpha, *depth, *median, *normal, *distortion, *error;
};

// What the backward pass needs to know of a pixel.
struct Pixel {
    float t, rest;               // transmittance, R
    float color[3], fixed;      // gc; the part of G that is the same for every Gaussian
    float depth, median, normal[3];
    float md2, md1, first;       // gx W, 2 gx M1, as in shifted_depth
    float error;
};

static inline float value_of(const float *plane, int64_t at) { return plane ? plane[at] : 0.0f; }

// The pixel's gradients, at `at` in images of `size` pixels, and its final values, image + c * plane.
template <int LEVEL, bool STATS>
static inline void load_pixel(Pixel &s, const ImageGradients &in, int64_t at, int64_t size, const float *image,
                              int64_t plane) {
    const float alpha = image[OUT_ALPHA * plane];
    s.t = 1.0f, s.first = 0.0f;
    s.fixed = value_of(in.alpha, at), s.rest = s.fixed * alpha;
    for (int c = 0; c < 3; c++) {
        s.color[c] = value_of(in.color, at + c * size);
        s.rest += s.color[c] * image[(OUT_R + c) * plane];
    }
    if (STATS) s.error = value_of(in.error, at);
    if (LEVEL >= LEVEL_DEPTH) {
        s.depth = value_of(in.depth, at);
        s.rest += s.depth * image[OUT_DEPTH * plane];
    }
    if (LEVEL < LEVEL_ALL) return;
    for (int c = 0; c < 3; c++) {
        s.normal[c] = value_of(in.normal, at + c * size);
        s.rest += s.normal[c] * image[(OUT_NX + c) * plane];
    }
    s.median = value_of(in.median, at);
    const float distortion = value_of(in.distortion, at), m1 = image[OUT_M1 * plane], m2 = image[OUT_M2 * plane];
    s.md2 = distortion * alpha, s.md1 = 2.0f * distortion * m1;
    s.fixed += distortion * m2;
    s.rest += 2.0f * distortion * (m2 * alpha - m1 * m1);
}

// What one Gaussian gets from one pixel; sum: COUNT numbers given as zeros.
template <int LEVEL, bool STATS, int COUNT>
static inline void differentiate_pixel(Pixel &s, const float *g, float dx, float dy, const Camera *camera,
                                       float map_scale, Sums<COUNT> &to) {
    float *sum = to.of;
    const Response r = respond(g, dx, dy);
    const float before = s.t, depth = response_depth(g, dx, dy, r.inv_a);
    if (!(r.power2 > g[REC_THRESHOLD] && before > T_STOP && depth > camera->near)) return;
    const float free_a = g[REC_OPACITY] * fast_exp2(r.power2), a = free_a < ALPHA_MAX ? free_a : ALPHA_MAX;
    const float w = a * before, after = before - w;
    float gw = s.fixed, gt = 0.0f;
    for (int c = 0; c < 3; c++) {
        gw += s.color[c] * g[REC_R + c];
        sum[SUM_R + c] = w * s.color[c];
    }
    if (LEVEL >= LEVEL_DEPTH) gw += s.depth * depth, gt = s.depth;
    if (LEVEL >= LEVEL_ALL) {
        for (int c = 0; c < 3; c++) {
            gw += s.normal[c] * g[REC_NX + c];
            sum[SUM_NX + c] = w * s.normal[c];
        }
        const float inv_t = fast_reciprocal(depth), m = shifted_depth(inv_t, before, &s.first, map_scale);
        gw += m * (s.md2 * m - s.md1);
        gt += (2.0f * map_scale) * (s.md2 * m - 0.5f * s.md1) * inv_t * inv_t;
    }
    gt = w * gt;
    if (LEVEL >= LEVEL_ALL && before > 0.5f && after <= 0.5f) gt += s.median;
    s.rest -= w * gw, s.t = after;
    // dL / d log(alpha); the clamp at ALPHA_MAX stops it
    const float ga = free_a < ALPHA_MAX ? (before * gw - s.rest * fast_reciprocal(1.0f - a)) * a : 0.0f;
    const float gq = -0.5f * ga * r.inv_a, gA = -(gq * r.q + gt * depth) * r.inv_a, gB = gt * r.inv_a;
    const float gqx = gq * dx, gqy = gq * dy, gAx = gA * dx, gAy = gA * dy;
    sum[SUM_QX] = gqx, sum[SUM_QY] = gqy, sum[SUM_QXX] = gqx * dx, sum[SUM_QXY] = gqx * dy, sum[SUM_QYY] = gqy * dy;
    sum[SUM_A] = gA, sum[SUM_AX] = gAx, sum[SUM_AY] = gAy, sum[SUM_AXX] = gAx * dx, sum[SUM_AXY] = gAx * dy,
    sum[SUM_AYY] = gAy * dy;
    sum[SUM_OPACITY] = ga;
    if (LEVEL >= LEVEL_DEPTH) sum[SUM_B0] = gB, sum[SUM_BX] = gB * dx, sum[SUM_BY] = gB * dy;
    if (!STATS) return;
    sum[SUM_WEIGHT] = w, sum[SUM_ERROR] = w * s.error;
    const float move_x = 2.0f * (g[REC_Q0] * gqx + g[REC_Q1] * gqy + g[REC_A3] * gAx + g[REC_A4] * gAy) +
                         g[REC_A1] * gA + g[REC_B1] * gB;
    const float move_y = 2.0f * (g[REC_Q1] * gqx + g[REC_Q2] * gqy + g[REC_A4] * gAx + g[REC_A5] * gAy) +
                         g[REC_A2] * gA + g[REC_B2] * gB;
    const float half_x = 0.5f * camera->width * move_x, half_y = 0.5f * camera->height * move_y;
    sum[SUM_MOTION] = sqrtf(half_x * half_x + half_y * half_y);
}

template <int LEVEL, bool STATS>
static inline void differentiate_tile(const Lists &lists, const Camera *camera, const float *image, const uint8_t *hits,
                                      const ImageGradients &in, float *sums) {
    enum { COUNT = LEVEL >= LEVEL_DEPTH || STATS ? 24 : 16 };
    SHARED float4 staged[BATCH][FOURS];
    SHARED float parts[BATCH][WARPS][COUNT];
    SHARED uint8_t hit[BATCH];
    SHARED int slot[BATCH];
    Own<Pixel> own;
    Own<Sums<COUNT>> mine;
    const int tile = BLOCK_X, start = lists.ranges[tile], end = lists.ranges[tile + 1];
    if (start == end) return;
    const int ox = tile % lists.tiles_x * TILE, oy = tile / lists.tiles_x * TILE;
    const float map_scale = camera->far * camera->near / (camera->far - camera->near);
    PHASE {
        const int x = ox + pixel_x(), y = oy + pixel_y(), width = (int)camera->width, height = (int)camera->height;
        const int64_t stride = (int64_t)lists.tiles_x * TILE, plane = (int64_t)lists.tiles * TILE * TILE;
        Pixel none = {};
        if (inside_frame(camera, x, y))
            load_pixel<LEVEL, STATS>(none, in, (int64_t)y * width + x, (int64_t)width * height, image + y * stride + x,
                                     plane);
        *own = none;
    }
    for (int first = start; first < end; first += BATCH) {
        const int count = end - first < BATCH ? end - first : BATCH;
        PHASE {
            stage_records(lists, first, count, staged);
            if (THREAD < count) slot[THREAD] = lists.slots[first + THREAD], hit[THREAD] = hits[slot[THREAD]];
        }
        EACH_WARP {
            for (int k = 0; k < count; k++) {
                if (!(hit[k] >> THIS_WARP & 1)) continue;
                LANES {
                    const Staged g = take(staged[k]);
                    const float dx = (float)(ox + pixel_x()) + 0.5f - g.of[REC_CX],
                                dy = (float)(oy + pixel_y()) + 0.5f - g.of[REC_CY];
                    Sums<COUNT> sum = {};
                    differentiate_pixel<LEVEL, STATS>(*own, g.of, dx, dy, camera, map_scale, sum);
                    *mine = sum;
                }
                sum_columns(mine, parts[k][THIS_WARP]);
            }
        }
        PHASE {
            for (int i = THREAD; i < count * COUNT; i += BLOCK) {
                const int k = i / COUNT, c = i % COUNT;
                if (!hit[k]) continue;
                float total = 0.0f;
                for (int w = 0; w < WARPS; w++)
                    if (hit[k] >> w & 1) total += parts[k][w][c];
                sums[(int64_t)slot[k] * SUM_SIZE + c] = total;
            }
        }
    }
}

// sums [slots, SUM_SIZE]: written where hits is not zero; without stats and for colour alone only the first 16 columns.
// grid: tiles.
#define BLEND_BACKWARD(name, level, stats)                                                                             \
    KERNEL(name, Lists lists, BY_VALUE Camera camera, const float *image, const uint8_t *hits, ImageGradients in,      \
           float *sums) {                                                                                              \
        differentiate_tile<level, stats>(lists, &camera, image, hits, in, sums);                                       \
    }

BLEND_BACKWARD(blend_backward_color, LEVEL_COLOR, false)
BLEND_BACKWARD(blend_backward_color_stats, LEVEL_COLOR, true)
BLEND_BACKWARD(blend_backward_depth, LEVEL_DEPTH, false)
BLEND_BACKWARD(blend_backward_depth_stats, LEVEL_DEPTH, true)
BLEND_BACKWARD(blend_backward_all, LEVEL_ALL, false)
BLEND_BACKWARD(blend_backward_all_stats, LEVEL_ALL, true)
