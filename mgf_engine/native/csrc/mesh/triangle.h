// SPDX-License-Identifier: GPL-3.0-or-later
// Points, triangles and quadric error metrics (Garland and Heckbert 1997) for the reduction of meshes.
#pragma once
#include <math.h>
#include <stdint.h>

typedef struct {
    double x, y, z;
} Point;

static inline Point minus(Point a, Point b) { return (Point){a.x - b.x, a.y - b.y, a.z - b.z}; }
static inline Point plus(Point a, Point b, double t) { return (Point){a.x + t * b.x, a.y + t * b.y, a.z + t * b.z}; }
static inline double dot(Point a, Point b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
static inline Point cross(Point a, Point b) {
    return (Point){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

// Where on a triangle: shares of its corners, and the squared distance from there.
typedef struct {
    double share[3], squared;
} Foot;

// The point of the segment a b nearest to p; the share of the third corner is 0.
static inline Foot on_segment(Point p, Point a, Point b) {
    const Point ab = minus(b, a), ap = minus(p, a);
    const double length = dot(ab, ab);
    double t = length > 0 ? dot(ap, ab) / length : 0;
    t = t < 0 ? 0 : t > 1 ? 1 : t;
    const Point rest = plus(ap, ab, -t);
    return (Foot){{1 - t, t, 0}, dot(rest, rest)};
}

// The point of the triangle nearest to p; or one at an endless distance, where it is clear that none is nearer than the
// square root of `limit`.
static inline Foot on_triangle_within(Point p, const Point v[3], double limit) {
    const Point e = minus(v[1], v[0]), f = minus(v[2], v[0]), r = minus(p, v[0]);
    const double ee = dot(e, e), ef = dot(e, f), ff = dot(f, f), re = dot(r, e), rf = dot(r, f);
    const double area = ee * ff - ef * ef;
    // Beyond an edge it is at least as far as the line through that; all with room for what rounding does.
    const double of_b = ff * re - ef * rf, of_c = ee * rf - ef * re,
                 of_a = area - of_b - of_c;  // shares times the area
    const double far = (limit + 1e-14 * (ee + ff)) * 1.01 * area;
    const int beyond = ((of_b < 0) & (of_b * of_b > far * ff)) | ((of_c < 0) & (of_c * of_c > far * ee)) |
                       ((of_a < 0) & (of_a * of_a > far * (ee - 2 * ef + ff)));
    if (beyond && area > 1e-8 * ee * ff) return (Foot){{0, 0, 0}, HUGE_VAL};
    if (area > 1e-12 * ee * ff) {
        const double b = of_b / area, c = of_c / area;
        if (b >= 0 && c >= 0 && b + c <= 1) {
            const Point rest = plus(plus(r, e, -b), f, -c);
            return (Foot){{1 - b - c, b, c}, dot(rest, rest)};
        }
    }
    Foot best = on_segment(p, v[0], v[1]);
    for (int k = 1; k < 3; k++) {
        const Foot other = on_segment(p, v[k], v[(k + 1) % 3]);
        if (!(other.squared < best.squared)) continue;
        best.squared = other.squared;
        best.share[k] = other.share[0], best.share[(k + 1) % 3] = other.share[1], best.share[(k + 2) % 3] = 0;
    }
    return best;
}

// Sum over planes of weight * (distance of a point to the plane)^2: x'Ax + 2 b'x + c, and the sum of the weights.
typedef struct {
    double xx, xy, xz, yy, yz, zz, bx, by, bz, c, weight;
} Quadric;

// `n`: unit normal of a plane through p.
static inline void quadric_add_plane(Quadric *q, Point n, Point p, double weight) {
    const double d = -dot(n, p);
    q->xx += weight * n.x * n.x, q->xy += weight * n.x * n.y, q->xz += weight * n.x * n.z;
    q->yy += weight * n.y * n.y, q->yz += weight * n.y * n.z, q->zz += weight * n.z * n.z;
    q->bx += weight * n.x * d, q->by += weight * n.y * d, q->bz += weight * n.z * d;
    q->c += weight * d * d, q->weight += weight;
}

static inline Quadric quadric_sum(const Quadric *a, const Quadric *b) {
    return (Quadric){a->xx + b->xx, a->xy + b->xy, a->xz + b->xz, a->yy + b->yy, a->yz + b->yz,        a->zz + b->zz,
                     a->bx + b->bx, a->by + b->by, a->bz + b->bz, a->c + b->c,   a->weight + b->weight};
}

static inline double quadric_at(const Quadric *q, Point p) {
    const double x = p.x, y = p.y, z = p.z;
    const double value = q->xx * x * x + q->yy * y * y + q->zz * z * z + q->c +
                         2 * (q->xy * x * y + q->xz * x * z + q->yz * y * z + q->bx * x + q->by * y + q->bz * z);
    return value > 0 ? value : 0;
}

// Where the quadric is least, drawn to `middle` as by one thousandth of its weight, so that flat patches have one too.
static inline Point quadric_best(const Quadric *q, Point middle) {
    const double pull = 1e-3 * q->weight + 1e-300;
    const double xx = q->xx + pull, yy = q->yy + pull, zz = q->zz + pull, xy = q->xy, xz = q->xz, yz = q->yz;
    const Point r = {pull * middle.x - q->bx, pull * middle.y - q->by, pull * middle.z - q->bz};
    const Point i = {yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy};  // first row of the adjugate
    const double determinant = xx * i.x + xy * i.y + xz * i.z;
    const Point j = {i.y, xx * zz - xz * xz, xy * xz - xx * yz}, k = {i.z, j.z, xx * yy - xy * xy};
    if (!(determinant > 0)) return middle;
    return (Point){dot(i, r) / determinant, dot(j, r) / determinant, dot(k, r) / determinant};
}
