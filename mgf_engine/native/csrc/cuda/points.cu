// SPDX-License-Identifier: GPL-3.0-or-later
// Opacity of points in space as one camera sees them (eq. 23-24); the formula is at the top of the C kernels' points.c.
//
// Points are sorted by tile, and inside a tile by blocks of 4 x 4 pixels, so that the lanes of a warp stand close
// together. A block looks after one tile, 256 points at a time; a thread walks down the tile's list for one point.
#include "cuda/blend.cuh"

#include "raster/project.h"

enum { BATCH = 64, INNER = 4, INNERS = (TILE / INNER) * (TILE / INNER) };
enum { OUTSIDE = 0, INSIDE = 1 };  // of the mask; other values: unknown
enum { BACKGROUND = 0, SEEN = 1, UNSEEN = 2 };

struct Pose {
    double rotation[9], translation[3], fx, fy, cx, cy;
};

// Where points [n][3] fall: place [n][3] = (u, v, depth), visibility [n], key [n]: tile * 16 + block of the tile, after
// all of them for points not SEEN. labels [height][width].
KERNEL(points_locate, int n, const float *points, BY_VALUE Pose pose, float near, const uint8_t *labels, int height,
       int width, float *place, uint8_t *visibility, uint32_t *key) {
    const int tiles_x = (width + TILE - 1) / TILE, tiles_y = (height + TILE - 1) / TILE;
    EACH(i, n) {
        const float *p = points + 3 * (int64_t)i;
        double c[3];
        for (int k = 0; k < 3; k++)
            c[k] = pose.rotation[3 * k] * p[0] + pose.rotation[3 * k + 1] * p[1] + pose.rotation[3 * k + 2] * p[2] +
                   pose.translation[k];
        visibility[i] = UNSEEN, key[i] = (uint32_t)(tiles_x * tiles_y * INNERS);
        if (!(c[2] > near)) continue;
        const double u = c[0] / c[2] * pose.fx + pose.cx, v = c[1] / c[2] * pose.fy + pose.cy;
        if (!(u >= 0 && v >= 0 && u < width && v < height)) continue;
        const int x = (int)u, y = (int)v;
        const uint8_t label = labels[(int64_t)y * width + x];
        visibility[i] = label == OUTSIDE ? BACKGROUND : label == INSIDE ? SEEN : UNSEEN;
        if (label != INSIDE) continue;
        place[3 * (int64_t)i] = (float)u, place[3 * (int64_t)i + 1] = (float)v, place[3 * (int64_t)i + 2] = (float)c[2];
        const int inner = y % TILE / INNER * (TILE / INNER) + x % TILE / INNER;
        key[i] = (uint32_t)((y / TILE * tiles_x + x / TILE) * INNERS + inner);
    }
}

// starts [tiles + 1]: where each tile's points begin in the sorted keys.
KERNEL(points_starts, int n, int tiles, const uint32_t *sorted_keys, int *starts) {
    EACH(k, n + 1) {
        const int tile = k < n ? (int)(sorted_keys[k] / INNERS) : tiles,
                  before = k ? (int)(sorted_keys[k - 1] / INNERS) : -1;
        for (int t = before + 1; t <= tile && t <= tiles; t++) starts[t] = k;
    }
}

// mask [tiles]: which tiles hold a point.
KERNEL(points_tiles, int tiles, const int *starts, uint8_t *mask) {
    EACH(t, tiles) { mask[t] = starts[t + 1] > starts[t]; }
}

// Tile lists are made for pixel centres; points lie anywhere. Grows footprints by at least half a pixel (ellipses
// thinner than half a pixel: about as much along their short axis only), and counts anew the tiles they touch.
KERNEL(points_grow, int n, const float *records, int tiles_x, int tiles_y, const int *mask_sums, Footprint *footprints,
       int *tile_counts, uint32_t *depth_keys) {
    EACH(i, n) {
        if (!tile_counts[i]) continue;
        Footprint p = footprints[i];
        const float *r = records + (int64_t)i * REC_SIZE;
        if (!p.whole && p.width2 > 0) {
            const float half_x = 0.5f * (r[REC_X1] - r[REC_X0]),
                        long_axis = sqrtf(half_x * half_x + p.half_y * p.half_y);
            const float short_axis = p.half_y * sqrtf(p.width2) / long_axis;  // not longer than the true one
            const float grow = 1.0f + 0.5f / (short_axis > 0.25f ? short_axis : 0.25f);
            p.width2 *= grow * grow, p.half_y *= grow, p.y_right *= grow;
            footprints[i] = p;
        }
        tile_counts[i] = count_tiles(&p, mask_sums, tiles_x, tiles_y);
        if (!tile_counts[i]) depth_keys[i] = ~0u;
    }
}

