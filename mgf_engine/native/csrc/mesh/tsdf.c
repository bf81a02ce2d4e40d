// SPDX-License-Identifier: GPL-3.0-or-later
// Signed distance of points to the surfaces that depth maps show, averaged over views (after Curless and Levoy 1996).
//
// A view with depth D at the pixel of a point at depth z says it lies s = (D - z) slope in front of the surface, where
// slope turns depth into distance along the surface's normal. Beyond `band` in front the point is free: s counts as
// band. Beyond `band` behind it the view cannot know, and only remembers that the point is covered, and whether
// closely.
#include "common/export.h"
#include "mesh/view.h"

enum { PIECE = 2048, TOGETHER = 64 };
static const float CLOSELY = 4;  // bands behind a surface that count as closely covered

// What a depth map says at one pixel; weight 0: nothing.
typedef struct {
    float depth, slope, weight, correlation;
} Pixel;

// What all views say of a point.
typedef struct {
    float weight, sum;                     // of the distances s / band, -1..1
    float correlation;                     // of the photos of the `near` views at the surface, added up
    // Number of views that hide it behind a surface, show background there, show the building there, show a surface
    // within half a band, say how far off the surface is, hide it closely behind one.
    int32_t covered, outside, seen, near, fused, behind;
} TsdfSample;

// A photo's camera with what it shows: labels [height][width]; pixel (x, y) of its map is map[rows[y] + x], there for
// all pixels labelled INSIDE and those around them; pose, intrinsics as in view.h.
typedef struct {
    double pose[12], intrinsics[4];
    const uint8_t *labels;
    const Pixel *map;
    const int64_t *rows;
    int64_t height, width;
    double band;         // per unit of depth
    double least_slope;  // of its pixels
} TrustedView;

// Between four pixels of one surface; the nearest pixel where they belong to several.
static inline Pixel sample(const TrustedView *view, Pixel nearest, double u, double v, float jump) {
    const double fx = u - 0.5, fy = v - 0.5;
    const int64_t x = (int64_t)__builtin_floor(fx), y = (int64_t)__builtin_floor(fy);
    if (x < 0 || y < 0 || x + 1 >= view->width || y + 1 >= view->height) return nearest;
    const Pixel *p = view->map + view->rows[y] + x, *q = view->map + view->rows[y + 1] + x;
    const float a = (float)(fx - x), b = (float)(fy - y), limit = jump * nearest.depth;
    const Pixel four[4] = {p[0], p[1], q[0], q[1]};
    for (int k = 0; k < 4; k++)
        if (!(four[k].weight > 0) || __builtin_fabsf(four[k].depth - nearest.depth) > limit) return nearest;
    const float w[4] = {(1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b};
    Pixel r = {0, 0, 0, nearest.correlation};
    for (int k = 0; k < 4; k++)
        r.depth += w[k] * four[k].depth, r.slope += w[k] * four[k].slope, r.weight += w[k] * four[k].weight;
    return r;
}

// Where points fall in a picture, and how deep they lie.
typedef struct {
    double u[TOGETHER], v[TOGETHER], depth[TOGETHER];
    uint8_t in_frame[TOGETHER];
} Places;

// Without branches, so that several points go side by side.
static void find_places(const TrustedView *view, const float *points, int64_t count, float near, Places *at) {
    const double *k = view->intrinsics, width = (double)view->width, height = (double)view->height;
    for (int64_t i = 0; i < count; i++) {
        double c[3];
        to_camera(view->pose, points[3 * i], points[3 * i + 1], points[3 * i + 2], c);
        const double u = c[0] / c[2] * k[0] + k[2], v = c[1] / c[2] * k[1] + k[3];
        at->u[i] = u, at->v[i] = v, at->depth[i] = c[2];
        at->in_frame[i] = (c[2] > near) & (u >= 0) & (v >= 0) & (u < width) & (v < height);
    }
}

// Whether a point lies so far behind a pixel's surface that what lies between it and the next pixels does not matter.
static inline int far_behind(const TrustedView *view, const Pixel *nearest, double depth, float jump) {
    const double farthest = (1.001 + jump) * nearest->depth;  // all is rounded: a little more than needed
    return (depth - farthest) * view->least_slope > 1.001 * CLOSELY * view->band * farthest;
}

// Adds what a view shows at a point that lies so deep.
static void add_view(const TrustedView *view, Pixel here, double depth, TsdfSample *tsdf) {
    const float limit = (float)view->band * here.depth;
    const float s = (float)(here.depth - depth) * here.slope;
    if (s < 0.5f * limit && s > -0.5f * limit) tsdf->near++, tsdf->correlation += here.correlation;
    if (s < -limit) {
        tsdf->covered++, tsdf->behind += s > -CLOSELY * limit;
        return;
    }
    tsdf->fused++, tsdf->weight += here.weight;
    tsdf->sum += here.weight * (s < limit ? s / limit : 1.0f);
}

// What one view says of up to TOGETHER points.
static void ask_view(const TrustedView *view, const float *points, int64_t count, float near, float jump,
                     TsdfSample *samples) {
    Places at;
    int32_t inside[TOGETHER], inside_count = 0;
    find_places(view, points, count, near, &at);
    for (int64_t i = 0; i < count; i++) {
        if (!at.in_frame[i]) continue;
        const uint8_t label = view->labels[(int64_t)at.v[i] * view->width + (int64_t)at.u[i]];
        samples[i].outside += label == OUTSIDE, samples[i].seen += label == INSIDE;
        inside[inside_count] = (int32_t)i, inside_count += label == INSIDE;
    }
    for (int32_t n = 0; n < inside_count; n++) {
        const int32_t i = inside[n];
        const Pixel nearest = view->map[view->rows[(int64_t)at.v[i]] + (int64_t)at.u[i]];
        if (!(nearest.weight > 0)) continue;
        if (far_behind(view, &nearest, at.depth[i], jump)) samples[i].covered++;
        else add_view(view, sample(view, nearest, at.u[i], at.v[i], jump), at.depth[i], samples + i);
    }
}

/* What `count` views together tell of points [n][3]: samples [n], given as zeros.
   jump: share of the depth by which neighbouring pixels of one surface differ at most. */
MGF_API void mgf_integrate_depths(int32_t *next, int64_t n, const float *points, const TrustedView *views,
                                  int64_t count, float near, float jump, TsdfSample *samples) {
    for (;;) {
        const int64_t start = take_work(next) * PIECE, end = start + PIECE < n ? start + PIECE : n;
        if (start >= n) return;
        for (int64_t k = 0; k < count; k++)  // the points of a piece fall close together, mostly
            for (int64_t i = start; i < end; i += TOGETHER)
                ask_view(views + k, points + 3 * i, end - i < TOGETHER ? end - i : TOGETHER, near, jump, samples + i);
    }
}
