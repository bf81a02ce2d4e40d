// SPDX-License-Identifier: GPL-3.0-or-later
// Second-order smoothing of a map: least squares of a data term and of robust second differences along rows and
// columns, by iteratively reweighted conjugate gradients with the diagonal as preconditioner.
//
// Every array is a padded plane [height + 2 * ROWS][stride], zero in its margins of ROWS rows and at least COLUMNS
// columns to either side, so that no loop asks where the picture ends. A second difference is kept at the middle of its
// three.
#include <math.h>

#include "common/export.h"
#include "common/vector.h"

enum { ROWS = 2, COLUMNS = VECTOR };

// The least squares: sum of weight (x - target)^2 + down (second difference along columns)^2 + across (along rows)^2.
typedef struct {
    int64_t height, width, stride;
    const float *weight, *target;
    float *down, *across;
} System;

static float lanes_sum(v16 x) {
    float sum = 0;
    for (int i = 0; i < VECTOR; i++) sum += x[i];
    return sum;
}

static v16 second(const float *x, int64_t step) { return load16(x - step) - 2.0f * load16(x) + load16(x + step); }

// Weighted second differences along one axis, times their transpose.
static v16 bend(const float *weight, const float *x, int64_t step) {
    const v16 before = load16(weight - step) * second(x - step, step), here = load16(weight) * second(x, step);
    return before - 2.0f * here + load16(weight + step) * second(x + step, step);
}

static v16 bend_diagonal(const float *weight, int64_t step) {
    return load16(weight - step) + 4.0f * load16(weight) + load16(weight + step);
}

// y = (matrix of the least squares) x; returns the product of both.
static double apply(const System *s, const float *x, float *y) {
    double product = 0;
    for (int64_t r = ROWS; r < ROWS + s->height; r++) {
        v16 sum = splat(0.0f);
        for (int64_t i = r * s->stride + COLUMNS; i < r * s->stride + COLUMNS + s->width; i += VECTOR) {
            const v16 here = load16(x + i);
            const v16 out =
                load16(s->weight + i) * here + bend(s->down + i, x + i, s->stride) + bend(s->across + i, x + i, 1);
            store16(y + i, out);
            sum += here * out;
        }
        product += lanes_sum(sum);
    }
    return product;
}

// The weights of the second differences, smaller at creases; `joined` is 1 where the three belong to one surface.
static void reweight(const System *s, const float *x, const float *joined_down, const float *joined_across,
                     float strength, float crease, float *inverse) {
    const float scale = 1.0f / crease;
    for (int64_t r = ROWS; r < ROWS + s->height; r++)
        for (int64_t i = r * s->stride + COLUMNS; i < r * s->stride + COLUMNS + s->width; i += VECTOR) {
            const v16 down = second(x + i, s->stride) * scale, across = second(x + i, 1) * scale;
            store16(s->down + i, load16(joined_down + i) * (strength / vsqrt(1.0f + down * down)));
            store16(s->across + i, load16(joined_across + i) * (strength / vsqrt(1.0f + across * across)));
        }
    for (int64_t r = ROWS; r < ROWS + s->height; r++)
        for (int64_t i = r * s->stride + COLUMNS; i < r * s->stride + COLUMNS + s->width; i += VECTOR) {
            const v16 diagonal =
                load16(s->weight + i) + bend_diagonal(s->down + i, s->stride) + bend_diagonal(s->across + i, 1);
            const i16 known = diagonal > 0.0f;
            store16(inverse + i, keep(known, 1.0f / choose(known, diagonal, splat(1.0f))));
        }
}

// The residual of the least squares at x, the first direction, and the product of the two.
static double begin(const System *s, const float *x, const float *inverse, float *residual, float *direction) {
    double product = 0;
    apply(s, x, residual);
    for (int64_t r = ROWS; r < ROWS + s->height; r++) {
        v16 sum = splat(0.0f);
        for (int64_t i = r * s->stride + COLUMNS; i < r * s->stride + COLUMNS + s->width; i += VECTOR) {
            const v16 left = load16(s->weight + i) * load16(s->target + i) - load16(residual + i);
            const v16 way = load16(inverse + i) * left;
            store16(residual + i, left), store16(direction + i, way);
            sum += left * way;
        }
        product += lanes_sum(sum);
    }
    return product;
}

// Goes `length` along the direction; returns the new product of the residual and the preconditioned residual.
static double advance(const System *s, float length, const float *moved, const float *inverse, const float *direction,
                      float *x, float *residual) {
    double product = 0;
    for (int64_t r = ROWS; r < ROWS + s->height; r++) {
        v16 sum = splat(0.0f);
        for (int64_t i = r * s->stride + COLUMNS; i < r * s->stride + COLUMNS + s->width; i += VECTOR) {
            store16(x + i, load16(x + i) + length * load16(direction + i));
            const v16 left = load16(residual + i) - length * load16(moved + i);
            store16(residual + i, left);
            sum += left * left * load16(inverse + i);
        }
        product += lanes_sum(sum);
    }
    return product;
}

static void turn(const System *s, float share, const float *residual, const float *inverse, float *direction) {
    for (int64_t r = ROWS; r < ROWS + s->height; r++)
        for (int64_t i = r * s->stride + COLUMNS; i < r * s->stride + COLUMNS + s->width; i += VECTOR)
            store16(direction + i, load16(inverse + i) * load16(residual + i) + share * load16(direction + i));
}

/* x: where to start and the result. scratch: six planes. width is rounded up to whole vectors; weight and joined are
   0 there and wherever nothing is known. strength: weight of the squared second differences; crease: second difference
   from which it counts as a crease; rounds of reweighting, of `steps` conjugate gradients each. */
MGF_API void mgf_smooth_depth(int64_t height, int64_t width, int64_t stride, const float *weight, const float *target,
                              const float *joined_down, const float *joined_across, float strength, float crease,
                              int64_t rounds, int64_t steps, float *x, float *scratch) {
    const int64_t size = (height + 2 * ROWS) * stride;
    float *inverse = scratch + 2 * size, *residual = inverse + size, *direction = residual + size,
          *moved = direction + size;
    const System s = {height, (width + VECTOR - 1) / VECTOR * VECTOR, stride, weight, target, scratch, scratch + size};
    for (int64_t round = 0; round < rounds; round++) {
        reweight(&s, x, joined_down, joined_across, strength, crease, inverse);
        double product = begin(&s, x, inverse, residual, direction);
        for (int64_t step = 0; step < steps; step++) {
            const double curvature = apply(&s, direction, moved);
            if (!(product > 0 && curvature > 0)) break;
            const double before = product;
            product = advance(&s, (float)(product / curvature), moved, inverse, direction, x, residual);
            turn(&s, (float)(product / before), residual, inverse, direction);
        }
    }
}
