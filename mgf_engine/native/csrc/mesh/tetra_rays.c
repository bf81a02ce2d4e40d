// SPDX-License-Identifier: GPL-3.0-or-later
// Rays through tetrahedra, and points beside masks: the evidence of a visibility-weighted surface (Labatut et al.
// 2007).
//
// Sums are whole numbers (1 is 1024) that threads add to at once: their order does not matter, results repeat
// themselves.
#include <math.h>

#include "common/export.h"

enum { ONE = 1024, PIECE = 256, MOST_CELLS = 3000 };

// Tetrahedra [n] of positive volume: corners and neighbours (opposite of each corner, -1 at the rim). Planes of faces
// are worked out where a ray comes by: a table of them would take four times the memory of all that is here.
typedef struct {
    const int32_t *corner, *neighbour;  // [n][4]
    const double *points;               // [m][3]
    const int64_t *around;              // [m + 1] where the tetrahedra around each point begin in `list`
    const int32_t *list;
    int64_t count;
} Tetrahedra;

typedef double d4 __attribute__((vector_size(32)));

// Of the four faces of a tetrahedron, each opposite of a corner: outward normals as long as twice the areas, and a
// corner.
typedef struct {
    d4 normal[3], corner[3];
} Faces;

static Faces faces_of(const Tetrahedra *t, int32_t c) {
    const int32_t *v = t->corner + 4 * (int64_t)c;
    Faces f;
    d4 u[3], w[3];
    for (int k = 0; k < 3; k++) {
        const d4 x = {t->points[3 * (int64_t)v[0] + k], t->points[3 * (int64_t)v[1] + k],
                      t->points[3 * (int64_t)v[2] + k], t->points[3 * (int64_t)v[3] + k]};
        f.corner[k] = __builtin_shufflevector(x, x, 1, 0, 0, 0);
        u[k] = __builtin_shufflevector(x, x, 2, 3, 1, 2) - f.corner[k];
        w[k] = __builtin_shufflevector(x, x, 3, 2, 3, 1) - f.corner[k];
    }
    for (int k = 0; k < 3; k++) f.normal[k] = u[(k + 1) % 3] * w[(k + 2) % 3] - u[(k + 2) % 3] * w[(k + 1) % 3];
    return f;
}

static d4 slopes(const Faces *f, const double *d) {
    return f->normal[0] * d[0] + f->normal[1] * d[1] + f->normal[2] * d[2];
}

// Products of the normals with what leads from the faces to a point: how far it lies before them, times twice the
// areas.
static d4 before(const Faces *f, const double *p) {
    return f->normal[0] * (p[0] - f->corner[0]) + f->normal[1] * (p[1] - f->corner[1]) +
           f->normal[2] * (p[2] - f->corner[2]);
}

static d4 squared_lengths(const Faces *f) {
    return f->normal[0] * f->normal[0] + f->normal[1] * f->normal[1] + f->normal[2] * f->normal[2];
}

// 1 / lengths of the normals.
static d4 per_length(const Faces *f) {
    const d4 square = squared_lengths(f);
    d4 result;
    for (int k = 0; k < 4; k++) result[k] = 1 / fmax(sqrt(square[k]), 1e-300);
    return result;
}

static void add(int32_t *sum, double weight) {
    const int32_t whole = (int32_t)lrint(weight * ONE);
    if (whole) __atomic_fetch_add(sum, whole, __ATOMIC_RELAXED);
}

// The tetrahedron around point v that a ray from it enters, -1 for none; *only: its face opposite v.
static int32_t entered(const Tetrahedra *t, int64_t v, const double *d, int *only) {
    double best = INFINITY;
    int32_t found = -1;
    for (int64_t r = t->around[v]; r < t->around[v + 1]; r++) {
        const int32_t c = t->list[r];
        const Faces f = faces_of(t, c);
        const d4 slope = slopes(&f, d) * per_length(&f);
        double worst = -INFINITY;
        int own = 0;
        for (int k = 0; k < 4; k++) {
            if (t->corner[4 * (int64_t)c + k] == v) own = k;
            else worst = fmax(worst, slope[k]);
        }
        if (worst < best) best = worst, found = c, *only = own;
    }
    return found;
}

// Through which face a ray leaves a tetrahedron (only this one if `only` is not -1), and how far along; -1 for none.
static int leaves(const Tetrahedra *t, int32_t c, const double *p, const double *d, int only, double *far) {
    const Faces f = faces_of(t, c);
    const d4 slope = slopes(&f, d), least = 1e-24 * squared_lengths(&f), at = -before(&f, p) / slope;
    int face = -1;
    *far = INFINITY;
    for (int k = 0; k < 4; k++) {
        if (!(slope[k] > 0 && slope[k] * slope[k] > least[k]) || (only >= 0 && only != k)) continue;
        if (at[k] < *far) *far = at[k], face = k;
    }
    return face;
}

/* Adds what rays say: from points [r] to camera centres [views][3] with `weight` [r], less near the point (within
   `soft`); what lies `depth` behind it is inside with `behind` [r]. free [n]: the cell of the camera; solid [n];
   face [n][4]: cost of the cell being outside while its neighbour, nearer to the point, is inside. */
