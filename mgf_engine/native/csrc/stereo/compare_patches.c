// SPDX-License-Identifier: GPL-3.0-or-later
// How alike a picture and some others are around each pixel: normalised cross-correlation of patches of lightness, and
// distance of colours; for each pixel the mean over the best of the others. All of them are compared row by row, so
// that what has to be held of each is in the cache.
//
// Sums over a patch are of numbers with few digits, so doubles hold them exactly, in whatever order they are added: the
// result does not depend on how a picture is cut, and is that of OpenCV's blurs.
#include <math.h>
#include <stdlib.h>
#include "common/export.h"

enum { RADIUS = 2, SIDE = 2 * RADIUS + 1, CHANNELS = 3 };

typedef struct {
    int64_t height, width, channels;
    const uint8_t *other;        // the picture compared with, [height][width][channels]: lightness first, 0..255
    const float *lightness;  // of the own picture, 0..100, [height][width], with means and variances over the patches
    const float *average, *variance;
} Pair;

// One row of sums down the patches' columns: of the other lightness, its square, and its product with the own one; each
// has RADIUS more at both ends.
typedef struct {
    double *light, *square, *product;
} Sums;

// A place beside the picture, mirrored at the middle of its outermost pixels.
static int64_t mirrored(int64_t i, int64_t count) {
    while (i < 0 || i >= count) i = count == 1 ? 0 : i < 0 ? -i : 2 * (count - 1) - i;
    return i;
}

// One row of the other picture and of the own one comes into the sums down the columns, one goes out.
static inline void move_sums(int64_t width, int64_t channels, const uint8_t *restrict in, const uint8_t *restrict out,
                             const float *restrict own_in, const float *restrict own_out, double *restrict light,
                             double *restrict square, double *restrict product) {
    const float scale = (float)(100.0 / 255.0);
    for (int64_t x = 0; x < width; x++) {
        const float a = (float)in[x * channels] * scale, b = (float)out[x * channels] * scale;
        const float aa = a * a, bb = b * b, pa = own_in[x] * a, pb = own_out[x] * b;
        light[x] += (double)a - (double)b;
        square[x] += (double)aa - (double)bb;
        product[x] += (double)pa - (double)pb;
    }
}

// Takes the sums from row y - 1 to row y.
static void next_row(const Pair *p, int64_t y, const Sums *sums) {
    const int64_t to = mirrored(y + RADIUS, p->height) * p->width,
                  from = mirrored(y - RADIUS - 1, p->height) * p->width;
    const uint8_t *in = p->other + to * p->channels, *out = p->other + from * p->channels;
    double *light = sums->light + RADIUS, *square = sums->square + RADIUS, *product = sums->product + RADIUS;
    if (p->channels == 1)
        move_sums(p->width, 1, in, out, p->lightness + to, p->lightness + from, light, square, product);
    else
        move_sums(p->width, CHANNELS, in, out, p->lightness + to, p->lightness + from, light, square, product);
}

// The sums of the patches around the row before the first.
static void begin(const Pair *p, const Sums *sums) {
    const float scale = (float)(100.0 / 255.0);
    for (int64_t y = -RADIUS - 1; y < RADIUS; y++)
        for (int64_t x = 0, at = mirrored(y, p->height) * p->width; x < p->width; x++, at++) {
            const float light = (float)p->other[at * p->channels] * scale;
            const float square = light * light, product = p->lightness[at] * light;
            sums->light[x + RADIUS] += light, sums->square[x + RADIUS] += square, sums->product[x + RADIUS] += product;
        }
}

static void mirror_ends(double *sums, int64_t width) {
    for (int64_t k = 1; k <= RADIUS; k++) {
        sums[RADIUS - k] = sums[RADIUS + mirrored(-k, width)];
        sums[RADIUS + width - 1 + k] = sums[RADIUS + mirrored(width - 1 + k, width)];
    }
}

// Values of the pixels of a row that the other picture does not show.
static void fill_unseen(int64_t width, const int32_t *seen, float value, float *row) {
    for (int64_t x = 0; x < seen[0]; x++) row[x] = value;
    for (int64_t x = seen[1]; x < width; x++) row[x] = value;
}

