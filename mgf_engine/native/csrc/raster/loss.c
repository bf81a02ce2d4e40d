// SPDX-License-Identifier: GPL-3.0-or-later
// Forward half of the training loss (eq. 16-19): compose the render over the backdrop, pyramids of render and photo,
// similarity maps of every level pooled per label. The other half is loss_backward.c, the terms are put together in
// raster/loss.py. Every tile has its own place for its sums, so results do not depend on which thread took it.
#include <stdlib.h>
#include <string.h>

#include "raster/loss.h"

/* One row of one channel: the render over the backdrop where there is a label, else the photo. */
static void compose_row(const float *restrict color, const float *restrict alpha, const uint8_t *restrict photo,
                        const uint8_t *restrict labels, float backdrop, int64_t n, float *restrict x,
                        float *restrict y) {
    for (int64_t i = 0; i < n; i++) {
        float p = photo[i] * (1.0f / 255), c = color[i] + (1.0f - alpha[i]) * backdrop;
        x[i] = labels[i] ? c : p;
        y[i] = p;
    }
}

/* The part of a level under a tile of level 0, from the level before. */
static void halve(const float *fine, const Level *from, float *coarse, const Level *to, int64_t y0, int64_t y1,
                  int64_t x0, int64_t x1) {
    for (int64_t y = y0; y < y1; y++) {
        const float *restrict a = fine + 2 * y * from->width, *restrict b = a + from->width;
        float *restrict o = coarse + y * to->width;
        for (int64_t x = x0; x < x1; x++) o[x] = 0.25f * ((a[2 * x] + a[2 * x + 1]) + (b[2 * x] + b[2 * x + 1]));
    }
}

/* Colour and photo of all levels. color [3] planes and alpha: rows `row` floats apart, first pixel of the box; photo
   uint8 [3][h][w] and labels uint8 [h][w] of the box; backdrop: three floats. */
MGF_API void mgf_loss_prepare(int32_t *next, const Level *levels, int64_t count, const float *color, int64_t plane,
                              int64_t row, const float *alpha, int64_t alpha_row, const uint8_t *photo,
                              const uint8_t *labels, const float *backdrop, float *scratch) {
    const int64_t h = levels->height, w = levels->width, tiles = levels->tiles_y * levels->tiles_x;
    for (int64_t index; (index = take_work(next)) < tiles;) {
        const Tile t = tile_at(levels, 1, index);
        for (int c = 0; c < 3; c++) {
            for (int64_t y = t.y0; y < t.y0 + t.height; y++) {
                const int64_t at = y * w + t.x0, to = c * h * w + at;
                compose_row(color + c * plane + y * row + t.x0, alpha + y * alpha_row + t.x0, photo + to, labels + at,
                            backdrop[c], t.width, scratch + levels->color + to, scratch + levels->photo + to);
            }
            for (int s = 1; s < count; s++) {
                const Level *from = levels + s - 1, *to = levels + s;
                const int64_t n = c * from->height * from->width, m = c * to->height * to->width;
                const int64_t y0 = t.y0 >> s, y1 = smaller((t.y0 + TILE_H) >> s, to->height);
                const int64_t x0 = t.x0 >> s, x1 = smaller((t.x0 + TILE_W) >> s, to->width);
                halve(scratch + from->color + n, from, scratch + to->color + m, to, y0, y1, x0, x1);
                halve(scratch + from->photo + n, from, scratch + to->photo + m, to, y0, y1, x0, x1);
            }
        }
    }
}

/* Horizontal blur of a, b, a*a + b*b and a*b, a tile wide. */
WIDE static void blur_moments(const float *a, const float *b, float *rows) {
    for (int64_t i = 0; i < TILE_W; i += LANES) {
        vec ma = {0}, mb = {0}, squares = {0}, product = {0};
        UNROLL for (int j = 0; j <= 2 * R; j++) {
            vec x = *(const loose *)(a + i + j), y = *(const loose *)(b + i + j), wx = W[j] * x, wy = W[j] * y;
            ma += wx;
            mb += wy;
            squares += wx * x;
            squares += wy * y;
            product += wx * y;
        }
        *(vec *)(rows + i) = ma;
        *(vec *)(rows + HALO * TILE_W + i) = mb;
        *(vec *)(rows + 2 * HALO * TILE_W + i) = squares;
        *(vec *)(rows + 3 * HALO * TILE_W + i) = product;
    }
}

