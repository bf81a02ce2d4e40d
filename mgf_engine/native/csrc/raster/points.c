// SPDX-License-Identifier: GPL-3.0-or-later
// Opacity of points in space as one camera sees them (eq. 23-24): how much of the light from a point is held back.
//
// On the way from the camera to a point at depth z a Gaussian has reached its value at min(z, t*); with the record of
// the projection (records.h), the value at depth t on the ray is exp(power - |r|^2 (t - t*)^2 / 2), |r|^2 = REC_RAY2 *
// A.
//
// Points are sorted into blocks of 4 x 4 pixels inside the tiles, and by depth inside a block: sixteen neighbours are
// evaluated together, and Gaussians whose footprint or depth misses all sixteen are sorted out sixteen at a time.
#include <stdlib.h>
#include <string.h>

#include "common/export.h"
#include "raster/footprint.h"
#include "common/vector.h"
#include "mesh/view.h"

enum { PIECE = 4096, SIDE = 4, BLOCKS = (TILE / SIDE) * (TILE / SIDE) };
enum { BACKGROUND = 0, SEEN = 1, UNSEEN = 2 };

/* Where points [n][3] fall: place [n][3] = (u, v, depth), visibility [n]: BACKGROUND, SEEN or UNSEEN (out of frame,
   behind, unknown), block [n]: tile * 16 + block of the tile, -1 for points not SEEN. labels [height][width]:
   OUTSIDE, INSIDE or unknown. pose, intrinsics: as in view.h. */
MGF_API void mgf_locate_points(int32_t *next, int64_t n, const float *points, const double *pose,
                               const double *intrinsics, float near, const uint8_t *labels, int64_t height,
                               int64_t width, float *place, uint8_t *visibility, int32_t *block) {
    const int64_t tiles_x = (width + TILE - 1) / TILE;
    for (;;) {
        const int64_t start = take_work(next) * PIECE, end = start + PIECE < n ? start + PIECE : n;
        if (start >= n) return;
        for (int64_t i = start; i < end; i++) {
            double c[3], u, v;
            const float *p = points + 3 * i;
            to_camera(pose, p[0], p[1], p[2], c);
            visibility[i] = UNSEEN, block[i] = -1;
            if (!in_frame(c, intrinsics, near, height, width, &u, &v)) continue;
            const int64_t x = (int64_t)u, y = (int64_t)v;
            const uint8_t label = labels[y * width + x];
            visibility[i] = label == OUTSIDE ? BACKGROUND : label == INSIDE ? SEEN : UNSEEN;
            if (label != INSIDE) continue;
            place[3 * i] = (float)u, place[3 * i + 1] = (float)v, place[3 * i + 2] = (float)c[2];
            const int64_t tile = y / TILE * tiles_x + x / TILE,
                          inner = y % TILE / SIDE * (TILE / SIDE) + x % TILE / SIDE;
            block[i] = (int32_t)(tile * BLOCKS + inner);
        }
    }
}

/* Counting sort: order [number of points with a block], starts [blocks + 1]. */
MGF_API void mgf_sort_points(int64_t n, const int32_t *block, int64_t blocks, int32_t *order, int32_t *starts) {
    memset(starts, 0, (size_t)(blocks + 1) * sizeof *starts);
    for (int64_t i = 0; i < n; i++)
        if (block[i] >= 0) starts[block[i] + 1]++;
    for (int64_t b = 0; b < blocks; b++) starts[b + 1] += starts[b];
    for (int64_t i = 0; i < n; i++)
        if (block[i] >= 0) order[starts[block[i]]++] = (int32_t)i;
    for (int64_t b = blocks; b > 0; b--) starts[b] = starts[b - 1];
    starts[0] = 0;
}

/* Tile lists are made for pixel centres; points lie anywhere. Grow footprints [n] by at least half a pixel (ellipses
   thinner than half a pixel: about as much along their short axis only). */