// The transmittance that one Gaussian leaves of T in front of a point at (u, v), depth z.
static inline float pass(const float4 *record, float u, float v, float z, float near, float T) {
    const Staged g = take(record);
    const float dx = u - g.of[REC_CX], dy = v - g.of[REC_CY];
    const float q = (g.of[REC_Q0] * dx + 2.0f * g.of[REC_Q1] * dy) * dx + g.of[REC_Q2] * dy * dy;
    const float A = (g.of[REC_A3] * dx + (2.0f * g.of[REC_A4] * dy + g.of[REC_A1])) * dx +
                    (1.0f + (g.of[REC_A2] + g.of[REC_A5] * dy) * dy);
    const float inv = fast_reciprocal(A), peak = response_depth(g.of, dx, dy, inv);
    float power = (-0.5f * LOG2_E) * q * inv;
    if (!(power > g.of[REC_THRESHOLD] && peak > near)) return T;
    const float short_of = (z < peak ? z : peak) - peak;
    power -= (0.5f * LOG2_E * g.of[REC_RAY2]) * A * short_of * short_of;
    if (!(power > g.of[REC_THRESHOLD])) return T;
    const float a = g.of[REC_OPACITY] * fast_exp2(power);
    return T - (a < ALPHA_MAX ? a : ALPHA_MAX) * T;
}

// Opacity in front of each located point, kept as the two smallest so far: lowest [n][2]. lists: from grown footprints.
// front
// [Gaussians]: depth where a Gaussian begins. order, starts: the points by tile. stop: transmittance at which a point
// is dark enough. grid: tiles.
KERNEL(points_opacity, Lists lists, const float *front, const float *place, const int *order, const int *starts,
       float near, float stop, float *lowest) {
    SHARED float4 staged[BATCH][FOURS];
    SHARED float begins[BATCH];
    SHARED int live[2];
    struct Point {
        float u, v, z, T;
        int index;
    };
    Own<Point> own;
    const int tile = BLOCK_X, start = lists.ranges[tile], end = lists.ranges[tile + 1];
    for (int group = starts[tile]; group < starts[tile + 1]; group += BLOCK) {
        PHASE {
            const int i = group + THREAD;
            own->T = 0.0f, own->index = -1;
            if (THREAD == 0) live[0] = live[1] = 0;
            if (i >= starts[tile + 1]) continue;
            const float *p = place + 3 * (int64_t)order[i];
            own->index = order[i], own->u = p[0], own->v = p[1], own->z = p[2], own->T = 1.0f;
        }
        for (int first = start, turn = 0; first < end; first += BATCH, turn ^= 1) {
            const int count = end - first < BATCH ? end - first : BATCH;
            PHASE {
                stage_records(lists, first, count, staged);
                if (THREAD < count) begins[THREAD] = front[lists.gid[first + THREAD]];
            }
            PHASE {
                if (THREAD == 0) live[turn ^ 1] = 0;
                Point p = *own;
                for (int k = 0; k < count && p.T > stop; k++) {
                    const float *g = (const float *)staged[k];
                    if (g[REC_X0] <= p.u && g[REC_X1] >= p.u && g[REC_Y0] <= p.v && g[REC_Y1] >= p.v &&
                        begins[k] <= p.z)
                        p.T = pass(staged[k], p.u, p.v, p.z, near, p.T);
                }
                if (p.T > stop) live[turn] = 1;
                *own = p;
            }
            if (!live[turn]) break;
        }
        PHASE {
            if (own->index < 0) continue;
            float *low = lowest + 2 * (int64_t)own->index;
            const float opacity = 1.0f - own->T;
            if (opacity < low[0]) low[1] = low[0], low[0] = opacity;
            else if (opacity < low[1]) low[1] = opacity;
        }
    }
}
