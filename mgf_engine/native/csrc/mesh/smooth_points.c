// SPDX-License-Identifier: GPL-3.0-or-later
// Points moved onto planes through their neighbours: robust moving least squares (after Fleishman et al. 2005), and
// normals.
#include <math.h>

#include "common/export.h"

enum { PIECE = 512, SWEEPS = 8, ROUNDS = 2 };

// Turn rows p, q of a symmetric matrix so that its entry [p][q] becomes 0, and the eigenvectors (columns of v) along.
static void rotate(double a[3][3], double v[3][3], int p, int q) {
    if (fabs(a[p][q]) < 1e-300) return;
    const double theta = (a[q][q] - a[p][p]) / (2 * a[p][q]);
    const double t = copysign(1, theta) / (fabs(theta) + sqrt(theta * theta + 1)), c = 1 / sqrt(t * t + 1), s = t * c;
    for (int k = 0; k < 3; k++) {
        const double x = a[k][p], y = a[k][q];
        a[k][p] = c * x - s * y, a[k][q] = s * x + c * y;
    }
    for (int k = 0; k < 3; k++) {
        const double x = a[p][k], y = a[q][k];
        a[p][k] = c * x - s * y, a[q][k] = s * x + c * y;
    }
    for (int k = 0; k < 3; k++) {
        const double x = v[k][p], y = v[k][q];
        v[k][p] = c * x - s * y, v[k][q] = s * x + c * y;
    }
}

// Direction of least spread: the eigenvector of the smallest eigenvalue (Jacobi).
static void least_direction(double a[3][3], double *normal) {
    double v[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    for (int sweep = 0; sweep < SWEEPS; sweep++) rotate(a, v, 0, 1), rotate(a, v, 0, 2), rotate(a, v, 1, 2);
    int least = 0;
    for (int k = 1; k < 3; k++)
        if (a[k][k] < a[least][least]) least = k;
    for (int k = 0; k < 3; k++) normal[k] = v[k][least];
}

static void normal_of(const double *points, const int64_t *rows, int64_t count, double *normal) {
    double mean[3] = {0, 0, 0}, spread[3][3] = {{0}};
    for (int64_t r = 0; r < count; r++)
        for (int k = 0; k < 3; k++) mean[k] += points[3 * rows[r] + k] / (double)count;
    for (int64_t r = 0; r < count; r++) {
        const double *q = points + 3 * rows[r];
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++) spread[i][j] += (q[i] - mean[i]) * (q[j] - mean[j]);
    }
    least_direction(spread, normal);
}

// How far along the normal the neighbours lie from p: Gaussian weights of distance, then of distance from that plane,
// too.
static double offset_of(const double *points, const int64_t *rows, int64_t count, const double *p, const double *normal,
                        double radius, double range) {
    double offset = 0;
    for (int round = 0; round <= ROUNDS; round++) {
        double sum = 0, total = 0;
        for (int64_t r = 0; r < count; r++) {
            const double *q = points + 3 * rows[r], d[3] = {q[0] - p[0], q[1] - p[1], q[2] - p[2]};
            const double along = d[0] * normal[0] + d[1] * normal[1] + d[2] * normal[2];
            const double away = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]) / (radius * radius);
            const double off = round ? (along - offset) / range : 0, w = exp(-(away + off * off) / 2);
            sum += w * along, total += w;
        }
        if (!(total > 1e-30)) break;
        offset = sum / total;
    }
    return offset;
}

/* Moves points [n][3] along their normals [n][3] (both written) onto the planes through their neighbours, rows
   [n][count]: with standard deviations `radius` along the surface and `range` across it, by at most `most`. */
MGF_API void mgf_smooth_points(int32_t *next, int64_t n, const double *points, const int64_t *neighbours, int64_t count,
                               float radius, float range, float most, double *moved, double *normals) {
    for (int64_t piece = take_work(next); piece * PIECE < n; piece = take_work(next)) {
        for (int64_t i = piece * PIECE; i < n && i < (piece + 1) * PIECE; i++) {
            const double *p = points + 3 * i;
            const int64_t *rows = neighbours + count * i;
            double *normal = normals + 3 * i;
            normal_of(points, rows, count, normal);
            const double offset = offset_of(points, rows, count, p, normal, radius, range);
            const double step = fmin(fmax(offset, -most), most);
            for (int k = 0; k < 3; k++) moved[3 * i + k] = p[k] + step * normal[k];
        }
    }
}
