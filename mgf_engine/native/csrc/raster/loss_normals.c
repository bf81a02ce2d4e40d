// SPDX-License-Identifier: GPL-3.0-or-later
// The normal term of the training loss: normals.h on the expected depth (rendered depth / alpha) of labelled pixels
// that are more than half covered. Gradients go unscaled into the planes of the frame; mgf_loss_finish divides them by
// the weights' sum.
#include <stdlib.h>
#include <string.h>

#include "common/export.h"
#include "raster/normals.h"

enum { STAGED = NORMAL_STRIP + 4 }; /* rows of depth and weight a strip needs */

static void stage_row(const float *restrict depth, const float *restrict alpha, const uint8_t *restrict labels,
                      int64_t n, float *restrict z, float *restrict weight) {
    for (int64_t i = 0; i < n; i++) {
        const int on = (labels[i] > 0) & (alpha[i] > 0.5f);
        z[i] = on ? depth[i] / alpha[i] : 0.0f;
        weight[i] = on ? 1.0f : 0.0f;
    }
}

/* depth, alpha and normal (planes image_plane apart) of the render at the box; labels uint8 [height][width]; strips:
   which strips of 16 rows hold a label. sums [strips][2] given as zeros: loss and weight. g_depth, g_normal, g_alpha:
   planes of the frame at the box, rows g_row and planes g_plane apart; strips without a label are not written. Needs
   height >= 3 and width >= 3. */
MGF_API void mgf_loss_normals(int32_t *next, const float *depth, const float *normal, const float *alpha,
                              int64_t image_plane, int64_t image_row, const uint8_t *labels, const uint8_t *strips,
                              int64_t height, int64_t width, float fx, float fy, float cx, float cy, double *sums,
                              float *g_depth, float *g_normal, float *g_alpha, int64_t g_row, int64_t g_plane,
                              int32_t *failed) {
    const int64_t row = ROW_PLANES * width, strip_plane = (NORMAL_STRIP + 2) * row,
                  count = (height + NORMAL_STRIP - 1) / NORMAL_STRIP;
    float *rows = malloc(sizeof(float) * (strip_plane + (4 + 2 * STAGED) * width));
    if (!rows) {
        *failed = 1;
        return;
    }
    float *unused = rows + strip_plane, *z = unused + 4 * width, *weight = z + STAGED * width;
    for (int64_t strip; (strip = take_work(next)) < count;) {
        if (!strips[strip]) continue;
        const int64_t s0 = strip * NORMAL_STRIP, s1 = s0 + NORMAL_STRIP > height ? height : s0 + NORMAL_STRIP;
        for (int64_t y = s0 - 2 < 0 ? 0 : s0 - 2; y < s1 + 2 && y < height; y++)
            stage_row(depth + y * image_row, alpha + y * image_row, labels + y * width, width, z + (y - s0 + 2) * width,
                      weight + (y - s0 + 2) * width);
        /* row s0 - 2 of the staged maps is row 0 of z: move their origins to row 0 of the box */
        const Maps m = {z - (s0 - 2) * width, weight - (s0 - 2) * width, normal, alpha, width, image_row, image_plane,
                        height, width, fx, fy, cx, cy};
        memset(rows, 0, sizeof(float) * strip_plane);
        for (int64_t y = s0 - 1; y <= s1; y++) {
            const int own = y >= s0 && y < s1;
            float *out = rows + (y - s0 + 1) * row, *gn = own ? g_normal + y * g_row : unused,
                  *ga = own ? g_alpha + y * g_row : unused;
            if (own)
                for (int k = 0; k < 3; k++) memset(gn + k * g_plane, 0, sizeof(float) * width);
            if (own) memset(ga, 0, sizeof(float) * width);
            if (y < 1 || y > height - 2) continue;
            row_gradients(&m, y, out, gn, own ? g_plane : width, own ? ga : unused + 3 * width);
            if (!own) continue;
            sums[2 * strip] += sum_row(out + LOSS * width, width);
            sums[2 * strip + 1] += sum_row(out + WEIGHT * width, width);
        }
        for (int64_t y = s0; y < s1; y++) {
            const float *here = rows + (y - s0 + 1) * row;
            gather_depth(&m, y, here - row, here, here + row, g_depth + y * g_row);
        }
    }
    free(rows);
}
