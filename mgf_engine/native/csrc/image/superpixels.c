// SPDX-License-Identifier: GPL-3.0-or-later
// Superpixels: k-means of colour and place, each centre asked about its surroundings alone (SLIC; Achanta et al. 2012).
//
// The answer is to the bit that of OpenCV's SLIC, which looks every pixel up anew for every centre and takes ten times
// as long. Hence products are not fused with sums here: OpenCV rounds them one by one.
#include <float.h>
#include <stdlib.h>
#include <string.h>
#include "common/export.h"
#include "common/vector.h"

enum { CHANNELS = 3, MARGIN = 2 * VECTOR };  // pixels more at the end of each row, so that whole vectors can be read

typedef struct {
    int64_t height, width, stride;
    float *channel[CHANNELS], *distance;  // [height][stride]; squared distance to the nearest centre so far
    int32_t *label;                       // [height][stride]
} Picture;

typedef struct {
    float color[CHANNELS], x, y;
} Centre;

static inline float pixel(const Picture *p, int c, int64_t y, int64_t x) { return p->channel[c][y * p->stride + x]; }

// Squared gradient of all channels; the picture is mirrored at its frame, so there is none across it.
static float edge(const Picture *p, int64_t y, int64_t x) {
    float sum = 0;
    for (int c = 0; c < CHANNELS; c++) {
        const int inner_x = x > 0 && x + 1 < p->width, inner_y = y > 0 && y + 1 < p->height;
        const float across = inner_x ? pixel(p, c, y, x + 1) - pixel(p, c, y, x - 1) : 0;
        const float along = inner_y ? pixel(p, c, y + 1, x) - pixel(p, c, y - 1, x) : 0;
        sum += across * across + along * along;  // whole numbers, exact
    }
    return sum;
}

static void put(const Picture *p, int64_t y, int64_t x, Centre *centre) {
    for (int c = 0; c < CHANNELS; c++) centre->color[c] = pixel(p, c, y, x);
    centre->x = x, centre->y = y;
}

// Centres on a grid, moved off edges to a diagonal neighbour; those for which there is no place are left at 0.
static void place_centres(const Picture *p, int64_t side, int64_t columns, int64_t rows, Centre *centres) {
    const int64_t wider = (p->width - side * columns) / columns, higher = (p->height - side * rows) / rows;
    Centre *centre = centres;
    for (int64_t j = 0; j < rows; j++)
        for (int64_t i = 0; i < columns; i++) {
            const int64_t y = j * (side + higher) + side / 2, x = i * (side + wider) + side / 2;
            if (y < p->height && x < p->width) put(p, y, x, centre++);
        }
    static const int around[8][2] = {{-1, 0}, {-1, -1}, {0, -1}, {1, -1}, {1, 0}, {1, 1}, {0, 1}, {-1, 1}};
    for (centre = centres; centre < centres + rows * columns; centre++) {
        const int64_t x = centre->x, y = centre->y;
        int64_t best_x = x, best_y = y;
        float least = edge(p, y, x);
        for (int k = 0; k < 8; k++) {
            const int64_t i = x + around[k][0], j = y + around[k][1];
            if (i < 0 || j < 0 || i >= p->width || j >= p->height) continue;
            const float here = edge(p, j, i);
            if (here < least) least = here, best_x = i, best_y = j;
        }
        if (best_x != x && best_y != y) put(p, best_y, best_x, centre);
    }
}

// What a vector holds, come from memory: a product before is not fused with a sum after.
static inline v16 settled(v16 value) {
    float held[VECTOR] __attribute__((aligned(64)));
    *(v16 *)held = value;
    __asm__ volatile("" : : "r"(held) : "memory");
    return *(v16 *)held;
}

// Gives the pixels around a centre to it that are nearer to it than to all before.
static void grow(const Picture *p, const Centre *centre, int32_t number, int64_t side, float scale) {
    const int64_t top = centre->y - side > 0 ? (int64_t)centre->y - side : 0;
    const int64_t left = centre->x - side > 0 ? (int64_t)centre->x - side : 0;
    const int64_t bottom = (int64_t)centre->y + side < p->height ? (int64_t)centre->y + side : p->height;
    const int64_t right = (int64_t)centre->x + side < p->width ? (int64_t)centre->x + side : p->width;
    static const float count[VECTOR] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};
    for (int64_t x = left; x < right; x += VECTOR) {
        const v16 place = load16(count) + (float)x;
        const v16 dx = place - centre->x, across = settled(dx * dx);
        const i16 inside = place < (float)right;
        for (int64_t y = top; y < bottom; y++) {
            const int64_t at = y * p->stride + x;
            const v16 dy = splat((float)y - centre->y), apart = (across + settled(dy * dy)) / scale;
            v16 sum = splat(0.0f);
            for (int c = 0; c < CHANNELS; c++) {
                const v16 d = load16(p->channel[c] + at) - centre->color[c];
                sum += settled(d * d);
            }
            sum += apart;
            const v16 least = load16(p->distance + at);
            const i16 nearer = inside & (sum < least);
            store16(p->distance + at, choose(nearer, sum, least));
            float *label = (float *)(p->label + at);
            store16(label, choose(nearer, (v16)((i16){0} + number), load16(label)));
        }
    }
}

