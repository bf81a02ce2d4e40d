// SPDX-License-Identifier: GPL-3.0-or-later
// The exact footprint of a Gaussian in the image and the tiles it touches.
//
// contribution >= 1/255 means q <= k A with k = 2 ln(255 opacity) (records.h): a conic
//     a x^2 + 2 b x y + d y^2 + 2 e x + 2 f y <= k,
//     a = q0 - k a3, b = q1 - k a4, d = q2 - k a5, e = -k a1/2, f = -k a2/2
// around the projected centre. It is an ellipse when a > 0 and a d > b^2. Else the Gaussian reaches the plane of the
// camera (or holds the camera): then it is listed in every tile, and the test per pixel decides, so nothing is lost.
//
// Shifted to its own centre the ellipse is a x^2 + 2 b x y + d y^2 <= v. At height y it spans
//     x = slope y +- sqrt(v/a - (a d - b^2)/a^2 y^2),   slope = -b/a,
// and reaches furthest right at y_right = -b/d half_x. So the tiles of one tile row that it touches are one interval.
#pragma once
#include "raster/records.h"
#include "common/vector.h"

typedef struct {
    float x, y;            // centre of the ellipse, pixels
    float slope, width2, fall;  // span at height y: slope y +- sqrt(width2 - fall y^2)
    float y_right;
    float half_y;
    float whole;           // 1: no ellipse, listed everywhere
} Footprint;

// Rounding in the blending kernel must never find a pixel outside the listed tiles.
#define FOOTPRINT_GROWTH 1.002
#define FOOTPRINT_MARGIN 0.02f
#define FOOTPRINT_FAR 1e8f  // stands for infinity in the extents

enum { SHAPE_SIZE = 8 };  // columns of a Footprint

// The footprints of sixteen Gaussians, column by column as in Footprint, and the columns of their records that tell the
// extent; k as above. In double: for Gaussians seen from the side a d and b^2 are nearly the same.
static inline void footprint_columns(v16 *rec, d16 k, const Camera *camera, v16 *shape) {
    const d16 a = widen(rec[REC_Q0]) - k * widen(rec[REC_A3]), b = widen(rec[REC_Q1]) - k * widen(rec[REC_A4]),
              d = widen(rec[REC_Q2]) - k * widen(rec[REC_A5]), e = -0.5 * k * widen(rec[REC_A1]),
              f = -0.5 * k * widen(rec[REC_A2]);
    const d16 det = a * d - b * b, inv = 1.0 / det, inv_a = 1.0 / a;
    const d16 mx = (b * f - d * e) * inv, my = (b * e - a * f) * inv;
    const d16 v = (k - e * mx - f * my) * FOOTPRINT_GROWTH;
    const d16 half_x = dsqrt(d * v * inv), half_y = dsqrt(a * v * inv);
    const d16 x = widen(rec[REC_CX]) + mx, y = widen(rec[REC_CY]) + my;
    const v16 hx = narrow(half_x), hy = narrow(half_y), cx = narrow(x), cy = narrow(y), far = splat(FOOTPRINT_FAR);
    const float diagonal = 0.5f * __builtin_sqrtf(camera->width * camera->width + camera->height * camera->height);
    const i16 ellipse = (narrow(a) > 0.0f) & (narrow(det) > 0.0f) & (hx < far) & (hy < far) & (cx < far) & (cx > -far) &
                        (cy < far) & (cy > -far);
    rec[REC_SLOPE] = keep(ellipse, narrow(-b * inv_a)), rec[REC_FALL] = keep(ellipse, narrow(det * inv_a * inv_a));
    rec[REC_WIDTH2] = narrow(v * inv_a), rec[REC_Y_RIGHT] = keep(ellipse, narrow(-b / d * half_x));
    shape[0] = keep(ellipse, cx), shape[1] = keep(ellipse, cy), shape[2] = rec[REC_SLOPE];
    shape[3] = keep(ellipse, rec[REC_WIDTH2]), shape[4] = rec[REC_FALL], shape[5] = rec[REC_Y_RIGHT];
    shape[6] = keep(ellipse, hy), shape[7] = choose(ellipse, splat(0.0f), splat(1.0f));
    rec[REC_WIDTH2] = choose(ellipse, rec[REC_WIDTH2], far * far);
    rec[REC_X0] = choose(ellipse, narrow(x - half_x) - FOOTPRINT_MARGIN, -far);
    rec[REC_X1] = choose(ellipse, narrow(x + half_x) + FOOTPRINT_MARGIN, far);
    rec[REC_Y0] = choose(ellipse, narrow(y - half_y) - FOOTPRINT_MARGIN, -far);
    rec[REC_Y1] = choose(ellipse, narrow(y + half_y) + FOOTPRINT_MARGIN, far);
    rec[REC_RADIUS] = choose(ellipse, vmin(vmax(hx, hy), splat(diagonal)), splat(diagonal));
}

static inline int clamp_int(float x, int low, int high) { return x<(float)low ? low : x>(float) high ? high : (int)x; }

// First and last of the tiles along one axis whose pixel centres come within low..high; empty when first > last.
static inline void tile_interval(float low, float high, int tiles, int *first, int *last) {
    *first = clamp_int(__builtin_ceilf((low - (TILE - 0.5f)) / TILE), 0, tiles);
    *last = clamp_int(__builtin_floorf((high - 0.5f) / TILE), -1, tiles - 1);
}

static inline void tile_rows(const Footprint *p, int tiles_y, int *first, int *last) {
    if (p->whole > 0.0f) {
        *first = 0, *last = tiles_y - 1;
        return;
    }
    tile_interval(p->y - p->half_y - FOOTPRINT_MARGIN, p->y + p->half_y + FOOTPRINT_MARGIN, tiles_y, first, last);
}

static inline float within(float x, float low, float high) { return x < low ? low : x > high ? high : x; }

// The tiles of row ty that the footprint touches.
static inline void tile_columns(const Footprint *p, int ty, int tiles_x, int *first, int *last) {
    if (p->whole > 0.0f) {
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
