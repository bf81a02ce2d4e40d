// SPDX-License-Identifier: GPL-3.0-or-later
// Between rows in memory, one Gaussian after the other, and columns in vectors, one number of sixteen Gaussians each.
// Whole vectors of a row are read and written and turned in registers: number by number it would take three times as
// long.
#pragma once
#include "common/vector.h"

// Lane i of a[j] goes to lane j of a[i].
static inline void transpose16(v16 *a) {
    v16 b[16];
    for (int i = 0; i < 16; i += 4) {  // 4 x 4 numbers in each quarter of four vectors
        const v16 p = __builtin_shufflevector(a[i], a[i + 1], LOW_PAIRS);
        const v16 q = __builtin_shufflevector(a[i], a[i + 1], HIGH_PAIRS);
        const v16 r = __builtin_shufflevector(a[i + 2], a[i + 3], LOW_PAIRS);
        const v16 s = __builtin_shufflevector(a[i + 2], a[i + 3], HIGH_PAIRS);
        b[i] = __builtin_shufflevector(p, r, LOW_QUADS);
        b[i + 1] = __builtin_shufflevector(p, r, HIGH_QUADS);
        b[i + 2] = __builtin_shufflevector(q, s, LOW_QUADS);
        b[i + 3] = __builtin_shufflevector(q, s, HIGH_QUADS);
    }
    for (int j = 0; j < 4; j++) {  // 4 x 4 quarters
        const v16 low01 = __builtin_shufflevector(b[j], b[4 + j], LOW_HALVES);
        const v16 low23 = __builtin_shufflevector(b[8 + j], b[12 + j], LOW_HALVES);
        const v16 high01 = __builtin_shufflevector(b[j], b[4 + j], HIGH_HALVES);
        const v16 high23 = __builtin_shufflevector(b[8 + j], b[12 + j], HIGH_HALVES);
        a[j] = __builtin_shufflevector(low01, low23, EVEN_QUARTERS);
        a[4 + j] = __builtin_shufflevector(low01, low23, ODD_QUARTERS);
        a[8 + j] = __builtin_shufflevector(high01, high23, EVEN_QUARTERS);
        a[12 + j] = __builtin_shufflevector(high01, high23, ODD_QUARTERS);
    }
}

// columns[c] lane l = rows[first + l][c] for c < 16 * parts, rows of `stride` floats; rows beyond n repeat the last
// one.
static inline void load_columns(v16 *columns, int parts, const float *rows, int64_t stride, int64_t first, int64_t n) {
    for (int l = 0; l < 16; l++) {
        const float *row = rows + (first + l < n ? first + l : n - 1) * stride;
        for (int part = 0; part < parts; part++) columns[16 * part + l] = load16(row + 16 * part);
    }
    for (int part = 0; part < parts; part++) transpose16(columns + 16 * part);
}

// rows[first + l][c] = columns[c] lane l for l < lanes and c < 16 * parts; the columns are lost.
static inline void store_columns(float *rows, int64_t stride, v16 *columns, int parts, int64_t first, int lanes) {
    for (int part = 0; part < parts; part++) {
        transpose16(columns + 16 * part);
        for (int l = 0; l < lanes; l++) store16(rows + (first + l) * stride + 16 * part, columns[16 * part + l]);
    }
}

// Asks memory for the first `floats` of the rows that come sixteen after `first`.
static inline void fetch_rows(const float *rows, int64_t stride, int floats, int64_t first, int64_t n) {
    enum { LINE = 16 };  // floats that come at a time
    for (int64_t row = first + 16; row < first + 32 && row < n; row++)
        for (int at = 0; at < floats; at += LINE) __builtin_prefetch(rows + row * stride + at);
}
