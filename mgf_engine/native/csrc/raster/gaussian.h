// SPDX-License-Identifier: GPL-3.0-or-later
// Sixteen Gaussians at once, from their raw parameters to the quantities that both the projection (project.h) and its
// derivative (project_gradients.h) need. Derivations are in project.h. (CUDA: one Gaussian, see cuda/lane.h.)
#pragma once
#include "raster/records.h"
#include "common/vector.h"

// log_scales are clamped to this range: 1e-6 to 1000 units; gradients outside are zero.
#define LOG_SCALE_MIN -13.8155106f
#define LOG_SCALE_MAX 6.90775528f
// A quaternion whose squared length is outside this range stands for no rotation and gets no gradient.
#define QUATERNION_MIN 1e-24f
#define QUATERNION_MAX 1e24f
// A centre that projects further outside the frame than this is not drawn: float32 pixels would be too coarse.
#define CENTRE_LIMIT 1e5f

typedef struct {
    const float *positions;       // [n, 3]
    const float *log_scales;      // [n, 3]
    const float *rotations;       // [n, 4]
    const float *opacity_logits;  // [n]
    const float *sh;              // [n, 16, 3]
    const float *filter_3d;       // [n]
} Parameters;

typedef struct {
    v16 p[3];         // centre, normalised frame
    v16 m[3];         // centre, camera frame
    v16 depth;        // m[2], or 1 where the Gaussian is not in front (keeps the arithmetic finite)
    v16 unit[4];      // unit quaternion
    v16 inv_norm;     // 1 / length of the raw quaternion, 0 where it stands for no rotation
    v16 local2[3];    // squared scales without the filter
    v16 scale2[3];    // squared scales with the filter
    i16 clamped[3];   // log_scales outside their range
    v16 largest2;     // largest of scale2
    v16 h[3];         // scale2 / largest2
    v16 g[3];         // g_k = h_i h_j
    v16 axis[3][3];   // axis[k]: k-th axis of the Gaussian in the camera frame
    v16 dx, dy;       // ray through the centre: d_c = (dx, dy, 1)
    v16 c[3];         // axis[k] . d_c
    v16 jx[3], jy[3]; // d c_k / d pixel
    v16 ux[3], uy[3]; // axis[k] . (m x e_x) / fx, axis[k] . (m x e_y) / fy
    v16 inv_den;      // 1 / sum g c^2
    v16 sigmoid, off, ratio;  // opacity = sigmoid * ratio; off = 1 - sigmoid
    i16 front;        // in front of the near plane and near enough to the frame
} Lanes;

// out[c] lane l = rows[first + l][c]; rows beyond n repeat the last one.
static inline void load_rows(v16 *out, const float *rows, int width, int64_t first, int64_t n) {
    for (int l = 0; l < VECTOR; l++) {
        const int64_t row = first + l < n ? first + l : n - 1;
        for (int c = 0; c < width; c++) ((float *)(out + c))[l] = rows[row * width + c];
    }
}

// Columns of the rotation matrix of a unit quaternion (w, x, y, z): axes of the Gaussian, normalised frame.
static inline void quaternion_axes(const v16 *q, v16 axis[3][3]) {
    const v16 w = q[0], x = q[1], y = q[2], z = q[3];
    axis[0][0] = 1.0f - 2.0f * (y * y + z * z), axis[0][1] = 2.0f * (x * y + w * z),
    axis[0][2] = 2.0f * (x * z - w * y);
    axis[1][0] = 2.0f * (x * y - w * z), axis[1][1] = 1.0f - 2.0f * (x * x + z * z),
    axis[1][2] = 2.0f * (y * z + w * x);
    axis[2][0] = 2.0f * (x * z + w * y), axis[2][1] = 2.0f * (y * z - w * x),
    axis[2][2] = 1.0f - 2.0f * (x * x + y * y);
}

static inline void normalise_quaternion(Lanes *s, const v16 *raw) {
    const v16 norm2 = raw[0] * raw[0] + raw[1] * raw[1] + raw[2] * raw[2] + raw[3] * raw[3];
    const i16 usable = (norm2 > QUATERNION_MIN) & (norm2 < QUATERNION_MAX);
    s->inv_norm = keep(usable, 1.0f / vsqrt(choose(usable, norm2, splat(1.0f))));
    s->unit[0] = choose(usable, raw[0] * s->inv_norm, splat(1.0f));
    for (int i = 1; i < 4; i++) s->unit[i] = keep(usable, raw[i] * s->inv_norm);
}

