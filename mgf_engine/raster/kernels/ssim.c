// SPDX-License-Identifier: GPL-3.0-or-later
// Structural similarity (eq. 16-18, Wang et al. 2004) of a render and its photo: separable 11x11 Gaussian window,
// zero padding, forward and backward.
//
// All images are float32 [3][height][width] given by a pointer, a channel stride and a row stride (in floats); the
// box (y0, y1, x0, x1) limits the pixels whose similarity is asked for. Work is cut into strips of rows that threads
// take from the counter. A worker that cannot get its scratch memory sets *failed and returns.
#include <stdlib.h>
#include <string.h>

#include "export.h"
#include "window.h"

#define STRIP 32
#define HALO (STRIP + 2 * R)

/* Horizontal blur of a and a*a. */
WIDE static void blur_squares(const float *a, int64_t n, float *mean, float *square) {
  for (int64_t i = 0; i < n; i += LANES) {
    vec m = {0}, s = {0};
    UNROLL for (int j = 0; j <= 2 * R; j++) {
      vec v = *(const loose *)(a + i + j), wv = W[j] * v;
      m += wv;
      s += wv * v;
    }
    *(vec *)(mean + i) = m;
    *(vec *)(square + i) = s;
  }
}

/* Horizontal blur of a, a*a and a*b. */
WIDE static void blur_products(const float *a, const float *b, int64_t n, float *mean, float *square, float *product) {
  for (int64_t i = 0; i < n; i += LANES) {
    vec m = {0}, s = {0}, p = {0};
    UNROLL for (int j = 0; j <= 2 * R; j++) {
      vec v = *(const loose *)(a + i + j), wv = W[j] * v;
      m += wv;
      s += wv * v;
      p += wv * *(const loose *)(b + i + j);
    }
    *(vec *)(mean + i) = m;
    *(vec *)(square + i) = s;
    *(vec *)(product + i) = p;
  }
}

/* `planes` buffers of HALO rows of n floats and four lines, aligned for vec; *block is what free() takes. */
static float *scratch(int64_t planes, int64_t n, int64_t line, void **block) {
  *block = malloc(sizeof(float) * ((size_t)planes * HALO * n + 4 * (size_t)line) + 64);
  return *block ? (float *)(((uintptr_t)*block + 63) & ~(uintptr_t)63) : 0;
}

/* Blurred moments of the photo inside the box: out[0] mean, out[1] variance, each [3][y1-y0][x1-x0]. */
MGF_API void ssim_target_work(int32_t *next, const float *y, int64_t y_channel, int64_t y_row, int64_t height,
                         int64_t width, int64_t y0, int64_t y1, int64_t x0, int64_t x1, float *out, int32_t *failed) {
  int64_t bw = x1 - x0, bh = y1 - y0, n = round_up(bw), line = n + 2 * LANES;
  void *block;
  float *tmp = scratch(2, n, line, &block);
  if (!tmp) {
    *failed = 1;
    return;
  }
  float *a = tmp + 2 * (size_t)HALO * n;
  for (;;) {
    int64_t s0 = y0 + STRIP * take_work(next);
    if (s0 >= y1) break;
    int64_t count = s0 + STRIP > y1 ? y1 - s0 : STRIP;
    for (int c = 0; c < 3; c++) {
      float *mean = tmp, *square = tmp + (size_t)HALO * n;
      memset(tmp, 0, sizeof(float) * 2 * HALO * n);
      for (int64_t r = clamp(s0 - R, 0, height); r < clamp(s0 + count + R, 0, height); r++) {
        int64_t at = (r - s0 + R) * n;
        load_line(y + c * y_channel + r * y_row, width, x0 - R, bw + 2 * R, line, a);
        blur_squares(a, n, mean + at, square + at);
      }
      blur_columns(mean, count, n);
      blur_columns(square, count, n);
      for (int64_t r = 0; r < count; r++) {
        float *restrict o = out + (c * bh + s0 - y0 + r) * bw, *restrict v = o + 3 * bh * bw;
        const float *restrict m = mean + r * n, *restrict q = square + r * n;
        for (int64_t i = 0; i < bw; i++) o[i] = m[i], v[i] = q[i] - m[i] * m[i];
      }
    }
  }
  free(block);
}