MGF_API void mgf_grow_footprints(int64_t n, const float *records, Footprint *footprints) {
    for (int64_t i = 0; i < n; i++) {
        Footprint *p = footprints + i;
        const float *r = records + i * REC_SIZE;
        if (p->whole || !(p->width2 > 0)) continue;
        const float half_x = 0.5f * (r[REC_X1] - r[REC_X0]),
                    long_axis = __builtin_sqrtf(half_x * half_x + p->half_y * p->half_y);
        const float short_axis = p->half_y * __builtin_sqrtf(p->width2) / long_axis; // not longer than the true one
        const float grow = 1.0f + 0.5f / (short_axis > 0.25f ? short_axis : 0.25f);
        p->width2 *= grow * grow, p->half_y *= grow, p->y_right *= grow;
    }
}

/* What a tile knows of its list, column by column, so that sixteen Gaussians are tested at once. */
typedef struct {
    float *columns; // x0, x1, y0, y1, front of each, `stride` floats apart
    int64_t capacity, stride;
    int64_t count;
} List;

static int load_list(List *list, const float *records, const float *front, const int32_t *gid, int64_t count) {
    const int64_t padded = (count + 15) / 16 * 16;
    if (padded > list->capacity) {
        free(list->columns);
        list->capacity = 2 * padded, list->columns = malloc(5 * (size_t)list->capacity * sizeof(float));
        if (!list->columns) {
            list->capacity = 0;
            return 0;
        }
    }
    list->count = count, list->stride = list->capacity;
    float *c = list->columns;
    for (int64_t k = 0; k < padded; k++) {
        const float *r = records + (int64_t)gid[k < count ? k : count - 1] * REC_SIZE;
        c[k] = k < count ? r[REC_X0] : 1e30f; // padding lies right of everything
        c[k + list->stride] = r[REC_X1];
        c[k + 2 * list->stride] = r[REC_Y0], c[k + 3 * list->stride] = r[REC_Y1];
        c[k + 4 * list->stride] = front[gid[k < count ? k : count - 1]];
    }
    return 1;
}

// A bit for each lane that is true.
static inline uint32_t lane_bits(i16 m) {
#if defined(__AVX512F__)
    return (uint32_t)_mm512_test_epi32_mask((__m512i)m, (__m512i)m);
#else
    uint32_t bits = 0;
    for (int l = 0; l < 16; l++) bits |= (uint32_t)(m[l] & 1) << l;
    return bits;
#endif
}

typedef struct {
    v16 u, v, z;
    float low[3], high[3]; // bounds of u, v, z
} Group;

static Group load_group(const float *place, const int32_t *order, int64_t count) {
    Group g;
    for (int k = 0; k < 3; k++) g.low[k] = 1e30f, g.high[k] = -1e30f;
    for (int64_t l = 0; l < 16; l++) {
        const float *p = place + 3 * (int64_t)order[l < count ? l : count - 1];
        g.u[l] = p[0], g.v[l] = p[1], g.z[l] = p[2];
        for (int k = 0; k < 3; k++) {
            if (p[k] < g.low[k]) g.low[k] = p[k];
            if (p[k] > g.high[k]) g.high[k] = p[k];
        }
    }
    return g;
}

