// SPDX-License-Identifier: GPL-3.0-or-later
// Gradients of the projection: from the sums that blending left per list entry to the raw parameters; one thread a
// Gaussian. The formulas are those of the C kernels, from the same headers (project_gradients.h, gaussian.h,
// harmonics.h).
#include "cuda/block.cuh"

#include "raster/harmonics.h"
#include "raster/project.h"
#include "raster/project_gradients.h"

struct ParameterGradients {
    float *positions, *log_scales, *rotations, *opacity_logits, *sh;  // shaped like the parameters
};

// Per Gaussian, added to; all null where nobody asks.
struct Statistics {
    float *weight, *error, *gradient, *motion, *max_radius;
    int *count;
};

// Adds the slots of one Gaussian, always in the same order; returns whether any pixel took it.
static inline bool add_slots(float *sum, int first, int count, const uint8_t *hits, const float *slot_sums,
                             int columns) {
    bool seen = false;
    for (int c = 0; c < SUM_SIZE; c++) sum[c] = 0.0f;
    for (int slot = first; slot < first + count; slot++) {
        if (!hits[slot]) continue;
        const float4 *from = (const float4 *)(slot_sums + (int64_t)slot * SUM_SIZE);
        for (int f = 0; f < SUM_SIZE / 4; f++) {
            if (4 * f >= columns) break;
            const float4 part = from[f];
            sum[4 * f] += part.x, sum[4 * f + 1] += part.y, sum[4 * f + 2] += part.z, sum[4 * f + 3] += part.w;
        }
        seen = true;
    }
    return seen;
}

// Gradients of the harmonics' coefficients, into the Gaussian's row, and of its position through the view direction.
static inline void color_gradient(const Lanes *s, const float *sh, const Camera *camera, const float *sum,
                                  const float *record, int degree, float *row, float *position) {
    float direction[3], inv_distance, basis[16], along_basis[16], g_direction[3], g[3];
    view_direction(s, camera, direction, &inv_distance);
    sh_basis(degree, direction[0], direction[1], direction[2], basis);
    for (int c = 0; c < 3; c++) g[c] = record[REC_R + c] > 0.0f ? sum[SUM_R + c] : 0.0f;  // max(0, ..) stops it
    const int count = (degree + 1) * (degree + 1);
    for (int b = 0; b < 16; b++) {
        if (b < count) along_basis[b] = g[0] * sh[3 * b] + g[1] * sh[3 * b + 1] + g[2] * sh[3 * b + 2];
        for (int c = 0; c < 3; c++) row[3 * b + c] = b < count ? basis[b] * g[c] : 0.0f;
    }
    sh_direction_gradient(degree, direction[0], direction[1], direction[2], along_basis, g_direction);
    const float along = g_direction[0] * direction[0] + g_direction[1] * direction[1] + g_direction[2] * direction[2];
    for (int i = 0; i < 3; i++) position[i] += (g_direction[i] - direction[i] * along) * inv_distance;
}

static inline void zero_rows(const ParameterGradients &out, int64_t i) {
    for (int c = 0; c < 3; c++) out.positions[3 * i + c] = out.log_scales[3 * i + c] = 0.0f;
    for (int c = 0; c < 4; c++) out.rotations[4 * i + c] = 0.0f;
    for (int c = 0; c < SH_ROW; c++) out.sh[SH_ROW * i + c] = 0.0f;
    out.opacity_logits[i] = 0.0f;
}

static inline void add_statistics(const Statistics &out, const float *sum, const float *record, float gradient, int i) {
    if (!(sum[SUM_WEIGHT] > 0.0f)) return;
    out.weight[i] += sum[SUM_WEIGHT], out.error[i] += sum[SUM_ERROR], out.motion[i] += sum[SUM_MOTION];
    out.gradient[i] += gradient;
    out.count[i]++;
    if (record[REC_RADIUS] > out.max_radius[i]) out.max_radius[i] = record[REC_RADIUS];
}

// Writes every row of the five gradients (zero where nothing was drawn). columns: how many of each slot's sums were
// written.
KERNEL(project_backward, int n, BY_VALUE Camera camera, const float *positions, const float *log_scales,
       const float *rotations, const float *opacity_logits, const float *sh, const float *filter_3d, int degree,
       const float4 *records, const int *tile_counts, const int *slot_starts, const uint8_t *hits,
       const float *slot_sums, int columns, ParameterGradients out, Statistics statistics) {
    EACH(i, n) {
        float sum[SUM_SIZE];
        if (!tile_counts[i] || !add_slots(sum, slot_starts[i], tile_counts[i], hits, slot_sums, columns) ||
            !sound(sum, SUM_SIZE)) {
            zero_rows(out, i);
            continue;
        }
        union {
            float of[REC_SIZE];
            float4 four[(REC_SIZE / 4)];
        } record;
        for (int f = 0; f < (REC_SIZE / 4); f++) record.four[f] = records[(int64_t)i * (REC_SIZE / 4) + f];
        const Parameters in = {positions, log_scales, rotations, opacity_logits, sh, filter_3d};
        Lanes s;
        LaneGradients g;
        float position[3], log_scale[3], rotation[4], logit;
        prepare_lanes(&s, &in, &camera, i, n);
        geometry_gradients(&s, record.of, sum, &camera, &g);
        const float *r = camera.rotation;
        for (int c = 0; c < 3; c++) position[c] = r[c] * g.m[0] + r[3 + c] * g.m[1] + r[6 + c] * g.m[2];
        quaternion_gradient(&s, &camera, g.axis, rotation);
        scale_gradients(&s, &g, log_scale, &logit);
        color_gradient(&s, sh + SH_ROW * (int64_t)i, &camera, sum, record.of, degree, out.sh + SH_ROW * (int64_t)i,
                       position);
        if (!(sound(position, 3) && sound(log_scale, 3) && sound(rotation, 4) && sound(&logit, 1))) {
            // beyond float32 (scales at their bound, focal lengths below a pixel): as none
            for (int c = 0; c < 3; c++) position[c] = log_scale[c] = 0.0f;
            for (int c = 0; c < 4; c++) rotation[c] = 0.0f;
            logit = g.centre[0] = g.centre[1] = 0.0f;
        }
        for (int c = 0; c < 3; c++)
            out.positions[3 * (int64_t)i + c] = position[c], out.log_scales[3 * (int64_t)i + c] = log_scale[c];
        for (int c = 0; c < 4; c++) out.rotations[4 * (int64_t)i + c] = rotation[c];
        out.opacity_logits[i] = logit;
        if (statistics.weight) add_statistics(statistics, sum, record.of, centre_gradient(&g, &camera), i);
    }
}
