// SPDX-License-Identifier: GPL-3.0-or-later
// Gradients of blending (blend.c), again front to back, from the final images alone.
//
// Let G_i = dL/dw_i, all else held: with gc, gn, gd, ga, gx the gradients of colour, normal, depth, alpha and
// distortion
//     G_i = gc . c_i + gn . n_i + gd t_i + ga + gx (m_i^2 W - 2 m_i M1 + M2)    (W, M1, M2: sums over all Gaussians)
// because distortion = W M2 - M1^2. Moving a_i moves w_i by T_i and every later w_j by -w_j / (1 - a_i), so
//     dL/da_i = T_i G_i - R_i / (1 - a_i),   R_i = sum_{j > i} w_j G_j.
// The sum over all j is known from the final images, since sum w c = colour and so on:
//     sum_j w_j G_j = gc . colour + gn . normal + gd depth + ga W + 2 gx (W M2 - M1^2);
// taking w_j G_j off it front to back gives every R_i without dividing T by (1 - a) as a walk back to front would.
//
// Depths: dL/dt_i = w_i (gd + gx 2 (m_i W - M1) dm/dt), dm/dt = far / (far - near) near / t^2, and the median's
// gradient where Gaussian i set it. Then q, A and B of records.h by dL/dq = -1/2 a dL/da / A, gB = gt / A, gA = -(gq q
// + gt t) / A.
//
// Each entry of a list has its own slot for the sums over the tile's pixels (blend_backward.h); project_backward.c adds
// the slots of a Gaussian in a fixed order. So no result depends on which thread took which tile.
#include "raster/blend_backward.h"

#include "raster/blend.h"
#include "common/export.h"

// Gradients of the images, [.., height, width] without padding; null where there is none.
typedef struct {
    const float *color, *alpha, *depth, *median, *normal, *distortion, *error;
    int64_t width, height;
} ImageGradients;

// What the backward pass needs to know of the pixels of a block, one block after the other as in blend.c.
typedef struct {
    v16 t, rest;                    // transmittance, R
    v16 color[3], fixed;           // gc; the part of G that is the same for every Gaussian
    v16 depth, median, normal[3];
    v16 md2, md1, first;            // gx W, 2 gx M1, as in shifted_depth
    v16 error;
} Block;

enum { STEP = sizeof(Block) / sizeof(v16) };  // from a vector of one block to that of the next

// One plane of a tile from an image whose rows are `stride` floats apart; zero outside width x height and for no image.
INLINE void load_plane(v16 *to, int64_t step, const float *plane, int64_t stride, int64_t ox, int64_t oy, int64_t width,
                       int64_t height) {
    if (!plane) {
        for (int b = 0; b < BLOCKS; b++) to[b * step] = splat(0.0f);
        return;
    }
    if (ox + TILE <= width && oy + TILE <= height) {
        for (int b = 0; b < BLOCKS; b++)
            for (int row = 0; row < 4; row++)
                memcpy((float *)(to + b * step) + 4 * row,
                       plane + (oy + (b >> 2) * 4 + row) * stride + ox + (b & 3) * 4, 4 * sizeof(float));
        return;
    }
    for (int b = 0; b < BLOCKS; b++)
        for (int i = 0; i < 16; i++) {
            const int64_t x = ox + (b & 3) * 4 + (i & 3), y = oy + (b >> 2) * 4 + (i >> 2);
            ((float *)(to + b * step))[i] = x < width && y < height ? plane[y * stride + x] : 0.0f;
        }
}

INLINE void load_blocks(Block *s, const ImageGradients *in, const float *image, int64_t plane, int64_t tiles_x,
                        int64_t tile, const Camera *camera, const int level, const int stats) {
    const int64_t ox = tile % tiles_x * TILE, oy = tile / tiles_x * TILE, stride = tiles_x * TILE, w = in->width,
                  h = in->height;
    v16 value[BLOCKS], alpha[BLOCKS];
#define GRADIENT(to, from, c) load_plane(&s->to, STEP, (from) ? (from) + (c) * w * h : 0, w, ox, oy, w, h)
#define VALUE(to, c) load_plane(to, 1, image + (c) * plane, stride, ox, oy, w, h)
    VALUE(alpha, OUT_ALPHA);
    GRADIENT(fixed, in->alpha, 0);
    for (int b = 0; b < BLOCKS; b++) {
        const i16 inside = (COLUMN_X[b & 3] + (float)ox < camera->width) & (ROW_Y[b >> 2] + (float)oy < camera->height);
        s[b].t = keep(inside, splat(1.0f));  // as in blend_tile
        s[b].rest = s[b].fixed * alpha[b];
    }
    for (int c = 0; c < 3; c++) {
        GRADIENT(color[c], in->color, c);
        VALUE(value, OUT_R + c);
        for (int b = 0; b < BLOCKS; b++) s[b].rest += s[b].color[c] * value[b];
    }
    if (stats) GRADIENT(error, in->error, 0);
    if (level >= LEVEL_DEPTH) {
        GRADIENT(depth, in->depth, 0);
        VALUE(value, OUT_DEPTH);
        for (int b = 0; b < BLOCKS; b++) s[b].rest += s[b].depth * value[b];
    }
    if (level < LEVEL_ALL) return;
    for (int c = 0; c < 3; c++) {
        GRADIENT(normal[c], in->normal, c);
        VALUE(value, OUT_NX + c);
        for (int b = 0; b < BLOCKS; b++) s[b].rest += s[b].normal[c] * value[b];
    }
    v16 m1[BLOCKS];
    GRADIENT(median, in->median, 0);
    GRADIENT(md2, in->distortion, 0);
    VALUE(m1, OUT_M1);
    VALUE(value, OUT_M2);
    for (int b = 0; b < BLOCKS; b++) {
        const v16 distortion = s[b].md2;
        s[b].md2 = distortion * alpha[b], s[b].md1 = 2.0f * distortion * m1[b];
        s[b].first = splat(0.0f);
        s[b].fixed += distortion * value[b];
        s[b].rest += 2.0f * distortion * (value[b] * alpha[b] - m1[b] * m1[b]);
    }
#undef GRADIENT
#undef VALUE
}

