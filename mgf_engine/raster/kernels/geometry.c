// SPDX-License-Identifier: GPL-3.0-or-later
// Agreement of rendered normals with the normals of the rendered depth (lambda 4 of eq. 20), value and gradient. Formulas: normals.h.
#include <stdlib.h>
#include <string.h>

#include "export.h"
#include "normals.h"

/* Sums of the loss and of the weights that count, per strip of 16 rows: sums[strip][2]; and the gradients of the loss
   sum: g_depth [H][W], g_normal [3][H][W], g_alpha [H][W] (sums and gradients given as zeros).
   Needs height >= 3 and width >= 3. Sets *failed when it cannot get its scratch memory. */
MGF_API void normal_consistency_work(int32_t *next, const float *depth, const float *normal, const float *alpha,
                                const float *weight, int64_t height, int64_t width, float fx, float fy, float cx, float cy,
                                double *sums, float *g_depth, float *g_normal, float *g_alpha, int32_t *failed) {
  Maps m = {depth, weight, normal, alpha, width, width, height * width, height, width, fx, fy, cx, cy};
  const int64_t row = ROW_PLANES * width, strip_plane = (NORMAL_STRIP + 2) * row;
  float *rows = malloc(sizeof(float) * (strip_plane + 4 * width)), *unused = rows + strip_plane;
  if (!rows) {
    *failed = 1;
    return;
  }
  for (;;) {
    int64_t strip = take_work(next), s0 = strip * NORMAL_STRIP;
    if (s0 >= height) break;
    int64_t s1 = s0 + NORMAL_STRIP > height ? height : s0 + NORMAL_STRIP;
    memset(rows, 0, sizeof(float) * strip_plane);
    for (int64_t y = s0 - 1; y <= s1; y++) {
      if (y < 1 || y > height - 2) continue;
      float *out = rows + (y - s0 + 1) * row;
      if (y < s0 || y >= s1) { /* a neighbour's row: only its dL/dX, dL/dY are needed */
        row_gradients(&m, y, out, unused, width, unused + 3 * width);
        continue;
      }
      int64_t at = y * width;
      row_gradients(&m, y, out, g_normal + at, height * width, g_alpha + at);
      sums[2 * strip] += sum_row(out + LOSS * width, width);
      sums[2 * strip + 1] += sum_row(out + WEIGHT * width, width);
    }
    for (int64_t y = s0; y < s1; y++) {
      const float *here = rows + (y - s0 + 1) * row;
      gather_depth(&m, y, here - row, here, here + row, g_depth + y * width);
    }
  }
  free(rows);
}
