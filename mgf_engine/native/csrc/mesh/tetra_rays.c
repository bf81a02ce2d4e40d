// SPDX-License-Identifier: GPL-3.0-or-later
// Rays through tetrahedra, and points beside masks: the evidence of a visibility-weighted surface (Labatut et al. 2007).
//
// Sums are whole numbers (1 is 1024) that threads add to at once: their order does not matter, results repeat themselves.
#include <math.h>

#include "common/export.h"

enum { ONE = 1024, PIECE = 256, MOST_CELLS = 3000 };

// Tetrahedra [n]: corners, neighbours (opposite of each corner, -1 at the rim), outward planes of the faces opposite each.
typedef struct {
    const int32_t *corner, *neighbour;  // [n][4]
    const double *plane;                // [n][4][4], unit normal and offset
    const double *points;               // [m][3]
    const int64_t *around;              // [m + 1] where the tetrahedra around each point begin in `list`
    const int32_t *list;
    int64_t count;
} Tetrahedra;

static void add(int32_t *sum, double weight) {
    const int32_t whole = (int32_t)lrint(weight * ONE);
    if (whole) __atomic_fetch_add(sum, whole, __ATOMIC_RELAXED);
}

static double slope(const double *plane, const double *d) { return plane[0] * d[0] + plane[1] * d[1] + plane[2] * d[2]; }

// The tetrahedron around point v that a ray from it enters, -1 for none; *only: its face opposite v.
static int32_t entered(const Tetrahedra *t, int64_t v, const double *d, int *only) {
    double best = INFINITY;
    int32_t found = -1;
    for (int64_t r = t->around[v]; r < t->around[v + 1]; r++) {
        const int32_t c = t->list[r];
        double worst = -INFINITY;
        int own = 0;
        for (int k = 0; k < 4; k++) {
            if (t->corner[4 * (int64_t)c + k] == v) own = k;
            else worst = fmax(worst, slope(t->plane + 16 * (int64_t)c + 4 * k, d));
        }
        if (worst < best) best = worst, found = c, *only = own;
    }
    return found;
}

// Through which face a ray leaves a tetrahedron (only this one if `only` is not -1), and how far along; -1 for none.
static int leaves(const Tetrahedra *t, int32_t c, const double *p, const double *d, int only, double *far) {
    int face = -1;
    *far = INFINITY;
    for (int k = 0; k < 4; k++) {
        const double *plane = t->plane + 16 * (int64_t)c + 4 * k, s = slope(plane, d);
        if (s <= 1e-12 || (only >= 0 && only != k)) continue;
        const double at = -(slope(plane, p) + plane[3]) / s;
        if (at < *far) *far = at, face = k;
    }
    return face;
}

/* Adds what rays say: from points [r] to camera centres [views][3] with `weight` [r], less near the point (within
   `soft`); what lies `depth` behind it is inside with `behind` [r]. free [n]: the cell of the camera; solid [n];
   face [n][4]: cost of the cell being outside while its neighbour, nearer to the point, is inside. */
MGF_API void mgf_cast_rays(int32_t *next, int64_t n, const Tetrahedra *t, const int32_t *point, const int32_t *view,
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
                for (int q = 0; q < 4; q++)
                    if (t->neighbour[4 * (int64_t)m + q] == c)
                        add(face + 4 * (int64_t)m + q, weight[r] * (1 - exp(-far * far / (2 * soft * soft))));
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
        int worst = -1;
        double most = 1e-12;
        for (int k = 0; k < 4; k++) {
            const double *plane = t->plane + 16 * (int64_t)c + 4 * k, off = slope(plane, p) + plane[3];
            if (off > most) most = off, worst = k;
        }
        if (worst < 0) return c;
        c = t->neighbour[4 * (int64_t)c + worst];
        if (c < 0) return -1;
    }
    return -1;
}

/* Pulls what lies along rays [n] (start, direction [n][3]) and is not `shut` [cells] inside: `weight`, shared by length. A
   ray that runs through more than `length` of it hardly says which part is inside, and counts less. */
MGF_API void mgf_pull_rays(int32_t *next, int64_t n, const Tetrahedra *t, const double *start, const double *direction,
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

/* result [n]: whether views call points [n][3] outside: at least `least` of them, and at least `share` of those that have
   the point in their frame. distance [views][height][width]: how far pixels lie outside of the mask, in eighths of a
   pixel, 255 for more; beyond `margin` px is outside. size [views][2]: width and height of each frame. */
MGF_API void mgf_find_outside(int32_t *next, int64_t n, const double *points, const double *projection, int64_t views,
                              const uint8_t *distance, int64_t height, int64_t width, const int32_t *size, float margin,
                              int64_t least, float share, uint8_t *result) {
    const double beyond = 8 * margin;
    for (int64_t piece = take_work(next); piece * PIECE < n; piece = take_work(next)) {
        for (int64_t i = piece * PIECE; i < n && i < (piece + 1) * PIECE; i++) {
            const double *x = points + 3 * i;
            int64_t outside = 0, framed = 0;
            for (int64_t v = 0; v < views; v++) {
                const double *p = projection + 12 * v, w = slope(p + 8, x) + p[11];
                if (w <= 0) continue;
                const double a = (slope(p, x) + p[3]) / w, b = (slope(p + 4, x) + p[7]) / w;
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