// Gradients of q, A and B in the pixels of one block.
typedef struct {
    v16 q, a, b;
} Slopes;

// What one Gaussian gets from one block: its slopes, and all sums but those of the slopes.
INLINE Slopes differentiate_block(Block *s, const float *g, v16 dx, v16 dy, const Camera *camera, float map_scale,
                                  v16 *sum, const int level, const int stats) {
    const Response r = respond(g, dx, dy);
    const v16 before = s->t;
    const v16 t_star = response_depth(g, dx, dy, r.inv_a);
    const i16 taken = (r.power2 > g[REC_THRESHOLD]) & (before > T_STOP) & (t_star > camera->near);
    const v16 free_a = g[REC_OPACITY] * exp2_16(r.power2), a = vmin(free_a, splat(ALPHA_MAX));
    const v16 w = keep(taken, a * before), after = before - w;
    const v16 depth = choose(taken, t_star, splat(camera->near));
    v16 gw = s->fixed, gt = splat(0.0f);
    for (int c = 0; c < 3; c++) {
        gw += s->color[c] * g[REC_R + c];
        sum[SUM_R + c] += w * s->color[c];
    }
    if (level >= LEVEL_DEPTH) gw += s->depth * depth, gt = s->depth;
    if (level >= LEVEL_ALL) {
        for (int c = 0; c < 3; c++) {
            gw += s->normal[c] * g[REC_NX + c];
            sum[SUM_NX + c] += w * s->normal[c];
        }
        const v16 inv_t = reciprocal(depth), m = shifted_depth(inv_t, before, &s->first, map_scale);
        gw += m * (s->md2 * m - s->md1);
        gt += (2.0f * map_scale) * (s->md2 * m - 0.5f * s->md1) * inv_t * inv_t;
    }
    gt = w * gt;
    if (level >= LEVEL_ALL) gt += keep(taken & (before > 0.5f) & (after <= 0.5f), s->median);
    const v16 rest = s->rest - w * gw;
    s->rest = rest, s->t = after;
    // dL / d log(alpha); the clamp at ALPHA_MAX stops it
    const v16 ga = keep(taken & (free_a < ALPHA_MAX), (before * gw - rest * reciprocal(1.0f - a)) * a);
    sum[SUM_OPACITY] += ga;
    if (stats) sum[SUM_WEIGHT] += w, sum[SUM_ERROR] += w * s->error;
    const v16 gq = -0.5f * ga * r.inv_a;
    return (Slopes){gq, -(gq * r.q + gt * depth) * r.inv_a, gt * r.inv_a};
}

// Adds the sums of the slopes of one block.
INLINE void add_slopes(const Slopes *of, const float *g, v16 dx, v16 dy, const Camera *camera, v16 *sum,
                       const int level, const int stats) {
    const v16 gq = of->q, gA = of->a, gB = level >= LEVEL_DEPTH ? of->b : splat(0.0f);
    const v16 gqx = gq * dx, gqy = gq * dy, gAx = gA * dx, gAy = gA * dy;
    sum[SUM_QX] += gqx, sum[SUM_QY] += gqy, sum[SUM_QXX] += gqx * dx, sum[SUM_QXY] += gqx * dy,
        sum[SUM_QYY] += gqy * dy;
    sum[SUM_A] += gA, sum[SUM_AX] += gAx, sum[SUM_AY] += gAy;
    sum[SUM_AXX] += gAx * dx, sum[SUM_AXY] += gAx * dy, sum[SUM_AYY] += gAy * dy;
    if (level >= LEVEL_DEPTH) sum[SUM_B0] += gB, sum[SUM_BX] += gB * dx, sum[SUM_BY] += gB * dy;
    if (!stats) return;
    const v16 move_x = 2.0f * (g[REC_Q0] * gqx + g[REC_Q1] * gqy + g[REC_A3] * gAx + g[REC_A4] * gAy) + g[REC_A1] * gA +
                       g[REC_B1] * gB;
    const v16 move_y = 2.0f * (g[REC_Q1] * gqx + g[REC_Q2] * gqy + g[REC_A4] * gAx + g[REC_A5] * gAy) + g[REC_A2] * gA +
                       g[REC_B2] * gB;
    const v16 half_x = 0.5f * camera->width * move_x, half_y = 0.5f * camera->height * move_y;
    sum[SUM_MOTION] += vsqrt(half_x * half_x + half_y * half_y);
}

