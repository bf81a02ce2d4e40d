// SPDX-License-Identifier: GPL-3.0-or-later
// What the kernels of the training loss (loss.c, loss_backward.c) share: tiles, levels of the pyramid, line helpers.
//
// The box of a target is cut into tiles of 32 x 256 pixels, and so is every coarser level of it. Images of a level lie
// in one scratch array: color (render over the backdrop, the photo outside the mask) and photo [3][h][w], saved
// [3][h][4][w] (means of both, contrast-structure, 1 / spread), gradient [3][h][w] (levels > 0 only).
// The label of a coarse pixel is the label of the top left one of the pixels it stands for.
#pragma once
#include <stdlib.h>

#include "common/export.h"
#include "raster/window.h"

#define TILE_H 32
#define TILE_W 256
#define HALO (TILE_H + 2 * R)
#define LINE (TILE_W + 2 * LANES) /* a line of a tile with its halo and room for whole vectors */
#define MAX_LEVELS 5

enum { MEAN_X, MEAN_Y, STRUCTURE, SPREAD, SAVED }; /* planes of `saved` */

/* Bits of a tile's flags: it holds a label; a pixel under it has a label; it holds a pixel of the background band
   (level 0). */
enum { HAS_LABEL = 1, COVERS_LABEL = 2, HAS_BAND = 4 };

/* As packed by raster/loss.py: sizes, number of the level's first tile, offsets into the scratch array in floats. */
typedef struct {
    int64_t height, width, tiles_y, tiles_x, first_tile, color, photo, saved, grad;
} Level;

typedef struct {
    int64_t level, y0, x0, height, width; /* of the pixels in it */
} Tile;

static inline int64_t smaller(int64_t a, int64_t b) { return a < b ? a : b; }
static inline int64_t tile_count(const Level *levels, int64_t count) {
    const Level *last = levels + count - 1;
    return last->first_tile + last->tiles_y * last->tiles_x;
}

static inline Tile tile_at(const Level *levels, int64_t count, int64_t index) {
    int64_t s = count - 1;
    while (index < levels[s].first_tile) s--;
    const Level *l = levels + s;
    int64_t i = index - l->first_tile, y0 = i / l->tiles_x * TILE_H, x0 = i % l->tiles_x * TILE_W;
    return (Tile){s, y0, x0, smaller(TILE_H, l->height - y0), smaller(TILE_W, l->width - x0)};
}

/* Columns first..first+TILE_W+2R of a row: in place where they are all there, else copied to `spare` with zeros. */
static inline const float *line_at(const float *row, int64_t width, int64_t first, float *spare) {
    if (first >= 0 && first + TILE_W + 2 * R <= width) return row + first;
    load_line(row, width, first, TILE_W + 2 * R, LINE, spare);
    return spare;
}

/* Sum of n floats in a fixed order. */
static inline double sum_line(const float *v, int64_t n) {
    vec part = {0};
    double total = 0;
    int64_t i = 0;
    for (; i + LANES <= n; i += LANES) part += *(const loose *)(v + i);
    for (; i < n; i++) total += v[i];
    for (int k = 0; k < LANES; k++) total += part[k];
    return total;
}

/* Memory for a worker, aligned for vec; *block is what free() takes. */
static inline float *worker_scratch(int64_t floats, void **block) {
    *block = malloc(sizeof(float) * (size_t)floats + 64);
    return *block ? (float *)(((uintptr_t)*block + 63) & ~(uintptr_t)63) : 0;
}
