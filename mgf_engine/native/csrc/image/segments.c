// SPDX-License-Identifier: GPL-3.0-or-later
// Straight edges of photos matched to lines in space (after Hofer et al. 2017, Line3D++): a pair of segments gives a
// line, segments of other photos vote for it, least squares puts it where all of them want it.
//
// Segments are directed, brighter side always on the same hand, so that edges of opposite gradient never match. A grid
// of cells over each photo tells which segments pass near a pixel; a vote asks four cells instead of all segments.
#include <math.h>
#include <string.h>

#include "common/export.h"

enum { QUERIES = 4, ROUNDS = 4, MOST_VIEWS = 4096 };
static const double MOST_WEIGHT = 60, HUBER = 0.7;  // px: longer segments count no more; residuals beyond count less

// All photos' segments, those of one photo beside each other.
typedef struct {
    const double *ends;        // [n][4] x1 y1 x2 y2, pixels
    const float *sides;        // [n][2][3] Lab of the brighter and the darker side
    const double *rays;        // [n][2][3] unit directions of the ends, in space
    const double *normals;     // [n][3] of the planes through camera and segment
    const int32_t *view;       // [n]
    const double *projection;  // [views][12]
    const double *centre;      // [views][3]
    const int32_t *first;      // [views + 1] first segment of each photo
    const int32_t *grid;       // [views][3] columns, rows, first cell of each photo's grid
    const int32_t *cell;       // [cells + 1] where each cell's segments begin in `near`
    const int32_t *near;
    int64_t views;
    double cell_size, reach, color, overlap;  // px, px, Lab, share of the line
} Segments;

typedef struct {
    double x[2][3];
} Line;

static double dot3(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static int project(const double *p, const double *x, double *uv) {
    const double w = dot3(p + 8, x) + p[11];
    if (w <= 0) return 0;
    uv[0] = (dot3(p, x) + p[3]) / w, uv[1] = (dot3(p + 4, x) + p[7]) / w;
    return 1;
}

// Has at least one side the same colour? Lightness counts a third: it changes with the view.
static int same_color(const float *a, const float *b, double most) {
    for (int k = 0; k < 2; k++) {
        const double l = (a[3 * k] - b[3 * k]) / 3, u = a[3 * k + 1] - b[3 * k + 1], v = a[3 * k + 2] - b[3 * k + 2];
        if (l * l + u * u + v * v < most * most) return 1;
    }
    return 0;
}

// How well segment m covers a line in its photo, 0..1: from a [2] along the unit direction d [2], `length` pixels; both
// ends of the segment must lie within `reach` pixels of it.
static double support(const Segments *s, int32_t m, const double *a, const double *d, double length, double reach) {
    const double *e = s->ends + 4 * m;
    const double e1 = fabs((e[0] - a[0]) * d[1] - (e[1] - a[1]) * d[0]);
    const double e2 = fabs((e[2] - a[0]) * d[1] - (e[3] - a[1]) * d[0]);
    if (e1 > reach || e2 > reach) return 0;
    const double t1 = (e[0] - a[0]) * d[0] + (e[1] - a[1]) * d[1], t2 = (e[2] - a[0]) * d[0] + (e[3] - a[1]) * d[1];
    if (t2 <= t1) return 0;  // the gradient is the other way round
    const double over = fmin(t2, length) - fmax(t1, 0);
    if (over < s->overlap * length) return 0;
    const double e0 = 0.5 * (e1 + e2);
    return exp(-2 * e0 * e0 / (reach * reach)) * fmin(1.0, over / length);
}

// The segment of a photo that fits a line best, -1 for none; its score 0..1.
static int32_t vote(const Segments *s, int64_t view, const Line *line, const float *sides, double *score) {
    double a[2], b[2];
    *score = 0;
    const double *p = s->projection + 12 * view;
    if (!project(p, line->x[0], a) || !project(p, line->x[1], b)) return -1;
    double d[2] = {b[0] - a[0], b[1] - a[1]};
    const double length = sqrt(d[0] * d[0] + d[1] * d[1]);
    if (!(length >= 4)) return -1;
    d[0] /= length, d[1] /= length;
    const int32_t *grid = s->grid + 3 * view;
    int32_t best = -1;
    for (int q = 0; q < QUERIES; q++) {
        const double t = (q + 0.5) / QUERIES * length;
        const double x = (a[0] + t * d[0]) / s->cell_size, y = (a[1] + t * d[1]) / s->cell_size;
        if (!(x >= 0 && y >= 0 && x < grid[0] && y < grid[1])) continue;
        const int32_t cell = grid[2] + (int32_t)y * grid[0] + (int32_t)x;
        for (int32_t k = s->cell[cell]; k < s->cell[cell + 1]; k++) {
            const int32_t m = s->near[k];
            const double found = support(s, m, a, d, length, s->reach);
            if (found > *score && same_color(sides, s->sides + 6 * m, s->color)) *score = found, best = m;
        }
    }
    return best;
}

// The line that segments n and m make, in the box; 0 for none.
static int line_of(const Segments *s, int64_t n, int32_t m, double least_sine, const double *low, const double *high,
                   Line *line) {
    const double *p = s->normals + 3 * n, *q = s->normals + 3 * m;
    const double c[3] = {p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]};
    if (dot3(c, c) < least_sine * least_sine) return 0;
    const double *from = s->centre + 3 * s->view[n], *to = s->centre + 3 * s->view[m];
    const double away[3] = {to[0] - from[0], to[1] - from[1], to[2] - from[2]}, off = dot3(away, q);
    for (int e = 0; e < 2; e++) {
        const double *ray = s->rays + 6 * n + 3 * e, slope = dot3(ray, q);
        if (fabs(slope) < 1e-4) return 0;
        const double depth = off / slope;
        if (depth <= 0) return 0;
        for (int k = 0; k < 3; k++) {
            const double x = from[k] + depth * ray[k];
            if (!(x > low[k] && x < high[k])) return 0;
            line->x[e][k] = x;
        }
    }
    return 1;
}

