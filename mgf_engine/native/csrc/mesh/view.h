// SPDX-License-Identifier: GPL-3.0-or-later
// Where single points appear to a camera, in doubles; the rasterizer's own camera is in records.h.
#pragma once
#include <stdint.h>

enum { OUTSIDE = 0, INSIDE = 1 }; // of a mask; other values: unknown

// A point in camera coordinates c. pose: rotation [3][3] and translation [3].
static inline void to_camera(const double *pose, double x, double y, double z, double c[3]) {
    for (int k = 0; k < 3; k++) c[k] = pose[3 * k] * x + pose[3 * k + 1] * y + pose[3 * k + 2] * z + pose[9 + k];
}

// Is a point in camera coordinates c deeper than `near` and in the frame? Then it appears at (*u, *v), in pixels.
// intrinsics: fx, fy, cx, cy.
static inline int in_frame(const double c[3], const double *intrinsics, float near, int64_t height, int64_t width,
                           double *u, double *v) {
    if (!(c[2] > near)) return 0;
    *u = c[0] / c[2] * intrinsics[0] + intrinsics[2], *v = c[1] / c[2] * intrinsics[1] + intrinsics[3];
    return *u >= 0 && *v >= 0 && *u < width && *v < height;
}
