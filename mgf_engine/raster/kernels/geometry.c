// SPDX-License-Identifier: GPL-3.0-or-later
// Agreement of rendered normals with the normals of the rendered depth (lambda 4 of eq. 20), value and gradient.
//
// A pixel (x, y) of depth z is the camera-frame point P = z ((x + 0.5 - cx)/fx, (y + 0.5 - cy)/fy, 1). With central
// differences X = P(x+1) - P(x-1), Y = P(y+1) - P(y-1), the normal n = Y x X / |Y x X| faces the camera for any
// positive depths. The loss of a pixel is weight * (alpha - N.n), N the rendered (premultiplied) normal.
#include <stdlib.h>
#include <string.h>

#include "export.h"

#define STRIP 16
#define LANES 16

/* The six components of dL/dX and dL/dY of one row, and its loss and weight, each `width` floats. */
enum { GX0, GX1, GX2, GY0, GY1, GY2, LOSS, WEIGHT, ROW_PLANES };

typedef struct {
  const float *depth, *normal, *alpha, *weight;
  int64_t height, width;
  float fx, fy, cx, cy;
} Maps;

/* g_normal (three rows, g_plane floats apart) and g_alpha: where this row's gradients go. */
static void row_gradients(const Maps *m, int64_t y, float *restrict out, float *restrict g_normal, int64_t g_plane,
                          float *restrict g_alpha) {
  const int64_t w = m->width;
  const int64_t plane = m->height * w, at = y * w;
  const float *restrict here = m->depth + at, *restrict up = here - w, *restrict down = here + w;
  const float *restrict weight = m->weight + at, *restrict w_up = weight - w, *restrict w_down = weight + w;
  const float *restrict alpha = m->alpha + at, *restrict normal = m->normal + at;
  const float ix = 1.0f / m->fx, iy = 1.0f / m->fy, v = (y + 0.5f - m->cy) * iy, v0 = v - iy, v1 = v + iy;
#pragma clang loop vectorize(enable) interleave(disable)
  for (int64_t x = 1; x < w - 1; x++) {
    int valid = (weight[x] > 0) & (weight[x - 1] > 0) & (weight[x + 1] > 0) & (w_up[x] > 0) & (w_down[x] > 0) &
                (here[x] > 0) & (here[x - 1] > 0) & (here[x + 1] > 0) & (up[x] > 0) & (down[x] > 0);
    float u = (x + 0.5f - m->cx) * ix, a = here[x - 1], b = here[x + 1], c = up[x], d = down[x];
    float X0 = b * (u + ix) - a * (u - ix), X2 = b - a, X1 = X2 * v;
    float Y1 = d * v1 - c * v0, Y2 = d - c, Y0 = Y2 * u;
    float n0 = Y1 * X2 - Y2 * X1, n1 = Y2 * X0 - Y0 * X2, n2 = Y0 * X1 - Y1 * X0;
    float square = n0 * n0 + n1 * n1 + n2 * n2;
    valid &= square > 1e-30f;
    float k = valid ? weight[x] : 0.0f, inverse = 1.0f / __builtin_sqrtf(valid ? square : 1.0f);
    n0 *= inverse, n1 *= inverse, n2 *= inverse;
    float N0 = normal[x], N1 = normal[x + plane], N2 = normal[x + 2 * plane], dot = N0 * n0 + N1 * n1 + N2 * n2;
    out[LOSS * w + x] = k * ((valid ? alpha[x] : 0.0f) - (valid ? dot : 0.0f));
    out[WEIGHT * w + x] = k;
    g_alpha[x] = k;
    g_normal[x] = valid ? -k * n0 : 0.0f;
    g_normal[x + g_plane] = valid ? -k * n1 : 0.0f;
    g_normal[x + 2 * g_plane] = valid ? -k * n2 : 0.0f;
    float s = -k * inverse; /* dL/d(Y x X) = s (N - (N.n) n) */
    float h0 = s * (N0 - dot * n0), h1 = s * (N1 - dot * n1), h2 = s * (N2 - dot * n2);
    /* d(h . Y x X) = dX . (h x Y) + dY . (X x h) */
    out[GX0 * w + x] = valid ? h1 * Y2 - h2 * Y1 : 0.0f;
    out[GX1 * w + x] = valid ? h2 * Y0 - h0 * Y2 : 0.0f;
    out[GX2 * w + x] = valid ? h0 * Y1 - h1 * Y0 : 0.0f;
    out[GY0 * w + x] = valid ? X1 * h2 - X2 * h1 : 0.0f;
    out[GY1 * w + x] = valid ? X2 * h0 - X0 * h2 : 0.0f;
    out[GY2 * w + x] = valid ? X0 * h1 - X1 * h0 : 0.0f;
  }
}

