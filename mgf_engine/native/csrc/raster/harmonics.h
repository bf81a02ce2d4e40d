// SPDX-License-Identifier: GPL-3.0-or-later
// Real spherical harmonics up to degree 3 (with the Condon-Shortley sign, as 3DGS files have them), sixteen directions
// at once.
#pragma once
#include "common/vector.h"

#define SH_ROW 48  // floats per Gaussian: 16 coefficients of three colours
#define SH_COUNT(degree) (((degree) + 1) * ((degree) + 1))
#define SH_PARTS(degree) ((3 * SH_COUNT(degree) + 15) / 16)  // vectors that hold those of a degree

#define SH_C0 0.28209479f
#define SH_C1 0.48860251f
#define SH_C2 1.09254843f
#define SH_C2_0 0.31539157f
#define SH_C2_2 0.54627422f
#define SH_C3_3 0.59004359f
#define SH_C3_2 2.89061144f
#define SH_C3_1 0.45704580f
#define SH_C3_0 0.37317633f
#define SH_C3_2B 1.44530572f

// Y[b] for the unit direction (x, y, z); (degree + 1)^2 of them.
static inline void sh_basis(int degree, v16 x, v16 y, v16 z, v16 *Y) {
    Y[0] = splat(SH_C0);
    if (degree < 1) return;
    Y[1] = -SH_C1 * y, Y[2] = SH_C1 * z, Y[3] = -SH_C1 * x;
    if (degree < 2) return;
    const v16 xx = x * x, yy = y * y, zz = z * z;
    Y[4] = SH_C2 * x * y, Y[5] = -SH_C2 * y * z, Y[6] = SH_C2_0 * (2.0f * zz - xx - yy);
    Y[7] = -SH_C2 * x * z, Y[8] = SH_C2_2 * (xx - yy);
    if (degree < 3) return;
    Y[9] = -SH_C3_3 * y * (3.0f * xx - yy), Y[10] = SH_C3_2 * x * y * z, Y[11] = -SH_C3_1 * y * (4.0f * zz - xx - yy);
    Y[12] = SH_C3_0 * z * (2.0f * zz - 3.0f * xx - 3.0f * yy), Y[13] = -SH_C3_1 * x * (4.0f * zz - xx - yy);
    Y[14] = SH_C3_2B * z * (xx - yy), Y[15] = -SH_C3_3 * x * (xx - 3.0f * yy);
}

// g[0..2] = sum_b s[b] dY_b / d(x, y, z), the polynomials taken as functions of three free variables.
static inline void sh_direction_gradient(int degree, v16 x, v16 y, v16 z, const v16 *s, v16 *g) {
    g[0] = g[1] = g[2] = splat(0.0f);
    if (degree < 1) return;
    g[0] = -SH_C1 * s[3], g[1] = -SH_C1 * s[1], g[2] = SH_C1 * s[2];
    if (degree < 2) return;
    g[0] += SH_C2 * (y * s[4] - z * s[7]) - 2.0f * SH_C2_0 * x * s[6] + 2.0f * SH_C2_2 * x * s[8];
    g[1] += SH_C2 * (x * s[4] - z * s[5]) - 2.0f * SH_C2_0 * y * s[6] - 2.0f * SH_C2_2 * y * s[8];
    g[2] += -SH_C2 * (y * s[5] + x * s[7]) + 4.0f * SH_C2_0 * z * s[6];
    if (degree < 3) return;
    const v16 xx = x * x, yy = y * y, zz = z * z, xy = x * y, xz = x * z, yz = y * z;
    g[0] += -6.0f * SH_C3_3 * xy * s[9] + SH_C3_2 * yz * s[10] + 2.0f * SH_C3_1 * xy * s[11] -
            6.0f * SH_C3_0 * xz * s[12] - SH_C3_1 * (4.0f * zz - 3.0f * xx - yy) * s[13] +
            2.0f * SH_C3_2B * xz * s[14] - 3.0f * SH_C3_3 * (xx - yy) * s[15];
    g[1] += -3.0f * SH_C3_3 * (xx - yy) * s[9] + SH_C3_2 * xz * s[10] - SH_C3_1 * (4.0f * zz - xx - 3.0f * yy) * s[11] -
            6.0f * SH_C3_0 * yz * s[12] + 2.0f * SH_C3_1 * xy * s[13] - 2.0f * SH_C3_2B * yz * s[14] +
            6.0f * SH_C3_3 * xy * s[15];
    g[2] += SH_C3_2 * xy * s[10] - 8.0f * SH_C3_1 * yz * s[11] + SH_C3_0 * (6.0f * zz - 3.0f * xx - 3.0f * yy) * s[12] -
            8.0f * SH_C3_1 * xz * s[13] + SH_C3_2B * (xx - yy) * s[14];
}
