// SPDX-License-Identifier: GPL-3.0-or-later
// Gradients of the projection (project.c): from the sums that blending left per list entry to the raw parameters.
// The formulas: project_gradients.h.
#include "raster/project_gradients.h"

#include <string.h>

#include "common/export.h"
#include "raster/harmonics.h"
#include "raster/rows.h"

enum { PIECE = 256 };

typedef struct {
    float *positions, *log_scales, *rotations, *opacity_logits, *sh;  // gradients, shaped like the parameters
} ParameterGradients;

// Per Gaussian, added to; any of them may be null.
typedef struct {
    float *weight, *error, *gradient, *motion, *max_radius;
    int32_t *count;
} Statistics;

// sums[c] lane l: column c added over the slots of Gaussian first + l; zero for lanes that are not drawn. Columns from
// 16 on only where there are any (blend_backward.c).
static inline void add_slots(v16 *sums, int64_t first, int lanes, const int64_t *slot_starts, const uint16_t *hits,
                             const float *slot_sums, int columns) {
    enum { LAST = SUM_SIZE - 16 };  // the last sixteen columns begin here
    v16 low[16], high[16];
    for (int l = 0; l < 16; l++) {
        low[l] = high[l] = splat(0.0f);
        if (l >= lanes) continue;
        for (int64_t slot = slot_starts[first + l]; slot < slot_starts[first + l + 1]; slot++) {
            if (!hits[slot]) continue;
            low[l] += load16(slot_sums + slot * SUM_SIZE);
            if (columns > 16) high[l] += load16(slot_sums + slot * SUM_SIZE + LAST);
        }
    }
    transpose16(low), transpose16(high);
    for (int c = 0; c < SUM_SIZE; c++) sums[c] = c < 16 ? low[c] : high[c - LAST];
}

// Gradients of the harmonics' coefficients (into the result's rows) and of the position through the view direction.
static inline void color_gradients(const Lanes *s, const Parameters *in, const Camera *camera, const v16 *sum,
                                   const v16 *rec, int degree, i16 drawn, int64_t first, int lanes, int64_t n,
                                   const ParameterGradients *out, v16 *position) {
    v16 dir[3], distance2 = splat(0.0f), basis[16], along_basis[16], g_dir[3], g[3];
    for (int i = 0; i < 3; i++) dir[i] = s->p[i] - camera->centre[i], distance2 += dir[i] * dir[i];
    const v16 inv_distance = 1.0f / vsqrt(vmax(distance2, splat(1e-20f)));
    for (int i = 0; i < 3; i++) dir[i] = keep(drawn, dir[i] * inv_distance);
    sh_basis(degree, dir[0], dir[1], dir[2], basis);
    for (int c = 0; c < 3; c++) g[c] = keep(rec[REC_R + c] > 0.0f, sum[SUM_R + c]);  // max(0, ..) stops it
    v16 columns[SH_ROW];
    load_columns(columns, SH_PARTS(degree), in->sh, SH_ROW, first, n);
    for (int b = 0; b < SH_COUNT(degree); b++)
        along_basis[b] = g[0] * columns[3 * b] + g[1] * columns[3 * b + 1] + g[2] * columns[3 * b + 2];
    for (int c = 0; c < SH_ROW; c++) columns[c] = c < 3 * SH_COUNT(degree) ? basis[c / 3] * g[c % 3] : splat(0.0f);
    store_columns(out->sh, SH_ROW, columns, SH_ROW / 16, first, lanes);
    sh_direction_gradient(degree, dir[0], dir[1], dir[2], along_basis, g_dir);
    const v16 along = g_dir[0] * dir[0] + g_dir[1] * dir[1] + g_dir[2] * dir[2];
    for (int i = 0; i < 3; i++) position[i] += (g_dir[i] - dir[i] * along) * inv_distance;
}

static inline void store_rows(float *rows, const v16 *columns, int width, int64_t first, int lanes) {
    for (int l = 0; l < lanes; l++)
        for (int c = 0; c < width; c++) rows[(first + l) * width + c] = ((const float *)(columns + c))[l];
}

static inline void add_statistics(const Statistics *out, const v16 *sum, const v16 *rec, v16 gradient, int64_t first,
                                  int lanes) {
    for (int l = 0; l < lanes; l++) {
        const float weight = ((const float *)(sum + SUM_WEIGHT))[l], radius = ((const float *)(rec + REC_RADIUS))[l];
        if (!(weight > 0.0f)) continue;
        out->weight[first + l] += weight;
        out->error[first + l] += ((const float *)(sum + SUM_ERROR))[l];
        out->gradient[first + l] += ((const float *)&gradient)[l];
        out->motion[first + l] += ((const float *)(sum + SUM_MOTION))[l];
        out->count[first + l]++;
        if (radius > out->max_radius[first + l]) out->max_radius[first + l] = radius;
    }
}

