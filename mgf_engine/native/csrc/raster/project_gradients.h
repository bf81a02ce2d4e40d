// SPDX-License-Identifier: GPL-3.0-or-later
// The derivative of the projection (project.h), without the sums over list entries, the colour and the storing.
//
// Notation of project.h; gX stands for dL/dX. In order:
//  1. Add the slots of each Gaussian (always in the same order) and turn the sums over pixels into gradients of the
//     record's columns. Moving the centre moves every (x, y) = pixel - centre the other way:
//     dL/d centre_x = -sum (gq dq/dx + gA dA/dx + gB dB/dx), dq/dx = 2 q0 x + 2 q1 y, dA/dx = a1 + 2 a3 x + 2 a4 y,
//     dB/dx = b1.
//  2. b1 = m_z a1 / 2 and b2 alike: their gradients go to a1, a2 and m_z.
//  3. q_i = sum h_k u_k^2 / (D largest^2), a_i = sum g_k ... / D and N = sum g_k c_k V_k are sums over the three axes
//     with weights h_k = s_k^2 / largest^2 and g_k = h_i h_j; each is differentiated for its factors. `largest`
//     cancels, so it counts as fixed.
//  4. c_k, jx_k, jy_k, ux_k, uy_k are linear in V_k with coefficients in m: gradients of V_k and m.
//  5. V_k = camera rotation * column k of R(unit quaternion); scales and opacity through exp, filter and sigmoid;
//     colour.
#pragma once
#include "raster/blend_backward.h"
#include "raster/gaussian.h"

// Gradients of everything that depends on the record's columns; filled step by step.
typedef struct {
    v16 centre[2], m[3], axis[3][3], h[3], opacity;
} LaneGradients;

// Where all of the values are finite.
static inline i16 sound(const v16 *values, int count) {
    v16 total = values[0];
    for (int c = 1; c < count; c++) total += values[c];
    return total - total == 0.0f;
}

// Steps 1 to 4. rec: the columns of the records; lanes that are not drawn hold zero sums and finite records.
static inline void geometry_gradients(const Lanes *s, const v16 *rec, const v16 *sum, const Camera *camera,
                                      LaneGradients *out) {
    const float ifx = 1.0f / camera->fx, ify = 1.0f / camera->fy;
    const v16 gu = -(2.0f * (rec[REC_Q0] * sum[SUM_QX] + rec[REC_Q1] * sum[SUM_QY] + rec[REC_A3] * sum[SUM_AX] +
                             rec[REC_A4] * sum[SUM_AY]) +
                     rec[REC_A1] * sum[SUM_A] + rec[REC_B1] * sum[SUM_B0]);
    const v16 gv = -(2.0f * (rec[REC_Q1] * sum[SUM_QX] + rec[REC_Q2] * sum[SUM_QY] + rec[REC_A4] * sum[SUM_AX] +
                             rec[REC_A5] * sum[SUM_AY]) +
                     rec[REC_A2] * sum[SUM_A] + rec[REC_B2] * sum[SUM_B0]);
    out->centre[0] = gu, out->centre[1] = gv;
    const v16 gq0 = sum[SUM_QXX], gq1 = 2.0f * sum[SUM_QXY], gq2 = sum[SUM_QYY];
    const v16 ga1 = sum[SUM_AX] + 0.5f * s->m[2] * sum[SUM_BX], ga2 = sum[SUM_AY] + 0.5f * s->m[2] * sum[SUM_BY];
    const v16 ga3 = sum[SUM_AXX], ga4 = 2.0f * sum[SUM_AXY], ga5 = sum[SUM_AYY];
    v16 gz = sum[SUM_B0] + 0.5f * (sum[SUM_BX] * rec[REC_A1] + sum[SUM_BY] * rec[REC_A2]);

    const v16 inv_den = s->inv_den, per_q = inv_den / s->largest2;
    const v16 g_den = -inv_den * (gq0 * rec[REC_Q0] + gq1 * rec[REC_Q1] + gq2 * rec[REC_Q2] + ga1 * rec[REC_A1] +
                                  ga2 * rec[REC_A2] + ga3 * rec[REC_A3] + ga4 * rec[REC_A4] + ga5 * rec[REC_A5]);

    v16 normal[3], length2 = splat(1e-36f), along = splat(0.0f), g_normal[3];
    for (int i = 0; i < 3; i++) {
        normal[i] =
            s->g[0] * s->c[0] * s->axis[0][i] + s->g[1] * s->c[1] * s->axis[1][i] + s->g[2] * s->c[2] * s->axis[2][i];
        length2 += normal[i] * normal[i];
        along += rec[REC_NX + i] * sum[SUM_NX + i];
    }
    const v16 inv_length = 1.0f / vsqrt(length2);
    for (int i = 0; i < 3; i++) g_normal[i] = -(sum[SUM_NX + i] - rec[REC_NX + i] * along) * inv_length;

    v16 gdx = splat(0.0f), gdy = gdx, gg[3], gm0 = gdx, gm1 = gdx;
    for (int k = 0; k < 3; k++) {
        const v16 *axis = s->axis[k];
        const v16 h = s->h[k], g = s->g[k], c = s->c[k], jx = s->jx[k], jy = s->jy[k], ux = s->ux[k], uy = s->uy[k];
        const v16 gux = per_q * h * (2.0f * gq0 * ux + gq1 * uy), guy = per_q * h * (gq1 * ux + 2.0f * gq2 * uy);
        out->h[k] = per_q * (gq0 * ux * ux + gq1 * ux * uy + gq2 * uy * uy);
        const v16 n_axis = g_normal[0] * axis[0] + g_normal[1] * axis[1] + g_normal[2] * axis[2];
        gg[k] = g_den * c * c + c * n_axis +
                inv_den * (2.0f * c * (ga1 * jx + ga2 * jy) + ga3 * jx * jx + ga4 * jx * jy + ga5 * jy * jy);
        const v16 gc = g * (2.0f * g_den * c + n_axis + 2.0f * inv_den * (ga1 * jx + ga2 * jy));
        const v16 gjx = inv_den * g * (2.0f * ga1 * c + 2.0f * ga3 * jx + ga4 * jy);
        const v16 gjy = inv_den * g * (2.0f * ga2 * c + ga4 * jx + 2.0f * ga5 * jy);
        out->axis[k][0] = g * c * g_normal[0] + gc * s->dx + gjx * ifx - guy * s->m[2] * ify;
        out->axis[k][1] = g * c * g_normal[1] + gc * s->dy + gjy * ify + gux * s->m[2] * ifx;
        out->axis[k][2] = g * c * g_normal[2] + gc - gux * s->m[1] * ifx + guy * s->m[0] * ify;
        gdx += gc * axis[0], gdy += gc * axis[1];
        gm0 += guy * axis[2] * ify;
        gm1 -= gux * axis[2] * ifx;
        gz += gux * axis[1] * ifx - guy * axis[0] * ify;
    }
    out->h[0] += gg[1] * s->h[2] + gg[2] * s->h[1];
    out->h[1] += gg[2] * s->h[0] + gg[0] * s->h[2];
    out->h[2] += gg[0] * s->h[1] + gg[1] * s->h[0];
    const v16 gx = gdx + gu * camera->fx, gy = gdy + gv * camera->fy, inv_z = 1.0f / s->depth;
    out->m[0] = gm0 + gx * inv_z, out->m[1] = gm1 + gy * inv_z;
    out->m[2] = gz - (gx * s->dx + gy * s->dy) * inv_z;
    out->opacity = sum[SUM_OPACITY] / rec[REC_OPACITY];
}

