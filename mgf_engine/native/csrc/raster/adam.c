// SPDX-License-Identifier: GPL-3.0-or-later
// One step of Adam (Kingma & Ba, 2015) in one pass over memory, for the rows of a parameter that were seen:
//     m <- b1 m + (1 - b1) g,   v <- b2 v + (1 - b2) g^2,   p <- p - lr (m / bias1) / (sqrt(v / bias2) + eps).
// Rows that were not seen keep their moments: a Gaussian outside the frame does not drift.
#include "common/export.h"

enum { PIECE = 2048 };  // rows per piece of work

typedef struct {
    float *p;
    const float *g;
    float *m, *v;
    float beta1, beta2, eps, inv_bias1, inv_bias2;
} Adam;

// Elements first..first + count - 1, all with one rate (rates null) or with their column's.
static inline void update(const Adam *s, int64_t first, int64_t count, float rate, const float *rates) {
    float *restrict p = s->p + first, *restrict m = s->m + first, *restrict v = s->v + first;
    const float *restrict g = s->g + first;
    const float rest1 = 1.0f - s->beta1, rest2 = 1.0f - s->beta2;
    for (int64_t i = 0; i < count; i++) {
        m[i] = s->beta1 * m[i] + rest1 * g[i];
        v[i] = s->beta2 * v[i] + rest2 * g[i] * g[i];
        const float step = m[i] * s->inv_bias1 / (__builtin_sqrtf(v[i] * s->inv_bias2) + s->eps);
        p[i] -= (rates ? rates[i] : rate) * step;
    }
}

// parameter, gradient, moments [rows, width]; visible [rows] or null (all rows); rates [width] or null (`rate` for
// all); only the first `active` columns are touched.
MGF_API void mgf_adam(int32_t *next, int64_t rows, int64_t width, int64_t active, float *parameter,
                      const float *gradient, float *first_moment, float *second_moment, const uint8_t *visible,
                      float rate, const float *rates, float beta1, float beta2, float eps, float inv_bias1,
                      float inv_bias2) {
    const Adam s = {parameter, gradient, first_moment, second_moment, beta1, beta2, eps, inv_bias1, inv_bias2};
    for (;;) {
        const int64_t start = take_work(next) * PIECE, end = start + PIECE < rows ? start + PIECE : rows;
        if (start >= rows) return;
        for (int64_t row = start; row < end;) {
            if (visible && !visible[row]) {
                row++;
                continue;
            }
            int64_t stop = row + 1;  // rows that follow and were seen too are one stretch of memory
            if (active == width && !rates)
                while (stop < end && (!visible || visible[stop])) stop++;
            update(&s, row * width, stop - row == 1 ? active : (stop - row) * width, rate, rates);
            row = stop;
        }
    }
}