static inline float mean_at(const double *sums, int64_t x) {
    double sum = 0;
    for (int k = 0; k < SIDE; k++) sum += sums[x + k];
    return (float)(sum * (1.0 / (SIDE * SIDE)));
}

// Correlation -1..1 of one row, 0 where either picture has no texture, -1 where the other shows nothing. Products come
// to lie in memory before they are subtracted: fused with that, they would be rounded otherwise than NumPy rounds them.
static void correlate_row(const Pair *p, int64_t y, const Sums *sums, const int32_t *seen, float texture,
                          float *restrict scratch, float *restrict result) {
    const float *average = p->average + y * p->width, *variance = p->variance + y * p->width, least = texture * texture;
    float *restrict products = scratch + p->width;
    for (int64_t x = seen[0]; x < seen[1]; x++) {
        const float mean = mean_at(sums->light, x);
        scratch[x] = mean * mean, products[x] = average[x] * mean;
    }
    for (int64_t x = seen[0]; x < seen[1]; x++) {
        const float spread = mean_at(sums->square, x) - scratch[x], shared = mean_at(sums->product, x) - products[x];
        const float both = variance[x] * spread, correlation = shared / sqrtf(both > least ? both : least);
        result[x] = variance[x] > texture && spread > texture ? correlation : 0.0f;
    }
    fill_unseen(p->width, seen, -1.0f, result);
}

// CIELAB distance of one row between the own colours, smoothed already, [3][height][width], and those of the other,
// smoothed here. `columns`: scratch memory for a row of each channel, with one pixel more at both ends.
static void colors_row(const Pair *p, int64_t y, const uint8_t *smooth, uint16_t *restrict columns,
                        float *restrict scratch, float *restrict result) {
    const int64_t width = p->width, wide = width + 2, pixels = p->height * width;
    const uint8_t *r[3];
    for (int k = 0; k < 3; k++) r[k] = p->other + mirrored(y + k - 1, p->height) * width * CHANNELS;
    for (int64_t x = 0; x < width; x++)
        for (int c = 0; c < CHANNELS; c++)
            columns[c * wide + x + 1] = (uint16_t)(r[0][x * 3 + c] + r[1][x * 3 + c] + r[2][x * 3 + c]);
    for (int c = 0; c < CHANNELS; c++) {
        uint16_t *row = columns + c * wide;
        row[0] = row[1 + mirrored(-1, width)], row[width + 1] = row[1 + mirrored(width, width)];
        for (int64_t x = 0; x < width; x++) row[x] = (uint16_t)((row[x] + row[x + 1] + row[x + 2] + 4) / 9);
    }
    const uint8_t *own = smooth + y * width;
    const uint16_t *a = columns + wide, *b = a + wide;
    const float scale = (float)(100.0 / 255.0);
    for (int64_t x = 0; x < width; x++) scratch[x] = (float)own[x] * scale, result[x] = (float)columns[x] * scale;
    for (int64_t x = 0; x < width; x++) result[x] -= scratch[x];
    for (int64_t x = 0; x < width; x++) scratch[x] = result[x] * result[x];
    for (int64_t x = 0; x < width; x++) {
        const int32_t green = own[pixels + x] - a[x], yellow = own[2 * pixels + x] - b[x];
        result[x] = sqrtf(scratch[x] + (float)(green * green) + (float)(yellow * yellow));
    }
}

// The best values of each pixel of a row, highest first, [count][width].
typedef struct {
    int64_t count, width;
    float *values;
} Best;

static void clear(const Best *best) {
    for (int64_t i = 0; i < best->count * best->width; i++) best->values[i] = -INFINITY;
}

// Puts one row in; it is used up.
static void rank(const Best *best, float *restrict row) {
    for (int64_t k = 0; k < best->count; k++) {
        float *restrict held = best->values + k * best->width;
        for (int64_t x = 0; x < best->width; x++) {
            const float value = row[x], other = held[x];
            held[x] = other < value ? value : other;
            row[x] = other < value ? other : value;
        }
    }
}