// Whether segment m lies on a line in space, within a pixel.
static int covers(const Segments *s, int32_t m, const Line *line) {
    double a[2], b[2];
    const double *p = s->projection + 12 * s->view[m];
    if (!project(p, line->x[0], a) || !project(p, line->x[1], b)) return 0;
    double d[2] = {b[0] - a[0], b[1] - a[1]};
    const double length = sqrt(d[0] * d[0] + d[1] * d[1]);
    if (!(length >= 4)) return 0;
    d[0] /= length, d[1] /= length;
    return support(s, m, a, d, length, 1.0) > 0;
}

/* lines [n][2][3] and score [n]: of each segment the line in space that most photos see, score 0 where there is none.
   neighbours [views][count]: photos each photo is compared with, -1 for none; box [2][3]: lines must lie in it. */
MGF_API void mgf_match_segments(int32_t *next, int64_t n, const Segments *s, const int32_t *neighbours, int64_t count,
                                const double *box, float least_sine, double *lines, double *score) {
    for (int64_t i = take_work(next); i < n; i = take_work(next)) {
        const int32_t *others = neighbours + count * s->view[i];
        score[i] = 0;
        for (int64_t j = 0; j < count; j++) {
            if (others[j] < 0) continue;
            for (int32_t m = s->first[others[j]]; m < s->first[others[j] + 1]; m++) {
                Line line;
                if (!same_color(s->sides + 6 * i, s->sides + 6 * m, s->color)) continue;
                if (!line_of(s, i, m, least_sine, box, box + 3, &line) || !covers(s, m, &line)) continue;
                double total = 0, one;
                for (int64_t k = 0; k < count; k++)
                    if (others[k] >= 0) vote(s, others[k], &line, s->sides + 6 * i, &one), total += one;
                if (total > score[i]) score[i] = total, memcpy(lines + 6 * i, &line, sizeof line);
            }
        }
    }
}