/* Similarities of one row from its blurred moments (four planes HALO * TILE_W apart), added to ssim and cs. */
static void similarity_row(const float *restrict moments, int64_t n, int64_t width, float *restrict saved,
                           float *restrict ssim, float *restrict cs) {
    const float *restrict ma = moments, *restrict mb = ma + HALO * TILE_W, *restrict squares = mb + HALO * TILE_W;
    const float *restrict product = squares + HALO * TILE_W;
    float *restrict sx = saved, *restrict sy = sx + width, *restrict st = sy + width, *restrict sp = st + width;
    for (int64_t i = 0; i < n; i++) {
        float x = ma[i], y = mb[i], cross = x * y, both = x * x + y * y;
        float spread = 1.0f / (squares[i] - both + C2), structure = (2 * (product[i] - cross) + C2) * spread;
        sx[i] = x, sy[i] = y, st[i] = structure, sp[i] = spread;
        ssim[i] += (2 * cross + C1) / (both + C1) * structure;
        cs[i] += structure;
    }
}

static void tile_similarity(const Level *l, const Tile *t, float *scratch, float *work, float *ssim, float *cs) {
    float *a = work + 4 * HALO * TILE_W, *b = a + LINE;
    memset(ssim, 0, sizeof(float) * TILE_H * TILE_W);
    memset(cs, 0, sizeof(float) * TILE_H * TILE_W);
    for (int c = 0; c < 3; c++) {
        for (int64_t r = 0; r < t->height + 2 * R; r++) {
            const int64_t y = t->y0 + r - R, at = (c * l->height + y) * l->width;
            float *rows = work + r * TILE_W;
            if (y < 0 || y >= l->height) {
                for (int k = 0; k < 4; k++) memset(rows + k * HALO * TILE_W, 0, sizeof(float) * TILE_W);
                continue;
            }
            blur_moments(line_at(scratch + l->color + at, l->width, t->x0 - R, a),
                         line_at(scratch + l->photo + at, l->width, t->x0 - R, b), rows);
        }
        for (int k = 0; k < 4; k++) blur_columns(work + k * HALO * TILE_W, t->height, TILE_W);
        for (int64_t r = 0; r < t->height; r++)
            similarity_row(work + r * TILE_W, t->width, l->width,
                           scratch + l->saved + (c * l->height + t->y0 + r) * SAVED * l->width + t->x0,
                           ssim + r * TILE_W, cs + r * TILE_W);
    }
}

/* Adds a row of both maps to the sums of its labels, run by run. */
static void pool_row(const uint8_t *labels, const float *ssim, const float *cs, int64_t n, int64_t ids, double *sums) {
    for (int64_t i = 0, end; i < n; i = end) {
        for (end = i + 1; end < n && labels[end] == labels[i];) end++;
        if (!labels[i]) continue;
        sums[labels[i]] += sum_line(ssim + i, end - i);
        sums[ids + labels[i]] += sum_line(cs + i, end - i);
    }
}

static double edge_sum(const float *restrict ssim, const uint8_t *restrict edges, const uint8_t *restrict labels,
                       int64_t n, float *restrict line) {
    for (int64_t i = 0; i < n; i++) line[i] = (edges[i] & (labels[i] > 0)) ? ssim[i] : 0.0f;
    return sum_line(line, n);
}

/* Similarities of all tiles with a label, pooled: sums [tiles][2 * ids + 1], given as zeros, of ssim and of cs per
   label and of ssim over labelled edges (level 0), each three times too large (channels are added up). labels, edges:
   uint8 [h][w]. */
MGF_API void mgf_loss_forward(int32_t *next, const Level *levels, int64_t count, const uint8_t *flags,
                              const uint8_t *labels, const uint8_t *edges, int64_t ids, float *scratch, double *sums,
                              int32_t *failed) {
    void *block;
    float *work = worker_scratch(4 * HALO * TILE_W + 2 * LINE + 2 * TILE_H * TILE_W, &block);
    if (!work) {
        *failed = 1;
        return;
    }
    float *line = work + 4 * HALO * TILE_W, *ssim = line + 2 * LINE, *cs = ssim + TILE_H * TILE_W;
    const int64_t tiles = tile_count(levels, count), w = levels->width;
    for (int64_t index; (index = take_work(next)) < tiles;) {
        if (!(flags[index] & HAS_LABEL)) continue;
        const Tile t = tile_at(levels, count, index);
        double *sum = sums + index * (2 * ids + 1);
        tile_similarity(levels + t.level, &t, scratch, work, ssim, cs);
        for (int64_t r = 0; r < t.height; r++) {
            uint8_t row[TILE_W];
            const int64_t at = ((t.y0 + r) * w + t.x0) << t.level;
            for (int64_t i = 0; i < t.width; i++) row[i] = labels[at + (i << t.level)];
            pool_row(row, ssim + r * TILE_W, cs + r * TILE_W, t.width, ids, sum);
            if (t.level == 0) sum[2 * ids] += edge_sum(ssim + r * TILE_W, edges + at, row, t.width, line);
        }
    }
    free(block);
}