// Each centre to the middle of its pixels.
static void move_centres(const Picture *p, int64_t number, Centre *centres, int32_t *sizes) {
    memset(centres, 0, (size_t)number * sizeof *centres);
    memset(sizes, 0, (size_t)number * sizeof *sizes);
    for (int64_t y = 0; y < p->height; y++)
        for (int64_t x = 0; x < p->width; x++) {
            const int64_t at = y * p->stride + x;
            Centre *centre = centres + p->label[at];
            for (int c = 0; c < CHANNELS; c++) centre->color[c] += p->channel[c][at];
            centre->x += x, centre->y += y, sizes[p->label[at]]++;
        }
    for (int64_t n = 0; n < number; n++) {
        const float size = sizes[n] ? sizes[n] : 1;
        for (int c = 0; c < CHANNELS; c++) centres[n].color[c] /= size;
        centres[n].x /= size, centres[n].y /= size;
    }
}

// Numbers the connected pieces of equal labels anew, from 0 in reading order; pieces of up to `smallest` pixels join
// one beside them. Returns how many there are. queue: room for all pixels.
static int64_t connect(const Picture *p, int64_t smallest, int32_t *queue, int32_t *result) {
    static const int across[4] = {-1, 0, 1, 0}, along[4] = {0, -1, 0, 1};
    int32_t next = 0, beside = 0;
    for (int64_t i = 0; i < p->height * p->width; i++) result[i] = -1;
    for (int64_t start = 0; start < p->height * p->width; start++) {
        if (result[start] >= 0) continue;
        const int32_t label = p->label[start / p->width * p->stride + start % p->width];
        int64_t count = 0;
        queue[count++] = (int32_t)start, result[start] = next;
        for (int64_t done = 0; done < count; done++) {
            const int64_t x = queue[done] % p->width, y = queue[done] / p->width;
            for (int k = 0; k < 4; k++) {
                const int64_t i = x + across[k], j = y + along[k], to = j * p->width + i;
                if (i < 0 || j < 0 || i >= p->width || j >= p->height) continue;
                if (done == 0 && result[to] >= 0 && result[to] != next) beside = result[to];
                if (result[to] >= 0 || p->label[j * p->stride + i] != label) continue;
                queue[count++] = (int32_t)to, result[to] = next;
            }
        }
        if (count > smallest) next++;
        else for (int64_t k = 0; k < count; k++) result[queue[k]] = beside;
    }
    return next;
}

/* Cuts a picture, uint8 [height][width][3], into superpixels of about side x side pixels; at least 2 x 2 pixels.

   compactness: colour distance that counts as much as `side` pixels; smallest: percent of the usual size below which a
   piece joins another. labels [height][width], from 0. Returns 0, or 1 without memory. */
MGF_API int64_t mgf_superpixels(int64_t height, int64_t width, const uint8_t *picture, int64_t side, float compactness,
                                int64_t rounds, int64_t smallest, int32_t *labels) {
    const int64_t stride = width + MARGIN, size = height * stride;
    const int64_t columns = (2 * width + side) / (2 * side), rows = (2 * height + side) / (2 * side);
    const int64_t number = rows * columns;
    float *floats = calloc((size_t)((CHANNELS + 1) * size), sizeof *floats);
    int32_t *label = calloc((size_t)size, sizeof *label);
    int32_t *queue = malloc((size_t)(height * width + number) * sizeof *queue);
    Centre *centres = calloc((size_t)number, sizeof *centres);
    const int failed = !floats || !label || !queue || !centres;
    if (!failed) {
        const Picture p = {height, width, stride, {floats, floats + size, floats + 2 * size}, floats + 3 * size, label};
        for (int64_t y = 0; y < height; y++)
            for (int64_t x = 0; x < width; x++)
                for (int c = 0; c < CHANNELS; c++)
                    p.channel[c][y * stride + x] = picture[(y * width + x) * CHANNELS + c];
        place_centres(&p, side, columns, rows, centres);
        const float step = (float)side / compactness;
        for (int64_t round = 0; round < rounds; round++) {
            for (int64_t i = 0; i < size; i++) p.distance[i] = FLT_MAX;
            for (int64_t n = 0; n < number; n++) grow(&p, centres + n, (int32_t)n, side, step * step);
            move_centres(&p, number, centres, queue);
        }
        const int64_t least = height * width / number / (int64_t)(100.0f / (float)smallest + 0.5f);
        connect(&p, least > 3 ? least : 3, queue, labels);
    }
    free(floats), free(label), free(queue), free(centres);
    return failed;
}