/* dL/ddepth of one row: depth (x, y) enters X of its left and right neighbour and Y of those above and below. */
static void gather_depth(const Maps *m, int64_t y, const float *restrict up, const float *restrict here,
                         const float *restrict down, float *restrict g_depth) {
  const int64_t w = m->width;
  const float v = (y + 0.5f - m->cy) / m->fy, ix = 1.0f / m->fx;
  for (int64_t x = 0; x < w; x++) {
    float u = (x + 0.5f - m->cx) * ix, sum = up[GY0 * w + x] * u + up[GY1 * w + x] * v + up[GY2 * w + x];
    g_depth[x] = sum - (down[GY0 * w + x] * u + down[GY1 * w + x] * v + down[GY2 * w + x]);
  }
  for (int64_t x = 1; x < w - 1; x++) {
    float u = (x + 0.5f - m->cx) * ix;
    g_depth[x] += (here[GX0 * w + x - 1] - here[GX0 * w + x + 1]) * u +
                      (here[GX1 * w + x - 1] - here[GX1 * w + x + 1]) * v + here[GX2 * w + x - 1] - here[GX2 * w + x + 1];
  }
  g_depth[0] -= here[GX0 * w + 1] * (0.5f - m->cx) * ix + here[GX1 * w + 1] * v + here[GX2 * w + 1];
  g_depth[w - 1] += here[GX0 * w + w - 2] * (w - 0.5f - m->cx) * ix + here[GX1 * w + w - 2] * v + here[GX2 * w + w - 2];
}

static double sum_row(const float *v, int64_t n) {
  double part[LANES] = {0}, total = 0;
  int64_t i = 0;
  for (; i + LANES <= n; i += LANES)
    for (int k = 0; k < LANES; k++) part[k] += v[i + k];
  for (; i < n; i++) total += v[i];
  for (int k = 0; k < LANES; k++) total += part[k];
  return total;
}

/* Sums of the loss and of the weights that count, per strip of 16 rows: sums[strip][2]; and the gradients of the loss
   sum: g_depth [H][W], g_normal [3][H][W], g_alpha [H][W] (sums and gradients given as zeros).
   Needs height >= 3 and width >= 3. Sets *failed when it cannot get its scratch memory. */
MGF_API void normal_consistency_work(int32_t *next, const float *depth, const float *normal, const float *alpha,
                                const float *weight, int64_t height, int64_t width, float fx, float fy, float cx, float cy,
                                double *sums, float *g_depth, float *g_normal, float *g_alpha, int32_t *failed) {
  Maps m = {depth, normal, alpha, weight, height, width, fx, fy, cx, cy};
  const int64_t row = ROW_PLANES * width, strip_plane = (STRIP + 2) * row;
  float *rows = malloc(sizeof(float) * (strip_plane + 4 * width)), *unused = rows + strip_plane;
  if (!rows) {
    *failed = 1;
    return;
  }
  for (;;) {
    int64_t strip = take_work(next), s0 = strip * STRIP;
    if (s0 >= height) break;
    int64_t s1 = s0 + STRIP > height ? height : s0 + STRIP;
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