static void mean_of(const Best *best, float *restrict mean) {
    for (int64_t x = 0; x < best->width; x++) mean[x] = best->values[x];
    for (int64_t k = 1; k < best->count; k++)
        for (int64_t x = 0; x < best->width; x++) mean[x] += best->values[k * best->width + x];
    for (int64_t x = 0; x < best->width; x++) mean[x] /= (float)best->count;
}

// Scratch memory: the sums of every other picture, some rows of floats, and the columns of `colors_row`.
typedef struct {
    double *sums;
    float *floats;
    uint16_t *columns;
} Scratch;

static void compare_row(const Pair *p, int64_t y, const int32_t *seen, const uint8_t *smooth, float texture,
                        float color, const Scratch *scratch, double *held, const Best *fits, const Best *colors,
                        const Best *alone) {
    const int64_t wide = p->width + 2 * RADIUS;
    const Sums sums = {held, held + wide, held + 2 * wide};
    float *row = scratch->floats, *away = row + p->width, *limited = away + p->width, *between = limited + p->width;
    next_row(p, y, &sums);
    for (int k = 0; k < 3; k++) mirror_ends(held + k * wide, p->width);
    correlate_row(p, y, &sums, seen, texture, between, row);
    if (smooth) {
        colors_row(p, y, smooth, scratch->columns, between, away);
        for (int64_t x = 0; x < p->width; x++) {
            limited[x] = away[x] < color || row[x] < 0.0f ? row[x] : 0.0f;
            away[x] = -away[x];
        }
        fill_unseen(p->width, seen, -255.0f, away);
        rank(fits, limited), rank(colors, away);
    }
    if (alone) rank(alone, row);
}

/* Compares a picture with others: means over the best values, each [height][width].

   others: uint8 [number][height][width][channels], 1 or 3 (CIELAB); seen: [number][height][2], the first and one past
   the last pixel of each row that they show; lightness, average, variance: of the own picture, 0..100; smooth: its
   colours, means over 3 x 3 pixels, uint8 [3][height][width], null without colours. fits: of `count` correlations, at
   most 0 where the colours are `color` apart; colors: of `count` negative distances; both null without colours.
   alone: of `count_alone` correlations with the last `last` others whatever the colours are. Returns 1 without memory.
   */
MGF_API int64_t mgf_compare_patches(int64_t number, int64_t height, int64_t width, int64_t channels,
                                    const uint8_t *others, const int32_t *seen, const float *lightness,
                                    const float *average, const float *variance, const uint8_t *smooth, float texture,
                                    float color, int64_t count, float *fits, float *colors, int64_t last,
                                    int64_t count_alone, float *alone) {
    const int64_t wide = width + 2 * RADIUS, rows = 5 + 2 * count + count_alone;
    const Scratch scratch = {calloc((size_t)(number * 3 * wide), sizeof(double)),
                             malloc((size_t)(rows * width) * sizeof(float)),
                             malloc((size_t)(CHANNELS * (width + 2)) * sizeof(uint16_t))};
    const int failed = !scratch.sums || !scratch.floats || !scratch.columns;
    const Best best[3] = {{count, width, scratch.floats + 5 * width},
                          {count, width, scratch.floats + (5 + count) * width},
                          {count_alone, width, scratch.floats + (5 + 2 * count) * width}};
    for (int64_t y = 0; y < height && !failed; y++) {
        for (int k = 0; k < 3; k++) clear(best + k);
        for (int64_t n = 0; n < number; n++) {
            const Pair pair = {height,    width,   channels, others + n * height * width * channels,
                               lightness, average, variance};
            double *held = scratch.sums + n * 3 * wide;
            if (y == 0) begin(&pair, &(Sums){held, held + wide, held + 2 * wide});
            compare_row(&pair, y, seen + 2 * (n * height + y), smooth, texture, color, &scratch, held, best, best + 1,
                        n >= number - last ? best + 2 : NULL);
        }
        if (smooth) mean_of(best, fits + y * width), mean_of(best + 1, colors + y * width);
        if (alone) mean_of(best + 2, alone + y * width);
    }
    free(scratch.sums), free(scratch.floats), free(scratch.columns);
    return failed;
}