static inline void zero_rows(const ParameterGradients *out, int64_t first, int lanes) {
    memset(out->positions + 3 * first, 0, 3 * (size_t)lanes * sizeof(float));
    memset(out->log_scales + 3 * first, 0, 3 * (size_t)lanes * sizeof(float));
    memset(out->rotations + 4 * first, 0, 4 * (size_t)lanes * sizeof(float));
    memset(out->opacity_logits + first, 0, (size_t)lanes * sizeof(float));
    memset(out->sh + SH_ROW * first, 0, SH_ROW * (size_t)lanes * sizeof(float));
}

// All steps for Gaussians first..first + lanes - 1.
static void differentiate_lanes(int64_t first, int lanes, int64_t n, const Camera *camera, const Parameters *in,
                                int degree, const float *records, const int32_t *tile_counts, v16 *sum,
                                const ParameterGradients *out, const Statistics *statistics) {
    v16 rec[REC_SIZE];
    i16 drawn = (i16){0};
    for (int l = 0; l < lanes; l++) drawn[l] = tile_counts[first + l] ? -1 : 0;
    load_columns(rec, REC_SIZE / 16, records, REC_SIZE, first, n);
    for (int c = 0; c < REC_SIZE; c++) rec[c] = choose(drawn, rec[c], splat(c == REC_OPACITY ? 1.0f : 0.0f));
    // Sums and gradients beyond float32 (scales at their bound, focal lengths below a pixel) count as none.
    const i16 summed = drawn & sound(sum, SUM_SIZE);
    for (int c = 0; c < SUM_SIZE; c++) sum[c] = keep(summed, sum[c]);
    Lanes s;
    LaneGradients g;
    v16 position[3], log_scales[3], rotation[4], logit;
    prepare_lanes(&s, in, camera, first, n);
    geometry_gradients(&s, rec, sum, camera, &g);
    const float *r = camera->rotation;
    for (int i = 0; i < 3; i++) position[i] = r[i] * g.m[0] + r[3 + i] * g.m[1] + r[6 + i] * g.m[2];
    quaternion_gradient(&s, camera, g.axis, rotation);
    scale_gradients(&s, &g, log_scales, &logit);
    color_gradients(&s, in, camera, sum, rec, degree, drawn, first, lanes, n, out, position);
    const i16 kept = summed & sound(position, 3) & sound(log_scales, 3) & sound(rotation, 4) & sound(&logit, 1);
    for (int i = 0; i < 3; i++) position[i] = keep(kept, position[i]), log_scales[i] = keep(kept, log_scales[i]);
    for (int i = 0; i < 4; i++) rotation[i] = keep(kept, rotation[i]);
    logit = keep(kept, logit);
    store_rows(out->positions, position, 3, first, lanes);
    store_rows(out->log_scales, log_scales, 3, first, lanes);
    store_rows(out->rotations, rotation, 4, first, lanes);
    store_rows(out->opacity_logits, &logit, 1, first, lanes);
    if (statistics->weight) add_statistics(statistics, sum, rec, keep(kept, centre_gradient(&g, camera)), first, lanes);
}

// Writes every row of the five gradients (zero where a Gaussian is not drawn); the statistics are added to, or null.
MGF_API void mgf_project_backward(int32_t *next, int64_t n, const Camera *camera, const float *positions,
                                  const float *log_scales, const float *rotations, const float *opacity_logits,
                                  const float *sh, const float *filter_3d, int64_t degree, const float *records,
                                  const int32_t *tile_counts, const int64_t *slot_starts, const uint16_t *hits,
                                  const float *slot_sums, int64_t columns, float *g_positions, float *g_log_scales,
                                  float *g_rotations, float *g_opacity_logits, float *g_sh, float *weight, float *error,
                                  float *gradient, float *motion, float *max_radius, int32_t *count) {
    const Parameters in = {positions, log_scales, rotations, opacity_logits, sh, filter_3d};
    const ParameterGradients out = {g_positions, g_log_scales, g_rotations, g_opacity_logits, g_sh};
    const Statistics statistics = {weight, error, gradient, motion, max_radius, count};
    for (;;) {
        const int64_t start = take_work(next) * PIECE, end = start + PIECE < n ? start + PIECE : n;
        if (start >= n) return;
        for (int64_t first = start; first < end; first += 16) {
            const int lanes = end - first < 16 ? (int)(end - first) : 16;
            if (slot_starts[first] == slot_starts[first + lanes]) {
                zero_rows(&out, first, lanes);
                continue;
            }
            fetch_rows(sh, SH_ROW, 3 * SH_COUNT(degree), first, n);
            v16 sum[SUM_SIZE];
            add_slots(sum, first, lanes, slot_starts, hits, slot_sums, (int)columns);
            differentiate_lanes(first, lanes, n, camera, &in, (int)degree, records, tile_counts, sum, &out,
                                &statistics);
        }
    }
}
