// SPDX-License-Identifier: GPL-3.0-or-later
// The 11x11 Gaussian window of structural similarity: blurring lines and columns of padded float rows.
#pragma once
#include <stdint.h>
#include <string.h>

#define R 5 /* radius of the window */
#define LANES 16
#define C1 1e-4f
#define C2 9e-4f

typedef float vec __attribute__((vector_size(64), aligned(64)));
typedef float loose __attribute__((vector_size(64), aligned(4)));

/* Whole 64-byte vectors where there are such registers (the compiler's default for them is half vectors), and loops
   over the window written out, so that its weights are constants. */
#if defined(__AVX512F__)
#define WIDE __attribute__((min_vector_width(512)))
#else
#define WIDE
#endif
#define UNROLL _Pragma("clang loop unroll(full)")

// exp(-d^2 / (2 * 1.5^2)), normalised to sum 1
static const float W[2 * R + 1] = {0.00102838f, 0.00759876f, 0.03600077f, 0.10936069f, 0.21300553f, 0.26601172f,
                                   0.21300553f, 0.10936069f, 0.03600077f, 0.00759876f, 0.00102838f};

static inline int64_t clamp(int64_t v, int64_t low, int64_t high) { return v < low ? low : (v > high ? high : v); }

/* Copy columns first..first+count of an image row into line[0..], zeros where the image ends. */
static inline void load_line(const float *row, int64_t width, int64_t first, int64_t count, int64_t padded,
                             float *line) {
    int64_t a = clamp(-first, 0, count), b = clamp(width - first, a, count);
    memset(line, 0, sizeof(float) * a);
    memcpy(line + a, row + first + a, sizeof(float) * (b - a));
    memset(line + b, 0, sizeof(float) * (padded - b));
}

/* Horizontal blur of one line: out[i] = sum_j W[j] line[i + j]. */
WIDE static inline void blur_line(const float *line, int64_t n, float *out) {
    for (int64_t i = 0; i < n; i += LANES) {
        vec sum = {0};
        UNROLL for (int j = 0; j <= 2 * R; j++) sum += W[j] * *(const loose *)(line + i + j);
        *(vec *)(out + i) = sum;
    }
}

/* Vertical blur in place: row r of the result is sum_j W[j] rows[r + j]; four rows at a time share their loads. */
WIDE static inline void blur_columns(float *rows, int64_t count, int64_t n) {
    for (int64_t i = 0; i < n; i += LANES)
        for (int64_t r = 0; r < count; r += 4) {
            vec sum[4] = {{0}, {0}, {0}, {0}};
            UNROLL for (int j = 0; j < 2 * R + 4; j++) {
                vec v = *(const vec *)(rows + (r + j) * n + i);
                UNROLL for (int k = 0; k < 4; k++)
                    if (j - k >= 0 && j - k <= 2 * R) sum[k] += W[j - k] * v;
            }
            UNROLL for (int k = 0; k < 4; k++) *(vec *)(rows + (r + k) * n + i) = sum[k];
        }
}
