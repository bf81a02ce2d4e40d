// SPDX-License-Identifier: GPL-3.0-or-later
// From the raw parameters of Gaussians to the records that are blended (records.h), their footprints and depths.
// The formulas and where they come from: project.h.
#include "raster/project.h"

#include <string.h>

#include "common/export.h"
#include "raster/harmonics.h"
#include "raster/rows.h"

enum { PIECE = 256 };  // Gaussians per piece of work

// max(0, 1/2 + sum_b Y_b sh[b]); returns where it is finite.
static inline i16 colors(const Lanes *s, const Parameters *in, const Camera *camera, int degree, int64_t first,
                         int64_t n, v16 *rgb) {
    v16 dir[3], inv_distance, basis[16];
    view_direction(s, camera, dir, &inv_distance);
    sh_basis(degree, dir[0], dir[1], dir[2], basis);
    v16 coefficients[SH_ROW], sum[3] = {splat(0.5f), splat(0.5f), splat(0.5f)};
    load_columns(coefficients, SH_PARTS(degree), in->sh, SH_ROW, first, n);
    for (int b = 0; b < SH_COUNT(degree); b++)
        for (int c = 0; c < 3; c++) sum[c] += basis[b] * coefficients[3 * b + c];
    for (int c = 0; c < 3; c++) rgb[c] = vmax(sum[c], splat(0.0f));
    const v16 all = sum[0] + sum[1] + sum[2];
    return all - all == 0.0f;
}

// Fills records [n, 32], footprints [n] (8 words each), tile_counts [n] (0: not drawn) and depth_keys [n] (bits of the
// depth). Records and footprints of Gaussians that are not drawn may hold anything.
MGF_API void mgf_project(int32_t *next, int64_t n, const Camera *camera, const float *positions,
                         const float *log_scales, const float *rotations, const float *opacity_logits, const float *sh,
                         const float *filter_3d, int64_t degree, int64_t tiles_x, int64_t tiles_y,
                         const int32_t *mask_sums, float *records, Footprint *footprints, int32_t *tile_counts,
                         uint32_t *depth_keys) {
    const Parameters in = {positions, log_scales, rotations, opacity_logits, sh, filter_3d};
    for (;;) {
        const int64_t start = take_work(next) * PIECE, end = start + PIECE < n ? start + PIECE : n;
        if (start >= n) return;
        for (int64_t first = start; first < end; first += 16) {
            const int lanes = end - first < 16 ? (int)(end - first) : 16;
            for (int l = 0; l < lanes; l++) tile_counts[first + l] = 0;
            fetch_rows(sh, SH_ROW, 3 * SH_COUNT(degree), first, n);
            Lanes s;
            v16 rec[REC_SIZE];
            prepare_lanes(&s, &in, camera, first, n);
            geometry_columns(&s, camera, rec);
            i16 drawn = s.front & (rec[REC_OPACITY] > ALPHA_MIN);
            v16 sum = rec[0];  // not finite when any column is not
            for (int c = 1; c <= REC_NZ; c++)
                if (c < REC_R || c > REC_B) sum += rec[c];
            drawn &= (sum - sum == 0.0f);
            if (!any(drawn)) continue;
            drawn &= colors(&s, &in, camera, (int)degree, first, n, rec + REC_R);
            d16 k;
            for (int l = 0; l < 16; l++) k[l] = drawn[l] ? 2.0 * __builtin_log(255.0 * rec[REC_OPACITY][l]) : 1.0;
            rec[REC_THRESHOLD] = narrow((-0.5 * 1.4426950408889634) * k), rec[REC_SIZE - 1] = splat(0.0f);
            v16 shape[16] = {{0}};
            footprint_columns(rec, k, camera, shape);
            const v16 depth = rec[REC_B0];
            store_columns(records, REC_SIZE, rec, REC_SIZE / 16, first, lanes);
            transpose16(shape);
            for (int l = 0; l < lanes; l++) {
                if (!drawn[l]) continue;
                memcpy(footprints + first + l, shape + l, sizeof *footprints);
                tile_counts[first + l] = count_tiles(footprints + first + l, mask_sums, (int)tiles_x, (int)tiles_y);
                depth_keys[first + l] = (uint32_t)((i16)depth)[l];  // bits of positive floats sort like them
            }
        }
    }
}
