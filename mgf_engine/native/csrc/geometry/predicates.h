// SPDX-License-Identifier: GPL-3.0-or-later
// Exact predicates of points whose coordinates are whole numbers of 2^-53 between 0 and 1: on which side of a plane,
// and whether inside of a sphere. In doubles where their error bound allows (Shewchuk 1997), else in whole numbers:
// differences have 54 bits, so that everything fits into 320.
#pragma once
#include <math.h>
#include <stdint.h>

typedef __int128 Wide;           // products of two differences, and sums of them
enum { LIMBS = 5 };              // of 64 bits, the lowest first, in two's complement
typedef struct {
    uint64_t limb[LIMBS];
} Huge;

static const double UNIT = 9007199254740992.0;  // 2^53
static const double ROUNDING = 1.1102230246251565e-16;

static inline Huge huge(Wide value) {
    Huge h;
    h.limb[0] = (uint64_t)value, h.limb[1] = (uint64_t)(value >> 64);
    for (int k = 2; k < LIMBS; k++) h.limb[k] = value < 0 ? ~(uint64_t)0 : 0;
    return h;
}

static inline Huge sum(Huge a, Huge b) {
    unsigned __int128 carry = 0;
    for (int k = 0; k < LIMBS; k++)
        carry += (unsigned __int128)a.limb[k] + b.limb[k], a.limb[k] = (uint64_t)carry, carry >>= 64;
    return a;
}

static inline Huge negative(Huge a) {
    for (int k = 0; k < LIMBS; k++) a.limb[k] = ~a.limb[k];
    return sum(a, huge(1));
}

static inline int sign_of(Huge a) {
    if (a.limb[LIMBS - 1] >> 63) return -1;
    for (int k = 0; k < LIMBS; k++)
        if (a.limb[k]) return 1;
    return 0;
}

// Product modulo 2^320, which in two's complement is right for either sign where the result fits.
static inline Huge product(Huge a, Huge b) {
    Huge r = {{0}};
    for (int i = 0; i < LIMBS; i++) {
        unsigned __int128 carry = 0;
        for (int k = 0; i + k < LIMBS; k++) {
            carry += (unsigned __int128)a.limb[i] * b.limb[k] + r.limb[i + k];
            r.limb[i + k] = (uint64_t)carry, carry >>= 64;
        }
    }
    return r;
}

// a x (b y - c z) as a whole number; all are differences
static inline Huge term(int64_t a, int64_t b, int64_t y, int64_t c, int64_t z) {
    return product(huge(a), huge((Wide)b * y - (Wide)c * z));
}

static inline Huge determinant(const int64_t *a, const int64_t *b, const int64_t *c) {
    return sum(sum(term(a[0], b[1], c[2], b[2], c[1]), term(a[1], b[2], c[0], b[0], c[2])),
               term(a[2], b[0], c[1], b[1], c[0]));
}

static inline void whole_difference(const double *a, const double *b, int64_t *d) {
    for (int k = 0; k < 3; k++) d[k] = (int64_t)((a[k] - b[k]) * UNIT);
}

// The sign of the volume of a tetrahedron: of (b - a) x (c - a) . (d - a).
static inline int side(const double *a, const double *b, const double *c, const double *d) {
    double u[3], v[3], w[3];
    for (int k = 0; k < 3; k++) u[k] = b[k] - a[k], v[k] = c[k] - a[k], w[k] = d[k] - a[k];  // exact
    const double p = v[1] * w[2], q = v[2] * w[1], r = v[2] * w[0], s = v[0] * w[2], t = v[0] * w[1], o = v[1] * w[0];
    const double found = u[0] * (p - q) + u[1] * (r - s) + u[2] * (t - o);
    const double most =
        (fabs(p) + fabs(q)) * fabs(u[0]) + (fabs(r) + fabs(s)) * fabs(u[1]) + (fabs(t) + fabs(o)) * fabs(u[2]);
    const double bound = 8 * ROUNDING * most;
    if (found > bound) return 1;
    if (found < -bound) return -1;
    if (most == 0) return 0;
    int64_t e[3], f[3], g[3];
    whole_difference(b, a, e), whole_difference(c, a, f), whole_difference(d, a, g);
    return sign_of(determinant(e, f, g));
}

static int exact_sphere(const double *const *corner, const double *p) {
    int64_t row[4][3];
    Huge all = {{0}};
    for (int i = 0; i < 4; i++) whole_difference(corner[i], p, row[i]);
    for (int i = 0; i < 4; i++) {
        const int64_t *r = row[i], *o[3];
        for (int k = 0, n = 0; k < 4; k++)
            if (k != i) o[n++] = row[k];
        const Wide square = (Wide)r[0] * r[0] + (Wide)r[1] * r[1] + (Wide)r[2] * r[2];
        const Huge part = product(determinant(o[0], o[1], o[2]), huge(square));
        all = sum(all, i % 2 ? negative(part) : part);
    }
    return sign_of(all);
}

/* Whether p lies inside (1), on (0) or outside (-1) of the sphere through four corners with a positive volume. */
static inline int in_sphere(const double *const *corner, const double *p) {
    double d[4][3], square[4], minor[6], most[6];
    for (int i = 0; i < 4; i++) {
        for (int k = 0; k < 3; k++) d[i][k] = corner[i][k] - p[k];  // exact
        square[i] = d[i][0] * d[i][0] + d[i][1] * d[i][1] + d[i][2] * d[i][2];
    }
    static const int pair[6][2] = {{0, 1}, {1, 2}, {2, 3}, {3, 0}, {0, 2}, {1, 3}};
    for (int n = 0; n < 6; n++) {
        const double *a = d[pair[n][0]], *b = d[pair[n][1]], first = a[0] * b[1], second = b[0] * a[1];
        minor[n] = first - second, most[n] = fabs(first) + fabs(second);
    }
    enum { AB, BC, CD, DA, AC, BD };
    const double abc = d[0][2] * minor[BC] - d[1][2] * minor[AC] + d[2][2] * minor[AB];
    const double bcd = d[1][2] * minor[CD] - d[2][2] * minor[BD] + d[3][2] * minor[BC];
    const double cda = d[2][2] * minor[DA] + d[3][2] * minor[AC] + d[0][2] * minor[CD];
    const double dab = d[3][2] * minor[AB] + d[0][2] * minor[BD] + d[1][2] * minor[DA];
    const double found = (square[2] * dab - square[3] * abc) + (square[0] * bcd - square[1] * cda);
    const double z[4] = {fabs(d[0][2]), fabs(d[1][2]), fabs(d[2][2]), fabs(d[3][2])};
    const double size = (most[CD] * z[1] + most[BD] * z[2] + most[BC] * z[3]) * square[0] +
                        (most[DA] * z[2] + most[AC] * z[3] + most[CD] * z[0]) * square[1] +
                        (most[AB] * z[3] + most[BD] * z[0] + most[DA] * z[1]) * square[2] +
                        (most[BC] * z[0] + most[AC] * z[1] + most[AB] * z[2]) * square[3];
    const double bound = 17 * ROUNDING * size;
    if (found > bound) return 1;
    if (found < -bound) return -1;
    return exact_sphere(corner, p);
}
