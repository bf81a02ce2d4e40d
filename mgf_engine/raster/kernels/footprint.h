// SPDX-License-Identifier: GPL-3.0-or-later
// The exact footprint of a Gaussian in the image and the tiles it touches.
//
// contribution >= 1/255 means q <= k A with k = 2 ln(255 opacity) (records.h): a conic
//     a x^2 + 2 b x y + d y^2 + 2 e x + 2 f y <= k,   a = q0 - k a3, b = q1 - k a4, d = q2 - k a5, e = -k a1/2, f = -k a2/2
// around the projected centre. It is an ellipse when a > 0 and a d > b^2. Else the Gaussian reaches the plane of the
// camera (or holds the camera): then it is listed in every tile, and the test per pixel decides, so nothing is lost.
//
// Shifted to its own centre the ellipse is a x^2 + 2 b x y + d y^2 <= v. At height y it spans
//     x = slope y +- sqrt(v/a - (a d - b^2)/a^2 y^2),   slope = -b/a,
// and reaches furthest right at y_right = -b/d half_x. So the tiles of one tile row that it touches are one interval.
#pragma once
#include "records.h"

typedef struct {
    float x, y;            // centre of the ellipse, pixels
    float slope, width2, fall;  // span at height y: slope y +- sqrt(width2 - fall y^2)
    float y_right;
    float half_y;
    int32_t whole;         // 1: no ellipse, listed everywhere
} Footprint;

// Rounding in the blending kernel must never find a pixel outside the listed tiles.
#define FOOTPRINT_GROWTH 1.002
#define FOOTPRINT_MARGIN 0.02f
#define FOOTPRINT_FAR 1e8f  // stands for infinity in the extents

// Sets the footprint and the extent columns of the record.
static inline void make_footprint(float *record, double k, const Camera *camera, Footprint *out) {
    const double a = record[REC_Q0] - k * record[REC_A3], b = record[REC_Q1] - k * record[REC_A4],
                 d = record[REC_Q2] - k * record[REC_A5], e = -0.5 * k * record[REC_A1], f = -0.5 * k * record[REC_A2];
    const double det = a * d - b * b, inv = 1.0 / det;
    const double mx = (b * f - d * e) * inv, my = (b * e - a * f) * inv;
    const double v = (k - e * mx - f * my) * FOOTPRINT_GROWTH;
    const double half_x = __builtin_sqrt(d * v * inv), half_y = __builtin_sqrt(a * v * inv);
    const double x = record[REC_CX] + mx, y = record[REC_CY] + my;
    const float diagonal = 0.5f * __builtin_sqrtf(camera->width * camera->width + camera->height * camera->height);
    if (!(a > 0.0 && det > 0.0 && half_x < FOOTPRINT_FAR && half_y < FOOTPRINT_FAR && __builtin_fabs(x) < FOOTPRINT_FAR &&
          __builtin_fabs(y) < FOOTPRINT_FAR)) {
        const Footprint everywhere = {0, 0, 0, 0, 0, 0, 0, 1};
        *out = everywhere;
        record[REC_X0] = record[REC_Y0] = -FOOTPRINT_FAR, record[REC_X1] = record[REC_Y1] = FOOTPRINT_FAR;
        record[REC_SLOPE] = record[REC_FALL] = record[REC_Y_RIGHT] = 0.0f, record[REC_WIDTH2] = FOOTPRINT_FAR * FOOTPRINT_FAR;
        record[REC_RADIUS] = diagonal;
        return;
    }
    out->x = (float)x, out->y = (float)y;
    out->slope = (float)(-b / a), out->width2 = (float)(v / a), out->fall = (float)(det / (a * a));
    out->y_right = (float)(-b / d * half_x), out->half_y = (float)half_y;
    out->whole = 0;
    record[REC_SLOPE] = out->slope, record[REC_WIDTH2] = out->width2;
    record[REC_FALL] = out->fall, record[REC_Y_RIGHT] = out->y_right;
    record[REC_X0] = (float)(x - half_x) - FOOTPRINT_MARGIN, record[REC_X1] = (float)(x + half_x) + FOOTPRINT_MARGIN;
    record[REC_Y0] = (float)(y - half_y) - FOOTPRINT_MARGIN, record[REC_Y1] = (float)(y + half_y) + FOOTPRINT_MARGIN;
    const float radius = (float)(half_x > half_y ? half_x : half_y);
    record[REC_RADIUS] = radius < diagonal ? radius : diagonal;
}

static inline int clamp_int(float x, int low, int high) { return x < (float)low ? low : x > (float)high ? high : (int)x; }

// First and last of the tiles along one axis whose pixel centres come within low..high; empty when first > last.
static inline void tile_interval(float low, float high, int tiles, int *first, int *last) {
    *first = clamp_int(__builtin_ceilf((low - (TILE - 0.5f)) / TILE), 0, tiles);
    *last = clamp_int(__builtin_floorf((high - 0.5f) / TILE), -1, tiles - 1);
}

static inline void tile_rows(const Footprint *p, int tiles_y, int *first, int *last) {
    if (p->whole) {
        *first = 0, *last = tiles_y - 1;
        return;
    }
    tile_interval(p->y - p->half_y - FOOTPRINT_MARGIN, p->y + p->half_y + FOOTPRINT_MARGIN, tiles_y, first, last);
}

static inline float within(float x, float low, float high) { return x < low ? low : x > high ? high : x; }

// The tiles of row ty that the footprint touches.
static inline void tile_columns(const Footprint *p, int ty, int tiles_x, int *first, int *last) {
    if (p->whole) {
        *first = 0, *last = tiles_x - 1;
        return;
    }
    const float top = within((float)(ty * TILE) + 0.5f - FOOTPRINT_MARGIN - p->y, -p->half_y, p->half_y);
    const float bottom = within((float)(ty * TILE + TILE) - 0.5f + FOOTPRINT_MARGIN - p->y, -p->half_y, p->half_y);
    const float yr = within(p->y_right, top, bottom), yl = within(-p->y_right, top, bottom);
    const float wr = p->width2 - p->fall * yr * yr, wl = p->width2 - p->fall * yl * yl;
    const float grow = FOOTPRINT_MARGIN + 1e-3f * __builtin_sqrtf(p->width2);
    const float right = p->slope * yr + __builtin_sqrtf(wr > 0 ? wr : 0) + grow;
    const float left = p->slope * yl - __builtin_sqrtf(wl > 0 ? wl : 0) - grow;
    tile_interval(p->x + left, p->x + right, tiles_x, first, last);
}