INLINE void differentiate_tile(int64_t tile, const Camera *camera, const float *records, const int32_t *gid,
                               const int32_t *slots, const int32_t *ranges, int64_t tiles_x, const float *image,
                               int64_t plane, const uint16_t *hits, const ImageGradients *in, float *sums,
                               const int level, const int stats) {
    const int32_t start = ranges[tile], end = ranges[tile + 1];
    if (start == end) return;
    const float ox = (float)(tile % tiles_x) * TILE, oy = (float)(tile / tiles_x) * TILE;
    const float map_scale = camera->far * camera->near / (camera->far - camera->near);
    enum { AHEAD = 12 };
    Block blocks[BLOCKS];
    load_blocks(blocks, in, image, plane, tiles_x, tile, camera, level, stats);
    for (int32_t k = start; k < end; k++) {
        const uint32_t hit = hits[slots[k]];
        if (k + AHEAD < end) {
            __builtin_prefetch(hits + slots[k + AHEAD]);
            const float *later = sums + (int64_t)slots[k + AHEAD / 2] * SUM_SIZE;
            __builtin_prefetch(later, 1);
            __builtin_prefetch(later + 16, 1);
        }
        if (!hit) continue;
        const float *g = records + (int64_t)gid[k] * REC_SIZE;
        prefetch_record(records, gid, k, end);
        const float x = ox - g[REC_CX], y = oy - g[REC_CY];
        Slopes slopes[BLOCKS], *of = slopes;
        v16 sum[SUM_SIZE];
        memset(sum, 0, sizeof sum);
        for (uint32_t todo = hit; todo; todo &= todo - 1) {
            const int b = __builtin_ctz(todo);
            READ_ANEW(g);
            *of++ = differentiate_block(blocks + b, g, COLUMN_X[b & 3] + x, ROW_Y[b >> 2] + y, camera, map_scale, sum,
                                        level, stats);
        }
        of = slopes;
        for (uint32_t todo = hit; todo; todo &= todo - 1) {
            const int b = __builtin_ctz(todo);
            READ_ANEW(g);
            add_slopes(of++, g, COLUMN_X[b & 3] + x, ROW_Y[b >> 2] + y, camera, sum, level, stats);
        }
        float *out = sums + (int64_t)slots[k] * SUM_SIZE;
        const v16 low = sums16(sum);
        memcpy(out, &low, sizeof low);
        if (level >= LEVEL_DEPTH || stats) sums8(sum + 16, out + 16);
    }
}

// sums [slots, SUM_SIZE]: written where hits is not zero; without stats and with LEVEL_COLOR only the first 16 columns.
MGF_API void mgf_blend_backward(int32_t *next, int64_t tiles, const Camera *camera, const float *records,
                                const int32_t *gid, const int32_t *slots, const int32_t *ranges, int64_t tiles_x,
                                const float *image, const uint16_t *hits, const float *color, const float *alpha,
                                const float *depth, const float *median, const float *normal, const float *distortion,
                                const float *error, int64_t level, int64_t stats, float *sums) {
    const ImageGradients in = {
        color, alpha, depth, median, normal, distortion, error, (int64_t)camera->width, (int64_t)camera->height};
    const int64_t plane = tiles * TILE * TILE;
#define TILE_WITH(level, stats)                                                                                        \
    differentiate_tile(tile, camera, records, gid, slots, ranges, tiles_x, image, plane, hits, &in, sums, level,       \
                       stats);                                                                                         \
    break
    for (int64_t tile; (tile = take_work(next)) < tiles;) {
        switch (2 * level + (stats != 0)) {
            case 0: TILE_WITH(LEVEL_COLOR, 0);
            case 1: TILE_WITH(LEVEL_COLOR, 1);
            case 2: TILE_WITH(LEVEL_DEPTH, 0);
            case 3: TILE_WITH(LEVEL_DEPTH, 1);
            case 4: TILE_WITH(LEVEL_ALL, 0);
            default: TILE_WITH(LEVEL_ALL, 1);
        }
    }
}
