// SPDX-License-Identifier: GPL-3.0-or-later
// The projection of Gaussians: columns of their records (records.h) and the tiles they touch.
//
// Let V_k be the axes of a Gaussian in the camera frame, s_k its scales (3D filter included), m its centre,
// d_c = m / m_z the ray through the centre. With the covariance S = sum s_k^2 V_k V_k',
//     S^-1 = sum V_k V_k' / s_k^2 = G / det S,   G = adj S = sum (s_i s_j)^2 V_k V_k',  {i, j, k} = {0, 1, 2}.
// For a ray d = d_c + dx e_x / fx + dy e_y / fy, with c_k = V_k . d_c, jx_k = V_k . e_x / fx, jy_k = V_k . e_y / fy:
//     A = d' G d / d_c' G d_c:   a1 = 2 sum g_k c_k jx_k / D,  a3 = sum g_k jx_k^2 / D, ...,   D = sum g_k c_k^2,
//     B = m' G d / D:            b0 = m_z,  b1 = m_z a1 / 2,  b2 = m_z a2 / 2           (because m = m_z d_c),
// and the squared distance |o x r|^2 / |r|^2 of the ray from the centre, in the Gaussian's own units, where
// o x r = det(M) M^-T (m x d) for M = diag(1/s) V', so that (m x d is linear in dx, dy, and zero for d_c)
//     q0 = sum s_k^2 (V_k . (m x e_x))^2 / (fx^2 D), ...
// No term divides by a scale and every sum but q1 and the mixed ones has terms of one sign: flat and thin Gaussians are
// safe in float32. G and D appear as a quotient, so both are computed with scales relative to the largest one.
//
// Normal (facing the camera; for a flat Gaussian its short axis): n = -S^-1 d_c / |S^-1 d_c| = -N / |N|, N = sum g_k
// c_k V_k.
#pragma once
#include "raster/footprint.h"
#include "raster/gaussian.h"

// Unit vector from the camera to the centres, and one over their distance.
static inline void view_direction(const Lanes *s, const Camera *camera, v16 *dir, v16 *inv_distance) {
    for (int i = 0; i < 3; i++) dir[i] = s->p[i] - camera->centre[i];
    const v16 distance2 = vmax(dir[0] * dir[0] + dir[1] * dir[1] + dir[2] * dir[2], splat(1e-20f));
    *inv_distance = 1.0f / vsqrt(distance2);
    for (int i = 0; i < 3; i++) dir[i] *= *inv_distance;
}

// Columns REC_CX..REC_NZ and REC_RAY2 of the records of sixteen Gaussians, column by column.
static inline void geometry_columns(const Lanes *s, const Camera *camera, v16 *rec) {
    v16 q0 = splat(0), q1 = q0, q2 = q0, a1 = q0, a2 = q0, a3 = q0, a4 = q0, a5 = q0, ray2 = q0, n[3] = {q0, q0, q0};
    for (int k = 0; k < 3; k++) {
        const v16 hu = s->h[k] * s->ux[k], gc = s->g[k] * s->c[k], gj = s->g[k] * s->jx[k];
        q0 += hu * s->ux[k], q1 += hu * s->uy[k], q2 += s->h[k] * s->uy[k] * s->uy[k];
        a1 += gc * s->jx[k], a2 += gc * s->jy[k];
        a3 += gj * s->jx[k], a4 += gj * s->jy[k], a5 += s->g[k] * s->jy[k] * s->jy[k];
        ray2 += s->c[k] * s->c[k] / s->scale2[k];
        for (int i = 0; i < 3; i++) n[i] += gc * s->axis[k][i];
    }
    const v16 per_q = s->inv_den / s->largest2;
    rec[REC_CX] = camera->fx * s->dx + camera->cx, rec[REC_CY] = camera->fy * s->dy + camera->cy;
    rec[REC_Q0] = q0 * per_q, rec[REC_Q1] = q1 * per_q, rec[REC_Q2] = q2 * per_q;
    rec[REC_A1] = 2.0f * a1 * s->inv_den, rec[REC_A2] = 2.0f * a2 * s->inv_den;
    rec[REC_A3] = a3 * s->inv_den, rec[REC_A4] = a4 * s->inv_den, rec[REC_A5] = a5 * s->inv_den;
    rec[REC_B0] = s->m[2];
    rec[REC_B1] = 0.5f * s->m[2] * rec[REC_A1], rec[REC_B2] = 0.5f * s->m[2] * rec[REC_A2];
    rec[REC_OPACITY] = s->sigmoid * s->ratio;
    const v16 length2 = vmax(n[0] * n[0] + n[1] * n[1] + n[2] * n[2], splat(1e-36f)), inv = 1.0f / vsqrt(length2);
    for (int i = 0; i < 3; i++) rec[REC_NX + i] = -n[i] * inv;
    rec[REC_RAY2] = ray2;
}

// Number of listed tiles that a footprint touches. mask_sums [tiles_y, tiles_x + 1]: running count of listed tiles per
// row.
static inline int32_t count_tiles(const Footprint *p, const int32_t *mask_sums, int tiles_x, int tiles_y) {
    int32_t count = 0;
    int first_y, last_y, first, last;
    tile_rows(p, tiles_y, &first_y, &last_y);
    for (int ty = first_y; ty <= last_y; ty++) {
        tile_columns(p, ty, tiles_x, &first, &last);
        const int32_t *sums = mask_sums + (int64_t)ty * (tiles_x + 1);
        if (first <= last) count += sums[last + 1] - sums[first];
    }
    return count;
}