/* Similarity and contrast-structure maps (means over the channels) inside the box of [height][width] maps.
   target: moments of the photo, mean and variance `target_plane` floats apart, first box pixel, own strides.
   saved: [3 moments][3][y1-y0][x1-x0] for the backward pass: mean and variance of x, covariance. */
MGF_API void ssim_forward_work(int32_t *next, const float *x, int64_t x_channel, int64_t x_row, const float *y,
                          int64_t y_channel, int64_t y_row, const float *target, int64_t target_plane,
                          int64_t target_channel, int64_t target_row, int64_t height, int64_t width, int64_t y0,
                          int64_t y1, int64_t x0, int64_t x1, float *ssim, float *cs, float *saved, int32_t *failed) {
  int64_t bw = x1 - x0, bh = y1 - y0, n = round_up(bw), line = n + 2 * LANES;
  void *block;
  float *tmp = scratch(3, n, line, &block);
  if (!tmp) {
    *failed = 1;
    return;
  }
  float *a = tmp + 3 * (size_t)HALO * n, *b = a + line;
  for (;;) {
    int64_t s0 = y0 + STRIP * take_work(next);
    if (s0 >= y1) break;
    int64_t count = s0 + STRIP > y1 ? y1 - s0 : STRIP;
    for (int c = 0; c < 3; c++) {
      float *mean = tmp, *square = mean + (size_t)HALO * n, *product = square + (size_t)HALO * n;
      memset(tmp, 0, sizeof(float) * 3 * HALO * n);
      for (int64_t r = clamp(s0 - R, 0, height); r < clamp(s0 + count + R, 0, height); r++) {
        int64_t at = (r - s0 + R) * n;
        load_line(x + c * x_channel + r * x_row, width, x0 - R, bw + 2 * R, line, a);
        load_line(y + c * y_channel + r * y_row, width, x0 - R, bw + 2 * R, line, b);
        blur_products(a, b, n, mean + at, square + at, product + at);
      }
      blur_columns(mean, count, n);
      blur_columns(square, count, n);
      blur_columns(product, count, n);
      for (int64_t r = 0; r < count; r++) {
        int64_t box_row = s0 - y0 + r, box_plane = 3 * bh * bw;
        const float *restrict m = mean + r * n, *restrict q = square + r * n;
        const float *restrict p = product + r * n;
        const float *restrict my = target + c * target_channel + box_row * target_row;
        const float *restrict vy = my + target_plane;
        float *restrict om = saved + (c * bh + box_row) * bw;
        float *restrict ov = om + box_plane, *restrict oc = ov + box_plane;
        float *restrict os = ssim + (s0 + r) * width + x0, *restrict ok = cs + (s0 + r) * width + x0;
        const float keep = c ? 1.0f : 0.0f;
        for (int64_t i = 0; i < bw; i++) {
          float mx = m[i], vx = q[i] - mx * mx, cov = p[i] - mx * my[i];
          float light = (2 * mx * my[i] + C1) / (mx * mx + my[i] * my[i] + C1);
          float structure = (2 * cov + C2) / (vx + vy[i] + C2);
          om[i] = mx, ov[i] = vx, oc[i] = cov;
          os[i] = keep * os[i] + light * structure * (1.0f / 3);
          ok[i] = keep * ok[i] + structure * (1.0f / 3);
        }
      }
    }
  }
  free(block);
}