static inline void scales_and_opacity(Lanes *s, const v16 *log_scales, v16 logit, v16 filter) {
    s->ratio = splat(1.0f);
    for (int k = 0; k < 3; k++) {
        const v16 limited = vmin(vmax(log_scales[k], splat(LOG_SCALE_MIN)), splat(LOG_SCALE_MAX));
        s->clamped[k] = limited != log_scales[k];
        s->local2[k] = exp2_16(2.0f * LOG2_E * limited);
        s->scale2[k] = s->local2[k] + filter * filter;
        s->ratio *= s->local2[k] / s->scale2[k];
    }
    s->ratio = vsqrt(s->ratio);
    logit = vmin(vmax(logit, splat(-80.0f)), splat(80.0f));
    const v16 odds = exp2_16(-LOG2_E * logit);
    s->sigmoid = 1.0f / (1.0f + odds), s->off = odds * s->sigmoid;
    s->largest2 = vmax(vmax(s->scale2[0], s->scale2[1]), s->scale2[2]);
    for (int k = 0; k < 3; k++) s->h[k] = s->scale2[k] / s->largest2;
    s->g[0] = s->h[1] * s->h[2], s->g[1] = s->h[2] * s->h[0], s->g[2] = s->h[0] * s->h[1];
}

static inline void place_in_camera(Lanes *s, const Camera *camera) {
    const float *r = camera->rotation;
    for (int i = 0; i < 3; i++)
        s->m[i] = r[3 * i] * s->p[0] + r[3 * i + 1] * s->p[1] + r[3 * i + 2] * s->p[2] + camera->translation[i];
    s->front = s->m[2] > camera->near;
    s->depth = choose(s->front, s->m[2], splat(1.0f));
    s->dx = s->m[0] / s->depth, s->dy = s->m[1] / s->depth;
    const v16 limit_x = splat(CENTRE_LIMIT / camera->fx), limit_y = splat(CENTRE_LIMIT / camera->fy);
    s->front &= (s->dx < limit_x) & (s->dx > -limit_x) & (s->dy < limit_y) & (s->dy > -limit_y);
    v16 world[3][3];
    quaternion_axes(s->unit, world);
    for (int k = 0; k < 3; k++)
        for (int i = 0; i < 3; i++)
            s->axis[k][i] = r[3 * i] * world[k][0] + r[3 * i + 1] * world[k][1] + r[3 * i + 2] * world[k][2];
}

// All of Lanes for Gaussians first..first + VECTOR - 1 (those beyond n repeat the last).
static inline void prepare_lanes(Lanes *s, const Parameters *in, const Camera *camera, int64_t first, int64_t n) {
    v16 log_scales[3], raw[4], logit, filter;
    load_rows(s->p, in->positions, 3, first, n);
    load_rows(log_scales, in->log_scales, 3, first, n);
    load_rows(raw, in->rotations, 4, first, n);
    load_rows(&logit, in->opacity_logits, 1, first, n);
    load_rows(&filter, in->filter_3d, 1, first, n);
    normalise_quaternion(s, raw);
    scales_and_opacity(s, log_scales, logit, filter);
    place_in_camera(s, camera);
    const float ifx = 1.0f / camera->fx, ify = 1.0f / camera->fy;
    v16 den = splat(0.0f);
    for (int k = 0; k < 3; k++) {
        const v16 *a = s->axis[k];
        s->c[k] = a[0] * s->dx + a[1] * s->dy + a[2];
        s->jx[k] = a[0] * ifx, s->jy[k] = a[1] * ify;
        s->ux[k] = (s->m[2] * a[1] - s->m[1] * a[2]) * ifx;
        s->uy[k] = (s->m[0] * a[2] - s->m[2] * a[0]) * ify;
        den += s->g[k] * s->c[k] * s->c[k];
    }
    s->inv_den = 1.0f / vmax(den, splat(1e-30f));
}
