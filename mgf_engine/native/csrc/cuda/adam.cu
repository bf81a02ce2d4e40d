// SPDX-License-Identifier: GPL-3.0-or-later
// One step of Adam in one pass over memory, for the rows of a parameter that were seen; the formula is at the top of
// the C kernels' adam.c. A thread a number; rates come by value, so that no step has to upload any.
#include "cuda/block.cuh"

#include <stdint.h>

enum { MAX_WIDTH = 48 };

struct Rates {
    float of[MAX_WIDTH];  // per column
};

struct Moments {
    float beta1, beta2, eps, inv_bias1, inv_bias2;
};

// parameter, gradient, first and second moment [rows, width]; visible [rows] or null (all rows); only the first
// `active` columns are touched. grid: numbers.
KERNEL(adam, int rows, int width, int active, float *parameter, const float *gradient, float *first, float *second,
       const uint8_t *visible, BY_VALUE Rates rates, BY_VALUE Moments s) {
    EACH(i, rows * width) {
        const int row = i / width, column = i % width;
        if (column >= active || (visible && !visible[row])) continue;
        const float g = gradient[i], m = s.beta1 * first[i] + (1.0f - s.beta1) * g,
                    v = s.beta2 * second[i] + (1.0f - s.beta2) * g * g;
        first[i] = m, second[i] = v;
        parameter[i] -= rates.of[column] * (m * s.inv_bias1 / (sqrtf(v * s.inv_bias2) + s.eps));
    }
}