// Gradient of the raw quaternion from that of the axes in the camera frame.
static inline void quaternion_gradient(const Lanes *s, const Camera *camera, v16 axis_gradient[3][3], v16 *out) {
    v16 r[3][3];  // gradient of R; r[k][i]: column k, row i
    const float *c = camera->rotation;
    for (int k = 0; k < 3; k++)
        for (int i = 0; i < 3; i++)
            r[k][i] = c[i] * axis_gradient[k][0] + c[3 + i] * axis_gradient[k][1] + c[6 + i] * axis_gradient[k][2];
    const v16 w = s->unit[0], x = s->unit[1], y = s->unit[2], z = s->unit[3];
    v16 g[4];
    g[0] = 2.0f * (z * (r[0][1] - r[1][0]) + y * (r[2][0] - r[0][2]) + x * (r[1][2] - r[2][1]));
    g[1] = 2.0f * (y * (r[0][1] + r[1][0]) + z * (r[0][2] + r[2][0]) + w * (r[1][2] - r[2][1])) -
           4.0f * x * (r[1][1] + r[2][2]);
    g[2] = 2.0f * (x * (r[0][1] + r[1][0]) + z * (r[1][2] + r[2][1]) + w * (r[2][0] - r[0][2])) -
           4.0f * y * (r[0][0] + r[2][2]);
    g[3] = 2.0f * (x * (r[0][2] + r[2][0]) + y * (r[1][2] + r[2][1]) + w * (r[0][1] - r[1][0])) -
           4.0f * z * (r[0][0] + r[1][1]);
    const v16 along = g[0] * w + g[1] * x + g[2] * y + g[3] * z;
    for (int i = 0; i < 4; i++) out[i] = (g[i] - s->unit[i] * along) * s->inv_norm;
}

// Gradients of log_scales and opacity logit. opacity = sigmoid * prod(local_k / scale_k); d log(ratio) / d log_scale =
// 1 - local^2 / scale^2.
static inline void scale_gradients(const Lanes *s, const LaneGradients *g, v16 *log_scales, v16 *logit) {
    const v16 opacity = s->sigmoid * s->ratio;
    *logit = g->opacity * opacity * s->off;
    for (int k = 0; k < 3; k++) {
        const v16 share = s->local2[k] / s->scale2[k];
        log_scales[k] =
            keep(s->clamped[k] == 0, 2.0f * g->h[k] * s->h[k] * share + g->opacity * opacity * (1.0f - share));
    }
}

// |dL/d centre| of the projected centre, the rest of the record held fixed, in half frames (normalised device
// coordinates).
static inline v16 centre_gradient(const LaneGradients *g, const Camera *camera) {
    const v16 x = 0.5f * camera->width * g->centre[0], y = 0.5f * camera->height * g->centre[1];
    return vsqrt(x * x + y * y);
}