MGF_API void mgf_tetra_rays(int32_t *next, int64_t n, const Tetrahedra *t, const int32_t *point, const int32_t *view,
                            const double *centres, const float *weight, const float *behind, float soft, float depth,
                            int32_t *free, int32_t *solid, int32_t *face) {
    for (int64_t piece = take_work(next); piece * PIECE < n; piece = take_work(next)) {
        for (int64_t r = piece * PIECE; r < n && r < (piece + 1) * PIECE; r++) {
            const double *p = t->points + 3 * (int64_t)point[r], *centre = centres + 3 * (int64_t)view[r];
            double d[3] = {centre[0] - p[0], centre[1] - p[1], centre[2] - p[2]}, far;
            const double length = sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
            int only = -1;
            for (int k = 0; k < 3; k++) d[k] /= length;
            int32_t c = entered(t, point[r], d, &only);
            for (int step = 0; c >= 0 && step < MOST_CELLS; step++) {
                const int k = leaves(t, c, p, d, only, &far);
                only = -1;
                if (k < 0) break;
                const int32_t m = t->neighbour[4 * (int64_t)c + k];
                if (m < 0 || far >= length) {
                    add(free + c, weight[r]);
                    break;
                }
                const double off = far * far / (2 * soft * soft),
                             share = off < 38 ? 1 - exp(-off) : 1;  // the same number
                for (int q = 0; q < 4; q++)
                    if (t->neighbour[4 * (int64_t)m + q] == c) add(face + 4 * (int64_t)m + q, weight[r] * share);
                c = m;
            }
            if (!(behind[r] > 0)) continue;
            for (int k = 0; k < 3; k++) d[k] = -d[k];
            c = entered(t, point[r], d, &only);
            for (int step = 0; c >= 0 && step < MOST_CELLS; step++) {
                const int k = leaves(t, c, p, d, only, &far);
                only = -1;
                if (k < 0 || far >= depth || t->neighbour[4 * (int64_t)c + k] < 0) break;
                c = t->neighbour[4 * (int64_t)c + k];
            }
            if (c >= 0) add(solid + c, behind[r]);
        }
    }
}

// The tetrahedron that holds a point, by a walk from another; -1 if it lies outside of all.
static int32_t locate(const Tetrahedra *t, int32_t c, const double *p) {
    for (int step = 0; step < MOST_CELLS; step++) {
        const Faces f = faces_of(t, c);
        const d4 off = before(&f, p) * per_length(&f);
        int worst = -1;
        double most = 1e-12;
        for (int k = 0; k < 4; k++)
            if (off[k] > most) most = off[k], worst = k;
        if (worst < 0) return c;
        c = t->neighbour[4 * (int64_t)c + worst];
        if (c < 0) return -1;
    }
    return -1;
}

/* Pulls what lies along rays [n] (start, direction [n][3]) and is not `shut` [cells] inside: `weight`, shared by
   length. A ray that runs through more than `length` of it hardly says which part is inside, and counts less. */
MGF_API void mgf_tetra_pull(int32_t *next, int64_t n, const Tetrahedra *t, const double *start, const double *direction,
                            const uint8_t *shut, float weight, float length, int32_t *solid) {
    for (int64_t piece = take_work(next); piece * PIECE < n; piece = take_work(next)) {
        int32_t at = 0;
        for (int64_t r = piece * PIECE; r < n && r < (piece + 1) * PIECE; r++) {
            const double *p = start + 3 * r, *d = direction + 3 * r;
            const int32_t first = locate(t, at, p);
            if (first < 0) continue;
            at = first;
            double whole = 0;
            for (int turn = 0; turn < 2; turn++) {
                double begin = 0, total = 0, far;
                int32_t c = first;
                for (int step = 0; c >= 0 && step < MOST_CELLS; step++) {
                    const int k = leaves(t, c, p, d, -1, &far);
                    if (k < 0) break;
                    if (!shut[c] && far > begin) {
                        total += far - begin;
                        if (turn) add(solid + c, weight * pow(fmin(1, length / whole), 2) * (far - begin) / whole);
                    }
                    begin = fmax(begin, far);
                    c = t->neighbour[4 * (int64_t)c + k];
                }
                whole = total;
                if (!(whole > 0)) break;
            }
        }
    }
}

static double dot(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

/* result [n]: whether views call points [n][3] outside: at least `least` of them, and at least `share` of those that
   have the point in their frame. distance [views][height][width]: how far pixels lie outside of the mask, in eighths of
   a pixel, 255 for more; beyond `margin` px is outside. size [views][2]: width and height of each frame. */
MGF_API void mgf_find_outside(int32_t *next, int64_t n, const double *points, const double *projection, int64_t views,
                              const uint8_t *distance, int64_t height, int64_t width, const int32_t *size, float margin,
                              int64_t least, float share, uint8_t *result) {
    const double beyond = 8 * margin;
    for (int64_t piece = take_work(next); piece * PIECE < n; piece = take_work(next)) {
        for (int64_t i = piece * PIECE; i < n && i < (piece + 1) * PIECE; i++) {
            const double *x = points + 3 * i;
            int64_t outside = 0, framed = 0;
            for (int64_t v = 0; v < views; v++) {
                const double *p = projection + 12 * v, w = dot(p + 8, x) + p[11];
                if (w <= 0) continue;
                const double a = (dot(p, x) + p[3]) / w, b = (dot(p + 4, x) + p[7]) / w;
                if (!(a >= 0 && b >= 0 && a < size[2 * v] && b < size[2 * v + 1])) continue;
                framed++;
                outside += distance[(v * height + (int64_t)b) * width + (int64_t)a] > beyond;
                // Enough even if all other views have the point in their frame and inside.
                if (outside >= least && outside >= share * (framed + views - v - 1)) break;
            }
            result[i] = outside >= least && outside >= share * framed;
        }
    }
}
