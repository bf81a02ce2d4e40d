// SPDX-License-Identifier: GPL-3.0-or-later
// Normals of a depth map against rendered normals, row by row: value and gradient.
//
// A pixel (x, y) of depth z is the camera-frame point P = z ((x + 0.5 - cx)/fx, (y + 0.5 - cy)/fy, 1). With central
// differences X = P(x+1) - P(x-1), Y = P(y+1) - P(y-1), the normal n = Y x X / |Y x X| faces the camera for any
// positive depths. The loss of a pixel is weight * (alpha - N.n), N the rendered (premultiplied) normal.
#pragma once
#include <stdint.h>

#define NORMAL_STRIP 16
#ifndef LANES
#define LANES 16
#endif

/* The six components of dL/dX and dL/dY of one row, and its loss and weight, each `width` floats. */
enum { GX0, GX1, GX2, GY0, GY1, GY2, LOSS, WEIGHT, ROW_PLANES };

/* Maps [height][width]; depth and weight share their row stride, normal and alpha theirs. */
typedef struct {
    const float *depth, *weight, *normal, *alpha;
    int64_t stride, image_stride, normal_plane, height, width;
    float fx, fy, cx, cy;
} Maps;

/* g_normal (three rows, g_plane floats apart) and g_alpha: where this row's gradients go. */
static inline void row_gradients(const Maps *m, int64_t y, float *restrict out, float *restrict g_normal,
                                 int64_t g_plane, float *restrict g_alpha) {
    const int64_t w = m->width;
    const int64_t plane = m->normal_plane, at = y * m->stride, step = m->stride;
    const float *restrict here = m->depth + at, *restrict up = here - step, *restrict down = here + step;
    const float *restrict weight = m->weight + at, *restrict w_up = weight - step, *restrict w_down = weight + step;
    const float *restrict alpha = m->alpha + y * m->image_stride, *restrict normal = m->normal + y * m->image_stride;
    const float ix = 1.0f / m->fx, iy = 1.0f / m->fy, v = (y + 0.5f - m->cy) * iy, v0 = v - iy, v1 = v + iy;
#pragma clang loop vectorize(enable) interleave(disable)
    for (int64_t x = 1; x < w - 1; x++) {
        int valid = (weight[x] > 0) & (weight[x - 1] > 0) & (weight[x + 1] > 0) & (w_up[x] > 0) & (w_down[x] > 0) &
                    (here[x] > 0) & (here[x - 1] > 0) & (here[x + 1] > 0) & (up[x] > 0) & (down[x] > 0);
        float u = (x + 0.5f - m->cx) * ix, a = here[x - 1], b = here[x + 1], c = up[x], d = down[x];
        float X0 = b * (u + ix) - a * (u - ix), X2 = b - a, X1 = X2 * v;
        float Y1 = d * v1 - c * v0, Y2 = d - c, Y0 = Y2 * u;
        float n0 = Y1 * X2 - Y2 * X1, n1 = Y2 * X0 - Y0 * X2, n2 = Y0 * X1 - Y1 * X0;
        float square = n0 * n0 + n1 * n1 + n2 * n2;
        valid &= square > 1e-30f;
        float k = valid ? weight[x] : 0.0f, inverse = 1.0f / __builtin_sqrtf(valid ? square : 1.0f);
        n0 *= inverse, n1 *= inverse, n2 *= inverse;
        float N0 = normal[x], N1 = normal[x + plane], N2 = normal[x + 2 * plane], dot = N0 * n0 + N1 * n1 + N2 * n2;
        out[LOSS * w + x] = k * ((valid ? alpha[x] : 0.0f) - (valid ? dot : 0.0f));
        out[WEIGHT * w + x] = k;
        g_alpha[x] = k;
        g_normal[x] = valid ? -k * n0 : 0.0f;
        g_normal[x + g_plane] = valid ? -k * n1 : 0.0f;
        g_normal[x + 2 * g_plane] = valid ? -k * n2 : 0.0f;
        float s = -k * inverse; /* dL/d(Y x X) = s (N - (N.n) n) */
        float h0 = s * (N0 - dot * n0), h1 = s * (N1 - dot * n1), h2 = s * (N2 - dot * n2);
        /* d(h . Y x X) = dX . (h x Y) + dY . (X x h) */
        out[GX0 * w + x] = valid ? h1 * Y2 - h2 * Y1 : 0.0f;
        out[GX1 * w + x] = valid ? h2 * Y0 - h0 * Y2 : 0.0f;
        out[GX2 * w + x] = valid ? h0 * Y1 - h1 * Y0 : 0.0f;
        out[GY0 * w + x] = valid ? X1 * h2 - X2 * h1 : 0.0f;
        out[GY1 * w + x] = valid ? X2 * h0 - X0 * h2 : 0.0f;
        out[GY2 * w + x] = valid ? X0 * h1 - X1 * h0 : 0.0f;
    }
}

/* dL/ddepth of one row: depth (x, y) enters X of its left and right neighbour and Y of those above and below. */
static inline void gather_depth(const Maps *m, int64_t y, const float *restrict up, const float *restrict here,
                                const float *restrict down, float *restrict g_depth) {
    const int64_t w = m->width;
    const float v = (y + 0.5f - m->cy) / m->fy, ix = 1.0f / m->fx;
    for (int64_t x = 0; x < w; x++) {
        float u = (x + 0.5f - m->cx) * ix, sum = up[GY0 * w + x] * u + up[GY1 * w + x] * v + up[GY2 * w + x];
        g_depth[x] = sum - (down[GY0 * w + x] * u + down[GY1 * w + x] * v + down[GY2 * w + x]);
    }
    for (int64_t x = 1; x < w - 1; x++) {
        float u = (x + 0.5f - m->cx) * ix;
        g_depth[x] += (here[GX0 * w + x - 1] - here[GX0 * w + x + 1]) * u +
                      (here[GX1 * w + x - 1] - here[GX1 * w + x + 1]) * v + here[GX2 * w + x - 1] -
                      here[GX2 * w + x + 1];
    }
    g_depth[0] -= here[GX0 * w + 1] * (0.5f - m->cx) * ix + here[GX1 * w + 1] * v + here[GX2 * w + 1];
    g_depth[w - 1] +=
        here[GX0 * w + w - 2] * (w - 0.5f - m->cx) * ix + here[GX1 * w + w - 2] * v + here[GX2 * w + w - 2];
}

static inline double sum_row(const float *v, int64_t n) {
    double part[LANES] = {0}, total = 0;
    int64_t i = 0;
    for (; i + LANES <= n; i += LANES)
        for (int k = 0; k < LANES; k++) part[k] += v[i + k];
    for (; i < n; i++) total += v[i];
    for (int k = 0; k < LANES; k++) total += part[k];
    return total;
}
