// SPDX-License-Identifier: GPL-3.0-or-later
// From the raw parameters of Gaussians to records, footprints and depths; one thread a Gaussian. The formulas are those
// of the C kernels, from the same headers (project.h, gaussian.h, footprint.h, harmonics.h).
#include "cuda/block.cuh"

#include "raster/harmonics.h"
#include "raster/project.h"

// sums [tiles_y, tiles_x + 1]: running count of wanted tiles along each row of mask [tiles_y, tiles_x] (null: all are
// wanted).
KERNEL(mask_rows, int tiles_x, int tiles_y, const uint8_t *mask, int *sums) {
    EACH(y, tiles_y) {
        int count = 0;
        for (int x = 0; x < tiles_x; x++) {
            sums[y * (tiles_x + 1) + x] = count;
            count += mask ? mask[y * tiles_x + x] != 0 : 1;
        }
        sums[y * (tiles_x + 1) + tiles_x] = count;
    }
}

// max(0, 1/2 + sum_b Y_b sh[b]) of one Gaussian; returns whether it is finite.
static inline bool color(const Lanes *s, const float *sh, const Camera *camera, int degree, float *rgb) {
    float direction[3], inv_distance, basis[16], sum[3] = {0.5f, 0.5f, 0.5f};
    view_direction(s, camera, direction, &inv_distance);
    sh_basis(degree, direction[0], direction[1], direction[2], basis);
    const int count = (degree + 1) * (degree + 1);
    for (int b = 0; b < count; b++)
        for (int c = 0; c < 3; c++) sum[c] += basis[b] * sh[3 * b + c];
    for (int c = 0; c < 3; c++) rgb[c] = vmax(sum[c], 0.0f);
    const float all = sum[0] + sum[1] + sum[2];
    return all - all == 0.0f;
}

// Fills records [n, 32], footprints [n], tile_counts [n] (0: not drawn) and depth_keys [n] (bits of the depth; all ones
// where nothing is drawn, so that those sort to the end).
KERNEL(project, int n, BY_VALUE Camera camera, const float *positions, const float *log_scales, const float *rotations,
       const float *opacity_logits, const float *sh, const float *filter_3d, int degree, int tiles_x, int tiles_y,
       const int *mask_sums, float4 *records, Footprint *footprints, int *tile_counts, uint32_t *depth_keys) {
    EACH(i, n) {
        const Parameters in = {positions, log_scales, rotations, opacity_logits, sh, filter_3d};
        Lanes s;
        union {
            float of[REC_SIZE];
            float4 four[REC_SIZE / 4];
        } record;
        tile_counts[i] = 0, depth_keys[i] = ~0u;
        prepare_lanes(&s, &in, &camera, i, n);
        if (!s.front) continue;
        geometry_columns(&s, &camera, record.of);
        if (!(record.of[REC_OPACITY] > ALPHA_MIN)) continue;
        if (!color(&s, sh + SH_ROW * (int64_t)i, &camera, degree, record.of + REC_R)) continue;
        float sum = 0.0f;  // not finite when any column is not
        for (int c = 0; c <= REC_NZ; c++) sum += record.of[c];
        if (!(sum - sum == 0.0f)) continue;
        const double k = 2.0 * log(255.0 * record.of[REC_OPACITY]);
        record.of[REC_THRESHOLD] = (float)(-0.5 * 1.4426950408889634 * k), record.of[REC_SIZE - 1] = 0.0f;
        union {
            float columns[SHAPE_SIZE];
            Footprint footprint;
        } shape;
        footprint_columns(record.of, k, &camera, shape.columns);
        for (int f = 0; f < REC_SIZE / 4; f++) records[(int64_t)i * (REC_SIZE / 4) + f] = record.four[f];
        footprints[i] = shape.footprint;
        tile_counts[i] = count_tiles(&shape.footprint, mask_sums, tiles_x, tiles_y);
        union { float f; uint32_t u; } bits = {record.of[REC_B0]};
        if (tile_counts[i]) depth_keys[i] = bits.u;  // positive floats sort like their bits
    }
}
