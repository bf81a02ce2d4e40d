// SPDX-License-Identifier: GPL-3.0-or-later
// Which triangle of a mesh each pixel sees: a z-buffer over bands of rows.
//
// Vertices come projected: (u, v) in pixels and 1/depth, which is linear over a triangle's image. Pixels whose centre
// lies on an edge belong to both triangles, so that no gap opens between neighbours; the nearer one wins, of equal
// ones the first. Each band belongs to one thread, so the result does not depend on the number of threads.
#include "common/export.h"
#include "mesh/view.h"

enum { PIECE = 8192, BLOCK = 256 };

typedef struct {
    double x, y, q; // pixels, pixels, 1/depth
} Corner;

typedef struct {
    int64_t x0, x1, y0, y1; // first and last column and row
} Box;

static inline double least(double a, double b) { return a < b ? a : b; }
static inline double most(double a, double b) { return a > b ? a : b; }
static inline int64_t whole_above(double x) { // of x >= 0
    const int64_t down = (int64_t)x;
    return down + (down < x);
}

// The pixels of rows top to bottom - 1 whose centres a triangle may hold; whether there are any. Without branches: most
// triangles lie between the centres of pixels, but which is a toss-up.
static inline int box_of(Corner a, Corner b, Corner c, int64_t top, int64_t bottom, int64_t width, Box *box) {
    const double y_low = least(least(a.y, b.y), c.y) - 0.5, y_high = most(most(a.y, b.y), c.y) - 0.5;
    const double x_low = least(least(a.x, b.x), c.x) - 0.5, x_high = most(most(a.x, b.x), c.x) - 0.5;
    const int seen = (a.q > 0) & (b.q > 0) & (c.q > 0);
    const int near = (y_high >= top) & (y_low <= bottom - 1) & (x_high >= 0) & (x_low <= width - 1);
    box->y0 = whole_above(most(least(y_low, bottom), top)), box->y1 = (int64_t)most(least(y_high, bottom - 1), top);
    box->x0 = whole_above(most(least(x_low, width), 0)), box->x1 = (int64_t)most(least(x_high, width - 1), 0);
    return seen & near & (box->y0 <= box->y1) & (box->x0 <= box->x1);
}

static void draw(Corner a, Corner b, Corner c, int32_t id, const Box *box, int64_t width, float *inverse,
                 int32_t *face) {
    const double area = (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
    if (!(area > 1e-12 || area < -1e-12)) return;
    const double k = 1.0 / area;
    for (int64_t y = box->y0; y <= box->y1; y++) {
        const double py = y + 0.5;
        for (int64_t x = box->x0; x <= box->x1; x++) {
            const double px = x + 0.5;
            const double wa = ((b.x - px) * (c.y - py) - (b.y - py) * (c.x - px)) * k;
            const double wb = ((c.x - px) * (a.y - py) - (c.y - py) * (a.x - px)) * k;
            const double wc = ((a.x - px) * (b.y - py) - (a.y - py) * (b.x - px)) * k;
            if (!(wa >= 0 && wb >= 0 && wc >= 0)) continue;
            const float q = (float)(wa * a.q + wb * b.q + wc * c.q);
            const int64_t at = y * width + x;
            if (q > inverse[at]) inverse[at] = q, face[at] = id;
        }
    }
}

/* corners [n][3]: (u, v, 1/depth) of points [n][3]; all zero where they are not deeper than `near`.
   pose, intrinsics: as in view.h. */
MGF_API void mgf_project_vertices(int32_t *next, int64_t n, const double *points, const double *pose,
                                  const double *intrinsics, float near, double *corners) {
    for (;;) {
        const int64_t start = take_work(next) * (int64_t)PIECE, end = start + PIECE < n ? start + PIECE : n;
        if (start >= n) return;
        for (int64_t i = start; i < end; i++) {
            const double *p = points + 3 * i;
            double c[3];
            to_camera(pose, p[0], p[1], p[2], c);
            const int in_front = c[2] > near;
            const double q = in_front ? 1.0 / c[2] : 0.0;
            corners[3 * i] = in_front ? c[0] * q * intrinsics[0] + intrinsics[2] : 0.0;
            corners[3 * i + 1] = in_front ? c[1] * q * intrinsics[1] + intrinsics[3] : 0.0;
            corners[3 * i + 2] = q;
        }
    }
}

/* corners: [n][3] float64 (u, v, 1/depth), 1/depth <= 0 for vertices that are not in front: their faces are left out.
   inverse [height][width] given as zeros, face [height][width] given as -1. */
MGF_API void mgf_zbuffer(int32_t *next, const double *corners, const int32_t *faces, int64_t count, int64_t height,
                         int64_t width, int64_t band, float *inverse, int32_t *face) {
    const Corner *v = (const Corner *)corners;
    for (;;) {
        const int64_t top = take_work(next) * band;
        if (top >= height) return;
        const int64_t bottom = top + band < height ? top + band : height;
        for (int64_t start = 0; start < count; start += BLOCK) {
            const int64_t end = start + BLOCK < count ? start + BLOCK : count;
            int32_t chosen[BLOCK];
            Box box[BLOCK];
            int64_t n = 0;
            for (int64_t i = start; i < end; i++) {
                chosen[n] = (int32_t)i;
                n += box_of(v[faces[3 * i]], v[faces[3 * i + 1]], v[faces[3 * i + 2]], top, bottom, width, box + n);
            }
            for (int64_t k = 0; k < n; k++) {
                const int32_t *f = faces + 3 * (int64_t)chosen[k];
                draw(v[f[0]], v[f[1]], v[f[2]], chosen[k], box + k, width, inverse, face);
            }
        }
    }
}

/* Adds to counts [faces][4] the pixels that see each face from the front, from behind, that call it building, and that
   know. face [pixels], -1 for none; corners, faces as above; labels [pixels]: 0 background, `unknown`, else building;
   without labels no pixel knows. Several threads may add to the same counts. */
MGF_API void mgf_count_pixels(int64_t pixels, const int32_t *face, const double *corners, const int32_t *faces,
                              const uint8_t *labels, int64_t unknown, int32_t *counts) {
    const Corner *v = (const Corner *)corners;
    for (int64_t i = 0; i < pixels; i++) {
        if (face[i] < 0) continue;
        const int32_t *f = faces + 3 * (int64_t)face[i];
        const Corner a = v[f[0]], b = v[f[1]], c = v[f[2]];
        const int front = (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x) < 0;  // rows run downwards
        const int known = labels && labels[i] != unknown, inside = known && labels[i] != 0;
        int32_t *count = counts + 4 * (int64_t)face[i];
        __atomic_fetch_add(count + (front ? 0 : 1), 1, __ATOMIC_RELAXED);
        if (inside) __atomic_fetch_add(count + 2, 1, __ATOMIC_RELAXED);
        if (known) __atomic_fetch_add(count + 3, 1, __ATOMIC_RELAXED);
    }
}