/* Transmittance in front of each point of the group; lanes end when it falls to `stop`. */
static v16 group_transmittance(const Group *g, const List *list, const float *records, const int32_t *gid, float near,
                               float stop) {
    v16 T = splat(1.0f);
    const v16 u0 = splat(g->low[0]), u1 = splat(g->high[0]), v0 = splat(g->low[1]), v1 = splat(g->high[1]);
    const v16 z1 = splat(g->high[2]);
    for (int64_t first = 0; first < list->count; first += 16) {
        const float *c = list->columns + first;
        const int64_t s = list->stride;
        i16 near_group = (load16(c) <= u1) & (load16(c + s) >= u0);
        near_group &= (load16(c + 2 * s) <= v1) & (load16(c + 3 * s) >= v0);
        near_group &= load16(c + 4 * s) <= z1;
        if (!any(near_group)) continue;
        for (uint32_t bits = lane_bits(near_group); bits; bits &= bits - 1) {
            const float *r = records + (int64_t)gid[first + __builtin_ctz(bits)] * REC_SIZE;
            const v16 dx = g->u - r[REC_CX], dy = g->v - r[REC_CY];
            const v16 q = (r[REC_Q0] * dx + 2.0f * r[REC_Q1] * dy) * dx + r[REC_Q2] * dy * dy;
            const v16 A = (r[REC_A3] * dx + (2.0f * r[REC_A4] * dy + r[REC_A1])) * dx +
                          (1.0f + (r[REC_A2] + r[REC_A5] * dy) * dy);
            const v16 inv = reciprocal(A);
            v16 power = (-0.5f * LOG2_E) * q * inv;
            const v16 peak = (r[REC_B0] + r[REC_B1] * dx + r[REC_B2] * dy) * inv;
            i16 counts = (power > r[REC_THRESHOLD]) & (T > stop) & (peak > near);
            if (!any(counts)) continue;
            const v16 short_of = vmin(g->z, peak) - peak;
            power -= (0.5f * LOG2_E * r[REC_RAY2]) * A * short_of * short_of;
            counts &= power > r[REC_THRESHOLD];
            const v16 a = vmin(r[REC_OPACITY] * exp2_16(power), splat(ALPHA_MAX));
            T -= keep(counts, a * T);
            if (!any(T > stop)) return T;
        }
    }
    return T;
}

/* Sort part of the order by depth (equal depths: by index). Shell sort: parts are short, and long ones stay bearable.
   */
static void sort_by_depth(int32_t *order, int64_t count, const float *place) {
    int64_t gap = 1;
    while (gap < count / 3) gap = 3 * gap + 1;
    for (; gap >= 1; gap /= 3)
        for (int64_t i = gap; i < count; i++) {
            const int32_t item = order[i];
            const float z = place[3 * (int64_t)item + 2];
            int64_t j = i;
            for (; j >= gap; j -= gap) {
                const int32_t other = order[j - gap];
                const float oz = place[3 * (int64_t)other + 2];
                if (oz < z || (oz == z && other < item)) break;
                order[j] = other;
            }
            order[j] = item;
        }
}

/* Opacity in front of each located point, kept as the two smallest so far: lowest [n][2].
   gid, ranges: lists of the tiles (bin.c) from grown footprints. front [Gaussians]: depth where a Gaussian begins.
   order, starts: from mgf_sort_points (order is sorted further). stop: transmittance at which a point is dark enough.
   Sets *failed when memory is short. */
MGF_API void mgf_point_opacity(int32_t *next, int64_t tiles, const float *records, const int32_t *gid,
                               const int32_t *ranges, const float *front, const float *place, int32_t *order,
                               const int32_t *starts, float near, float stop, float *lowest, int32_t *failed) {
    List list = {0};
    for (;;) {
        const int64_t tile = take_work(next);
        if (tile >= tiles) break;
        if (starts[tile * BLOCKS] == starts[(tile + 1) * BLOCKS]) continue;
        const int32_t *own = gid + ranges[tile];
        const int64_t count = ranges[tile + 1] - ranges[tile];
        if (count && !load_list(&list, records, front, own, count)) {
            *failed = 1;
            break;
        }
        list.count = count;
        for (int64_t b = tile * BLOCKS; b < (tile + 1) * BLOCKS; b++) {
            sort_by_depth(order + starts[b], starts[b + 1] - starts[b], place);
            for (int64_t i = starts[b]; i < starts[b + 1]; i += 16) {
                const int64_t lanes = starts[b + 1] - i < 16 ? starts[b + 1] - i : 16;
                const Group g = load_group(place, order + i, lanes);
                const v16 opacity = 1.0f - group_transmittance(&g, &list, records, own, near, stop);
                for (int64_t l = 0; l < lanes; l++) {
                    float *low = lowest + 2 * (int64_t)order[i + l];
                    if (opacity[l] < low[0]) low[1] = low[0], low[0] = opacity[l];
                    else if (opacity[l] < low[1]) low[1] = opacity[l];
                }
            }
        }
    }
    free(list.columns);
}