/* One row of dL/d(blurred x), dL/d(blurred x^2), dL/d(blurred x*y) inside the box, zero outside it. */
static void moment_gradients(const float *restrict mx_, const float *restrict vx_, const float *restrict cov_,
                             const float *restrict my_, const float *restrict vy_, const float *restrict g_ssim,
                             const float *restrict g_cs, int64_t bw, float *restrict gm, float *restrict gs,
                             float *restrict gp) {
  for (int64_t i = 0; i < bw; i++) {
    float mx = mx_[i], my = my_[i], below = 1.0f / (mx * mx + my * my + C1), spread = 1.0f / (vx_[i] + vy_[i] + C2);
    float light = (2 * mx * my + C1) * below, structure = (2 * cov_[i] + C2) * spread;
    float g_structure = (g_ssim[i] * light + g_cs[i]) * (1.0f / 3), g_light = g_ssim[i] * structure * (1.0f / 3);
    float s = -g_structure * structure * spread, p = 2 * g_structure * spread;
    gs[i] = s;
    gp[i] = p;
    gm[i] = 2 * g_light * (my - mx * light) * below - 2 * mx * s - my * p;
  }
}

/* dL/dx for dL/dssim and dL/dcs [height][width]; writes grad [3][height][width] inside the box grown by the radius. */
MGF_API void ssim_backward_work(int32_t *next, const float *x, int64_t x_channel, int64_t x_row, const float *y,
                           int64_t y_channel, int64_t y_row, const float *target, int64_t target_plane,
                           int64_t target_channel, int64_t target_row, int64_t height, int64_t width, int64_t y0,
                           int64_t y1, int64_t x0, int64_t x1, const float *saved, const float *g_ssim,
                           const float *g_cs, float *grad, int32_t *failed) {
  int64_t bw = x1 - x0, bh = y1 - y0;
  int64_t first = clamp(x0 - R, 0, width), last = clamp(x1 + R, 0, width), top = clamp(y0 - R, 0, height);
  int64_t bottom = clamp(y1 + R, 0, height), gw = last - first, n = round_up(gw), line = n + 2 * LANES;
  int64_t shift = x0 - first + R; /* where the box starts in a padded line */
  void *block;
  float *tmp = scratch(3, n, line, &block);
  if (!tmp) {
    *failed = 1;
    return;
  }
  float *lines = tmp + 3 * (size_t)HALO * n;
  memset(lines, 0, sizeof(float) * 3 * (size_t)line);
  for (;;) {
    int64_t s0 = top + STRIP * take_work(next);
    if (s0 >= bottom) break;
    int64_t count = s0 + STRIP > bottom ? bottom - s0 : STRIP;
    for (int c = 0; c < 3; c++) {
      memset(tmp, 0, sizeof(float) * 3 * HALO * n);
      for (int64_t r = clamp(s0 - R, y0, y1); r < clamp(s0 + count + R, y0, y1); r++) {
        const float *m = saved + (c * bh + r - y0) * bw, *t = target + c * target_channel + (r - y0) * target_row;
        int64_t plane = 3 * bh * bw, at = r * width + x0;
        moment_gradients(m, m + plane, m + 2 * plane, t, t + target_plane, g_ssim + at, g_cs + at, bw, lines + shift,
                         lines + line + shift, lines + 2 * line + shift);
        for (int k = 0; k < 3; k++)
          blur_line(lines + k * line, n, tmp + (k * HALO + r - s0 + R) * n);
      }
      for (int k = 0; k < 3; k++) blur_columns(tmp + k * HALO * n, count, n);
      for (int64_t r = 0; r < count; r++) {
        const float *restrict gm = tmp + r * n, *restrict gs = gm + HALO * n;
        const float *restrict gp = gs + HALO * n;
        const float *restrict xr = x + c * x_channel + (s0 + r) * x_row + first;
        const float *restrict yr = y + c * y_channel + (s0 + r) * y_row + first;
        float *restrict o = grad + (c * height + s0 + r) * width + first;
        for (int64_t i = 0; i < gw; i++) o[i] = gm[i] + 2 * xr[i] * gs[i] + yr[i] * gp[i];
      }
    }
  }
  free(block);
}