// Distances in pixels of a segment's ends from a line's projection; 0 if the line is not in front.
static int residual(const Segments *s, int32_t m, const Line *line, double *r) {
    double a[2], b[2];
    const double *p = s->projection + 12 * s->view[m], *e = s->ends + 4 * m;
    if (!project(p, line->x[0], a) || !project(p, line->x[1], b)) return 0;
    const double dx = b[0] - a[0], dy = b[1] - a[1], length = sqrt(dx * dx + dy * dy);
    if (!(length > 1e-9)) return 0;
    r[0] = ((e[0] - a[0]) * dy - (e[1] - a[1]) * dx) / length,
    r[1] = ((e[2] - a[0]) * dy - (e[3] - a[1]) * dx) / length;
    return 1;
}

static void across(const Line *line, double a[2][3]) {
    double d[3];
    for (int k = 0; k < 3; k++) d[k] = line->x[1][k] - line->x[0][k];
    const double length = sqrt(dot3(d, d)) + 1e-30;
    int least = 0;
    for (int k = 0; k < 3; k++) d[k] /= length;
    for (int k = 1; k < 3; k++) least = fabs(d[k]) < fabs(d[least]) ? k : least;
    for (int k = 0; k < 3; k++) a[0][k] = (k == least) - d[k] * d[least];
    const double size = sqrt(dot3(a[0], a[0]));
    for (int k = 0; k < 3; k++) a[0][k] /= size;
    for (int k = 0; k < 3; k++) a[1][k] = d[(k + 1) % 3] * a[0][(k + 2) % 3] - d[(k + 2) % 3] * a[0][(k + 1) % 3];
}

// Solves a 4 x 4 system in place by elimination with pivots; 0 if it is singular.
static int solve4(double a[4][5]) {
    for (int c = 0; c < 4; c++) {
        int best = c;
        for (int r = c + 1; r < 4; r++) best = fabs(a[r][c]) > fabs(a[best][c]) ? r : best;
        if (fabs(a[best][c]) < 1e-300) return 0;
        for (int k = 0; k < 5; k++) {
            const double t = a[c][k];
            a[c][k] = a[best][k], a[best][k] = t;
        }
        for (int r = 0; r < 4; r++) {
            if (r == c) continue;
            const double f = a[r][c] / a[c][c];
            for (int k = c; k < 5; k++) a[r][k] -= f * a[c][k];
        }
    }
    for (int c = 0; c < 4; c++) a[c][4] /= a[c][c];
    return 1;
}

// One robust Gauss-Newton step of both ends across the line.
static void improve(const Segments *s, const int32_t *rows, int64_t count, double pixel, Line *line) {
    double a[2][3], n[4][5] = {0};
    across(line, a);
    const double h = 0.01 * pixel;
    for (int64_t i = 0; i < count; i++) {
        double r[2], moved[2], j[2][4];
        if (rows[i] < 0 || !residual(s, rows[i], line, r)) continue;
        const double *e = s->ends + 4 * rows[i];
        const double length = fmin(hypot(e[2] - e[0], e[3] - e[1]), MOST_WEIGHT) / 20;
        int good = 1;
        for (int k = 0; k < 4 && good; k++) {
            Line other = *line;
            for (int c = 0; c < 3; c++) other.x[k / 2][c] += h * a[k % 2][c];
            good = residual(s, rows[i], &other, moved);
            for (int q = 0; q < 2; q++) j[q][k] = (moved[q] - r[q]) / h;
        }
        if (!good) continue;
        for (int q = 0; q < 2; q++) {
            const double w = length * fmin(1.0, HUBER / fmax(fabs(r[q]), 1e-9));
            for (int k = 0; k < 4; k++) {
                for (int c = 0; c < 4; c++) n[k][c] += w * j[q][k] * j[q][c];
                n[k][4] -= w * j[q][k] * r[q];
            }
        }
    }
    for (int k = 0; k < 4; k++) n[k][k] += 1e-6 / (pixel * pixel);
    if (!solve4(n)) return;
    for (int k = 0; k < 4; k++) {
        const double step = fmax(-10 * pixel, fmin(10 * pixel, n[k][4]));
        for (int c = 0; c < 3; c++) line->x[k / 2][c] += step * a[k % 2][c];
    }
}

