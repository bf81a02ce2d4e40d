// SPDX-License-Identifier: GPL-3.0-or-later
// Signed distance of points to the surfaces that depth maps show, averaged over views (after Curless and Levoy 1996).
//
// A view with depth D at the pixel of a point at depth z says it lies s = (D - z) slope in front of the surface, where
// slope turns depth into distance along the surface's normal. Beyond `band` in front the point is free: s counts as band.
// Beyond `band` behind it the view cannot know, and only remembers that the point is covered, and whether closely.
#include "export.h"
#include "view.h"

enum { PIECE = 2048 };
static const float CLOSELY = 4;  // bands behind a surface that count as closely covered

// What a depth map says at one pixel; weight 0: nothing.
typedef struct {
    float depth, slope, weight, likeness;
} Pixel;

// What all views say of a point.
typedef struct {
    float weight, sum;                     // of the distances s / band, -1..1
    float likeness;                        // of the photos of the `near` views at the surface, added up
    int32_t covered, outside, seen, near;  // number of views; near: that show a surface within half a band,
    int32_t judging, behind;               // that say how far off it is, that cover the point closely
} Belief;

// A camera that judges, with what it shows: labels [height][width]; pixel (x, y) of its map is map[rows[y] + x], there for
// all pixels labelled INSIDE and those around them; pose, intrinsics as in view.h.
typedef struct {
    double pose[12], intrinsics[4];
    const uint8_t *labels;
    const Pixel *map;
    const int64_t *rows;
    int64_t height, width;
    double band;  // per unit of depth
} Judge;

// Between four pixels of one surface; the nearest pixel where they belong to several.
static inline Pixel sample(const Judge *j, double u, double v, float jump) {
    const int64_t nx = (int64_t)u, ny = (int64_t)v;
    const Pixel nearest = j->map[j->rows[ny] + nx];
    const double fx = u - 0.5, fy = v - 0.5;
    const int64_t x = (int64_t)__builtin_floor(fx), y = (int64_t)__builtin_floor(fy);
    if (x < 0 || y < 0 || x + 1 >= j->width || y + 1 >= j->height || !(nearest.weight > 0)) return nearest;
    const Pixel *p = j->map + j->rows[y] + x, *q = j->map + j->rows[y + 1] + x;
    const float a = (float)(fx - x), b = (float)(fy - y), limit = jump * nearest.depth;
    const Pixel four[4] = {p[0], p[1], q[0], q[1]};
    for (int k = 0; k < 4; k++)
        if (!(four[k].weight > 0) || __builtin_fabsf(four[k].depth - nearest.depth) > limit) return nearest;
    const float w[4] = {(1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b};
    Pixel r = {0, 0, 0, nearest.likeness};
    for (int k = 0; k < 4; k++)
        r.depth += w[k] * four[k].depth, r.slope += w[k] * four[k].slope, r.weight += w[k] * four[k].weight;
    return r;
}

static void ask(const Judge *j, const float *p, float near, float jump, Belief *belief) {
    double c[3], u, v;
    to_camera(j->pose, p[0], p[1], p[2], c);
    if (!in_frame(c, j->intrinsics, near, j->height, j->width, &u, &v)) return;
    const uint8_t label = j->labels[(int64_t)v * j->width + (int64_t)u];
    if (label == OUTSIDE) belief->outside++;
    if (label != INSIDE) return;
    belief->seen++;
    const Pixel here = sample(j, u, v, jump);
    if (!(here.weight > 0)) return;
    const float limit = (float)j->band * here.depth;
    const float s = (float)(here.depth - c[2]) * here.slope;
    if (s < 0.5f * limit && s > -0.5f * limit) belief->near++, belief->likeness += here.likeness;
    if (s < -limit) {
        belief->covered++, belief->behind += s > -CLOSELY * limit;
        return;
    }
    belief->judging++, belief->weight += here.weight;
    belief->sum += here.weight * (s < limit ? s / limit : 1.0f);
}

/* What `count` judges together believe of points [n][3]: beliefs [n], given as zeros.
   jump: share of the depth by which neighbouring pixels of one surface differ at most. */
MGF_API void fuse_judges_work(int32_t *next, int64_t n, const float *points, const Judge *judges, int64_t count,
                              float near, float jump, Belief *beliefs) {
    for (;;) {
        const int64_t start = take_work(next) * PIECE, end = start + PIECE < n ? start + PIECE : n;
        if (start >= n) return;
        for (int64_t k = 0; k < count; k++)  // the points of a piece fall close together, mostly
            for (int64_t i = start; i < end; i++) ask(judges + k, points + 3 * i, near, jump, beliefs + i);
    }
}
