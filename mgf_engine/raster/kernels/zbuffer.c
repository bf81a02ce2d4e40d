// SPDX-License-Identifier: GPL-3.0-or-later
// Which triangle of a mesh each pixel sees: a z-buffer over bands of rows.
//
// Vertices come projected: (u, v) in pixels and 1/depth, which is linear over a triangle's image. Pixels whose centre
// lies on an edge belong to both triangles, so that no gap opens between neighbours; the nearer one wins, of equal
// ones the first. Each band belongs to one thread, so the result does not depend on the number of threads.
#include "export.h"
#include "view.h"

enum { BAND = 128, PIECE = 8192 };

typedef struct {
    double x, y, q; // pixels, pixels, 1/depth
} Corner;

static double smallest(double a, double b, double c) { return a < b ? (a < c ? a : c) : (b < c ? b : c); }
static double largest(double a, double b, double c) { return a > b ? (a > c ? a : c) : (b > c ? b : c); }

static void draw(Corner a, Corner b, Corner c, int32_t id, int64_t top, int64_t bottom, int64_t width, float *inverse,
                 int32_t *face) {
    const double area = (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
    if (!(area > 1e-12 || area < -1e-12)) return;
    const double y_low = smallest(a.y, b.y, c.y) - 0.5, y_high = largest(a.y, b.y, c.y) - 0.5;
    const double x_low = smallest(a.x, b.x, c.x) - 0.5, x_high = largest(a.x, b.x, c.x) - 0.5;
    if (!(y_high >= top && y_low <= bottom - 1 && x_high >= 0 && x_low <= width - 1)) return;
    const int64_t y0 = y_low <= top ? top : (int64_t)__builtin_ceil(y_low), x0 = x_low <= 0 ? 0 : (int64_t)__builtin_ceil(x_low);
    const int64_t y1 = y_high >= bottom - 1 ? bottom - 1 : (int64_t)__builtin_floor(y_high);
    const int64_t x1 = x_high >= width - 1 ? width - 1 : (int64_t)__builtin_floor(x_high);
    const double k = 1.0 / area;
    for (int64_t y = y0; y <= y1; y++) {
        const double py = y + 0.5;
        for (int64_t x = x0; x <= x1; x++) {
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
MGF_API void corners_work(int32_t *next, int64_t n, const double *points, const double *pose, const double *intrinsics,
                          float near, double *corners) {
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
MGF_API void zbuffer_work(int32_t *next, const double *corners, const int32_t *faces, int64_t count, int64_t height,
                          int64_t width, float *inverse, int32_t *face) {
    const Corner *v = (const Corner *)corners;
    for (;;) {
        const int64_t top = take_work(next) * BAND;
        if (top >= height) return;
        const int64_t bottom = top + BAND < height ? top + BAND : height;
        for (int64_t i = 0; i < count; i++) {
            const Corner a = v[faces[3 * i]], b = v[faces[3 * i + 1]], c = v[faces[3 * i + 2]];
            if (a.q > 0 && b.q > 0 && c.q > 0) draw(a, b, c, (int32_t)i, top, bottom, width, inverse, face);
        }
    }
}