// Where the rays of a segment's ends pass a line nearest, from its first point, in units of space.
static void along(const Segments *s, int32_t m, const Line *line, double *t) {
    double d[3], w[3];
    for (int k = 0; k < 3; k++)
        d[k] = line->x[1][k] - line->x[0][k], w[k] = line->x[0][k] - s->centre[3 * s->view[m] + k];
    const double length = sqrt(dot3(d, d)) + 1e-30;
    for (int k = 0; k < 3; k++) d[k] /= length;
    for (int e = 0; e < 2; e++) {
        const double *ray = s->rays + 6 * m + 3 * e, b = dot3(ray, d);
        t[e] = (dot3(w, ray) * b - dot3(w, d)) / fmax(1 - b * b, 1e-9);
    }
    if (t[0] > t[1]) {
        const double swap = t[0];
        t[0] = t[1], t[1] = swap;
    }
}

// The line over all that at least two of its photos show.
static void extend(const Segments *s, const int32_t *rows, int64_t views, Line *line) {
    double low[2] = {INFINITY, INFINITY}, high[2] = {-INFINITY, -INFINITY}, d[3];
    for (int64_t v = 0; v < views; v++) {
        double t[2];
        if (rows[v] < 0) continue;
        along(s, rows[v], line, t);
        if (t[0] < low[0]) low[1] = low[0], low[0] = t[0];
        else if (t[0] < low[1]) low[1] = t[0];
        if (t[1] > high[0]) high[1] = high[0], high[0] = t[1];
        else if (t[1] > high[1]) high[1] = t[1];
    }
    if (!(isfinite(low[1]) && isfinite(high[1]) && high[1] > low[1] + 1e-9)) return;
    for (int k = 0; k < 3; k++) d[k] = line->x[1][k] - line->x[0][k];
    const double length = sqrt(dot3(d, d)) + 1e-30;
    for (int k = 0; k < 3; k++) {
        const double from = line->x[0][k];
        line->x[0][k] = from + low[1] * d[k] / length, line->x[1][k] = from + high[1] * d[k] / length;
    }
}

/* Lines [n][2][3] of the segments `own` [n] put where all photos want them; rows [n][views]: the segment of each photo
   that supports it, -1 for none; residuals [n][views]: px, the larger of both ends, INFINITY for none; ends
   [n][views][2]: what of the line each photo shows, from its first point. pixel: of the ground, in units of space. */
MGF_API void mgf_fit_segments(int32_t *next, int64_t n, const Segments *s, const int32_t *own, float pixel,
                              double *lines, int32_t *rows, float *residuals, double *ends) {
    for (int64_t i = take_work(next); i < n; i = take_work(next)) {
        Line line;
        double score;
        int32_t *mine = rows + i * s->views;
        memcpy(&line, lines + 6 * i, sizeof line);
        for (int turn = 0; turn < 2; turn++) {
            for (int64_t v = 0; v < s->views; v++) mine[v] = vote(s, v, &line, s->sides + 6 * own[i], &score);
            mine[s->view[own[i]]] = own[i];
            for (int k = 0; k < ROUNDS; k++) improve(s, mine, s->views, pixel, &line);
            if (turn == 0) extend(s, mine, s->views, &line);
        }
        memcpy(lines + 6 * i, &line, sizeof line);
        for (int64_t v = 0; v < s->views; v++) {
            double r[2];
            residuals[i * s->views + v] = INFINITY;
            if (mine[v] < 0) continue;
            if (residual(s, mine[v], &line, r)) residuals[i * s->views + v] = (float)fmax(fabs(r[0]), fabs(r[1]));
            along(s, mine[v], &line, ends + 2 * (i * s->views + v));
        }
    }
}
