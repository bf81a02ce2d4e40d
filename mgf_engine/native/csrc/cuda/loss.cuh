// SPDX-License-Identifier: GPL-3.0-or-later
// What the kernels of the training loss (loss.cu, loss_backward.cu) share. The formulas are those of the C kernels
// (loss.h, loss.c, loss_backward.c); the box of a target and every coarser level of it are cut into tiles of 16 x 16
// pixels, a thread a pixel.
//
// Sums over pixels go into whole numbers of 64 bits, in units of 2^-32 (SUM_L1: 2^-44). Whole numbers can be added in
// any order: the blocks need not wait for each other and the result is still the same bits every time.
#pragma once
#include "cuda/block.cuh"

#include <stdint.h>

enum { SIDE = 16, RADIUS = 5, WINDOW = 2 * RADIUS + 1, HALO = SIDE + 2 * RADIUS, MAX_LEVELS = 5, MAX_IDS = 256 };

#define C1 1e-4f
#define C2 9e-4f
#define FIXED 4294967296.0f       // 2^32
#define FIXED_L1 17592186044416.0f  // 2^44: every addend is divided by the number of pixels
#define FLOOR 0.01                // as FLOOR in raster/loss.py

// exp(-d^2 / (2 * 1.5^2)), normalised to sum 1
TABLE const float WEIGHTS[WINDOW] = {0.00102838f, 0.00759876f, 0.03600077f, 0.10936069f, 0.21300553f, 0.26601172f,
                                     0.21300553f, 0.10936069f, 0.03600077f, 0.00759876f, 0.00102838f};

// One level of the pyramid: size, tiles, and where its images begin in the scratch array. color (render over the
// backdrop, the photo outside the mask), photo and grad (dL/dcolor, levels > 0 only): [3][h][w]; saved:
// [3][SAVED][h][w].
struct Level {
    int height, width, tiles_x, first_tile;
    long long color, photo, saved, grad;
};

enum { MEAN_X, MEAN_Y, STRUCTURE, SPREAD, SAVED };

struct Levels {
    int count, tiles;  // levels; tiles of all of them
    Level of[MAX_LEVELS];
};

// The maps of a target's box, [h][w] of level 0; background_band: certain background beside the building.
struct Labels {
    const uint8_t *labels, *edges, *background_band;
};

// The sums, after 2 * ids per level (similarity and contrast-structure of each label).
enum { SUM_EDGES, SUM_L1, SUM_IN_BAND, SUM_DISTORTION, SUM_NORMALS, SUM_NORMAL_WEIGHTS, OTHER_SUMS };

struct TileAt {
    int level, y0, x0;
};

static inline TileAt tile_at(const Levels &levels, int index) {
    int s = levels.count - 1;
    while (index < levels.of[s].first_tile) s--;
    const int i = index - levels.of[s].first_tile;
    return {s, i / levels.of[s].tiles_x * SIDE, i % levels.of[s].tiles_x * SIDE};
}

// Pixel of the running thread in its tile.
static inline int own_x() { return THREAD % SIDE; }
static inline int own_y() { return THREAD / SIDE; }

// Label of a pixel of a level: that of the top left one of the pixels it stands for.
static inline int label_at(const Levels &levels, const uint8_t *labels, int level, int y, int x) {
    return labels[((int64_t)y << level) * levels.of[0].width + ((int64_t)x << level)];
}

static inline bool inside_level(const Level &l, int y, int x) {
    return y >= 0 && x >= 0 && y < l.height && x < l.width;
}

static inline long long fixed(float x, float unit) { return llrintf(x * unit); }

// Adds a number of each thread to a sum in shared memory; inside EACH_WARP, between LANES.
static inline void add_lanes(Own<float> &value, float unit, long long *sum) {
    sum_lanes(value);
    LANES {
        if (THIS_LANE == 0 && *value != 0.0f) add_atomic(sum, fixed(*value, unit));
    }
}

// Horizontal blur of a staged tile with its halo: rows of SIDE from rows of HALO. Called by all threads in a phase.
static inline void blur_rows(const float (*from)[HALO], float (*to)[SIDE]) {
    for (int i = THREAD; i < HALO * SIDE; i += BLOCK) {
        float sum = 0.0f;
        for (int j = 0; j < WINDOW; j++) sum += WEIGHTS[j] * from[i / SIDE][i % SIDE + j];
        to[i / SIDE][i % SIDE] = sum;
    }
}

// Vertical blur at the thread's own pixel.
static inline float blur_column(const float (*rows)[SIDE]) {
    float sum = 0.0f;
    for (int j = 0; j < WINDOW; j++) sum += WEIGHTS[j] * rows[own_y() + j][own_x()];
    return sum;
}
