// SPDX-License-Identifier: GPL-3.0-or-later
// Backward half of the training loss: gradients of the pooled similarities through windows and pyramid, and the terms
// of single pixels (L1, background, distortion), value and gradient. See loss.h and loss.c.
#include <stdlib.h>
#include <string.h>

#include "raster/loss.h"

/* dL/dssim and dL/dcs of single pixels, already divided by the three channels: tables by label, plus what a labelled
   edge adds to dL/dssim (level 0). */
typedef struct {
    const float *ssim, *cs;
    float edge;
} Slopes;

typedef struct {
    const uint8_t *labels, *edges;
    int64_t width; /* of their rows */
} LabelMap;

/* Slopes of the pixels of a tile and its halo; lines start at column x0 - R. */
static void slope_lines(const Level *l, const Tile *t, const LabelMap *map, const Slopes *slopes, float *ssim,
                        float *cs) {
    for (int64_t r = 0; r < t->height + 2 * R; r++) {
        const int64_t y = t->y0 + r - R, first = clamp(R - t->x0, 0, R),
                      last = smaller(t->width + 2 * R, l->width - t->x0 + R);
        float *gs = ssim + r * LINE, *gc = cs + r * LINE;
        memset(gs, 0, sizeof(float) * LINE);
        memset(gc, 0, sizeof(float) * LINE);
        if (y < 0 || y >= l->height) continue;
        const int64_t at = (y * map->width) << t->level, x = t->x0 - R;
        for (int64_t i = first; i < last; i++) {
            const int64_t from = at + ((x + i) << t->level);
            const uint8_t label = map->labels[from];
            gs[i] = slopes->ssim[label];
            gc[i] = slopes->cs[label];
        }
        if (t->level == 0)
            for (int64_t i = first; i < last; i++)
                gs[i] += (map->edges[at + x + i] & (map->labels[at + x + i] > 0)) ? slopes->edge : 0.0f;
    }
}

/* One line of dL/d(blurred x), dL/d(blurred x^2 + y^2), dL/d(blurred x y), LINE floats apart; zero without a slope. */
static void moment_line(const float *restrict saved, int64_t width, const float *restrict g_ssim,
                        const float *restrict g_cs, int64_t first, int64_t last, float *restrict gm, float *restrict gq,
                        float *restrict gp) {
    const float *restrict xs = saved, *restrict ys = xs + width, *restrict ss = ys + width, *restrict ps = ss + width;
    for (int64_t i = first; i < last; i++) {
        const int on = (g_ssim[i] != 0) | (g_cs[i] != 0);
        float x = xs[i], y = ys[i], structure = ss[i], spread = ps[i], below = 1.0f / (x * x + y * y + C1);
        float light = (2 * x * y + C1) * below, g = (g_ssim[i] * light + g_cs[i]) * spread;
        float q = -g * structure, p = 2 * g,
              m = 2 * g_ssim[i] * structure * (y - x * light) * below - 2 * x * q - y * p;
        gm[i] = on ? m : 0.0f;
        gq[i] = on ? q : 0.0f;
        gp[i] = on ? p : 0.0f;
    }
}

/* Adjoint of the windows for one channel of a tile: three blurred planes in work, HALO * TILE_W apart. */
static void blur_back(const Level *l, const Tile *t, int c, const float *scratch, const float *g_ssim,
                      const float *g_cs, float *work) {
    float *lines = work + 3 * HALO * TILE_W;
    const int64_t first = clamp(R - t->x0, 0, R), last = smaller(t->width + 2 * R, l->width - t->x0 + R);
    memset(lines, 0, sizeof(float) * 3 * LINE);
    for (int64_t r = 0; r < t->height + 2 * R; r++) {
        const int64_t y = t->y0 + r - R;
        float *rows = work + r * TILE_W;
        if (y < 0 || y >= l->height) {
            for (int k = 0; k < 3; k++) memset(rows + k * HALO * TILE_W, 0, sizeof(float) * TILE_W);
            continue;
        }
        const float *saved = scratch + l->saved + (c * l->height + y) * SAVED * l->width + t->x0 - R;
        moment_line(saved, l->width, g_ssim + r * LINE, g_cs + r * LINE, first, last, lines, lines + LINE,
                    lines + 2 * LINE);
        for (int k = 0; k < 3; k++) blur_line(lines + k * LINE, TILE_W, rows + k * HALO * TILE_W);
    }
    for (int k = 0; k < 3; k++) blur_columns(work + k * HALO * TILE_W, t->height, TILE_W);
}

/* dL/dx of one row from its blurred planes. */
static void image_gradient(const float *restrict work, const float *restrict x, const float *restrict y, int64_t n,
                           float *restrict out) {
    const float *restrict gm = work, *restrict gq = gm + HALO * TILE_W, *restrict gp = gq + HALO * TILE_W;
    for (int64_t i = 0; i < n; i++) out[i] = gm[i] + 2 * x[i] * gq[i] + y[i] * gp[i];
}

enum { WORK = 3 * HALO * TILE_W + 3 * LINE, SLOPES = HALO * LINE };

/* Gradients of the similarities of levels > 0 at their own pixels. slopes: float [levels][2][ids]. */
MGF_API void mgf_loss_coarse(int32_t *next, const Level *levels, int64_t count, const uint8_t *flags,
                             const uint8_t *labels, int64_t ids, const float *slopes, float *scratch, int32_t *failed) {
    void *block;
    float *work = worker_scratch(WORK + 2 * SLOPES, &block), *g_ssim = work + WORK, *g_cs = g_ssim + SLOPES;
    if (!work) {
        *failed = 1;
        return;
    }
    const LabelMap map = {labels, 0, levels->width};
    const int64_t first = levels[1].first_tile, tiles = tile_count(levels, count);
    for (int64_t index; (index = first + take_work(next)) < tiles;) {
        if (!(flags[index] & COVERS_LABEL)) continue;
        const Tile t = tile_at(levels, count, index);
        const Level *l = levels + t.level;
        const Slopes s = {slopes + 2 * t.level * ids, slopes + (2 * t.level + 1) * ids, 0};
        slope_lines(l, &t, &map, &s, g_ssim, g_cs);
        for (int c = 0; c < 3; c++) {
            blur_back(l, &t, c, scratch, g_ssim, g_cs, work);
            for (int64_t r = 0; r < t.height; r++) {
                const int64_t at = (c * l->height + t.y0 + r) * l->width + t.x0;
                image_gradient(work + r * TILE_W, scratch + l->color + at, scratch + l->photo + at, t.width,
                               scratch + l->grad + at);
            }
        }
    }
    free(block);
}

/* What levels > 0 add to one channel of a tile of level 0, at the pixels of level 1: out [TILE_H / 2][TILE_W / 2]. */
static void gather_levels(const Level *levels, int64_t count, const Tile *t, int c, const float *scratch, float *out) {
    float above[TILE_H / 4 * TILE_W / 4];
    memset(out, 0, sizeof(float) * TILE_H / 2 * TILE_W / 2);
    for (int64_t s = count - 1; s >= 1; s--) {
        const Level *l = levels + s;
        const int64_t y0 = t->y0 >> s, x0 = t->x0 >> s, n = TILE_W >> s;
        const int64_t rows = clamp(l->height - y0, 0, TILE_H >> s), columns = clamp(l->width - x0, 0, n);
        if (s < count - 1) memcpy(above, out, sizeof(float) * (TILE_H >> (s + 1)) * (n / 2));
        memset(out, 0, sizeof(float) * (TILE_H >> s) * n);
        for (int64_t r = 0; r < rows; r++) {
            const float *own = scratch + l->grad + (c * l->height + y0 + r) * l->width + x0,
                        *up = above + r / 2 * (n / 2);
            for (int64_t i = 0; i < columns; i++) out[r * n + i] = own[i] + (s < count - 1 ? 0.25f * up[i / 2] : 0.0f);
        }
    }
}

/* Everything mgf_loss_finish reads and writes besides the levels; packed by raster/loss.py in this order. */
typedef struct {
    const float *alpha, *distortion, *depth;         /* of the render, at the box; null: term is off */
    const uint8_t *labels, *edges, *background_band; /* [h][w] */
    const float *slopes, *l1;                        /* [2][ids] or null without similarity; [ids] */
    float *gradient, *error;                         /* planes [..][H][W] of the frame; at the box */
    int64_t image_row, error_row, frame_height, frame_width, y0, x0, planes;
} Finish;

typedef struct {
    float backdrop[3], edge_slope, edge_l1, background, distortion, normals;
} Factors;

enum { G_COLOR, G_ALPHA = 3, G_DISTORTION, G_DEPTH, G_NORMAL }; /* planes of the gradient */

/* Sum of distances and gradients of one row of one channel. similarity: dL/dx of the SSIM terms; ga: dL/dalpha so far.
   */
static void color_row(const float *restrict x, const float *restrict y, const float *restrict inside,
                      const float *restrict l1_weight, const float *restrict similarity, const float *restrict coarse,
                      float backdrop, int64_t n, float *restrict g, float *restrict ga, float *restrict distance) {
    for (int64_t i = 0; i < n; i++) {
        float d = x[i] - y[i], sign = (float)(d > 0) - (float)(d < 0);
        float v = inside[i] * (similarity[i] + 0.25f * coarse[i / 2] + l1_weight[i] * sign);
        g[i] = v;
        ga[i] -= backdrop * v;
        distance[i] += __builtin_fabsf(d);
    }
}

/* The gradients of depth, normal and alpha by the normal term, so far unscaled, get their factor. */
static void normals_row(const float *restrict alpha, const float *restrict depth, const float *restrict inside,
                        float factor, int64_t n, float *restrict g_depth, float *restrict g_normal, int64_t plane,
                        const float *restrict g_alpha, float *restrict ga) {
    for (int64_t i = 0; i < n; i++) {
        const int on = inside[i] > 0;
        float inverse = 1.0f / (alpha[i] > 1e-4f ? alpha[i] : 1e-4f), gd = on ? factor * g_depth[i] * inverse : 0.0f;
        g_depth[i] = gd;
        ga[i] += on ? factor * g_alpha[i] - gd * depth[i] * inverse : 0.0f;
    }
    for (int k = 0; k < 3; k++) {
        float *restrict g = g_normal + k * plane;
        for (int64_t i = 0; i < n; i++) g[i] = inside[i] > 0 ? factor * g[i] : 0.0f;
    }
}

static void clear_rows(const Finish *f, int64_t y, int64_t count, int64_t x, int64_t n) {
    for (int64_t p = 0; p < f->planes && n > 0; p++)
        for (int64_t r = 0; r < count; r++)
            memset(f->gradient + (p * f->frame_height + y + r) * f->frame_width + x, 0, sizeof(float) * n);
}

/* Zeros around the box, in TILE_H rows of the frame. */
static void clear_band(const Finish *f, int64_t band, int64_t height, int64_t width) {
    const int64_t end = smaller((band + 1) * TILE_H, f->frame_height);
    for (int64_t y = band * TILE_H; y < end; y++) {
        if (y < f->y0 || y >= f->y0 + height) {
            clear_rows(f, y, 1, 0, f->frame_width);
            continue;
        }
        clear_rows(f, y, 1, 0, f->x0);
        clear_rows(f, y, 1, f->x0 + width, f->frame_width - f->x0 - width);
    }
}

/* inside (0 or 1), weight of L1 (a third of it, for each channel) of a tile's pixels. */
static void weight_lines(const Finish *f, const Factors *k, const Tile *t, int64_t width, float *inside, float *l1) {
    for (int64_t r = 0; r < t->height; r++) {
        const uint8_t *labels = f->labels + (t->y0 + r) * width + t->x0,
                      *edges = f->edges + (t->y0 + r) * width + t->x0;
        float *restrict in = inside + r * TILE_W, *restrict w = l1 + r * TILE_W;
        for (int64_t i = 0; i < t->width; i++) w[i] = f->l1[labels[i]];
        for (int64_t i = 0; i < t->width; i++) {
            in[i] = labels[i] > 0 ? 1.0f : 0.0f;
            w[i] += edges[i] ? in[i] * k->edge_l1 : 0.0f;
        }
    }
}

/* alpha, distortion and error of one row, once its colours are done; sums: L1, alpha in the band, distortion inside. */
static void pixel_row(const Finish *f, const Factors *k, int64_t y, int64_t x, int64_t n, int64_t width,
                      const float *inside, const float *l1, const float *distance, float *ga, double *sums) {
    const int64_t plane = f->frame_height * f->frame_width, image = y * f->image_row + x;
    float *g = f->gradient + (f->y0 + y) * f->frame_width + f->x0 + x, product[3][TILE_W];
    const float *restrict alpha = f->alpha + image;
    const uint8_t *restrict band = f->background_band + y * width + x;
    float *restrict error = f->error + y * f->error_row + x;
    for (int64_t i = 0; i < n; i++) {
        float in_band = band[i] ? 1.0f : 0.0f, covered = in_band * alpha[i];
        ga[i] += in_band * k->background;
        error[i] = distance[i] * (1.0f / 3) + covered;
        product[0][i] = l1[i] * distance[i], product[1][i] = covered, product[2][i] = 0;
    }
    if (f->distortion)
        for (int64_t i = 0; i < n; i++) {
            g[G_DISTORTION * plane + i] = inside[i] * k->distortion;
            product[2][i] = inside[i] > 0 ? f->distortion[image + i] : 0.0f;
        }
    if (f->depth)
        normals_row(alpha, f->depth + image, inside, k->normals, n, g + G_DEPTH * plane, g + G_NORMAL * plane, plane,
                    g + G_ALPHA * plane, ga);
    memcpy(g + G_ALPHA * plane, ga, sizeof(float) * n);
    for (int j = 0; j < 3; j++) sums[j] += sum_line(product[j], n);
}

/* Terms of single pixels and all gradients, of the tiles of level 0 and of the frame around the box.
   sums: [tiles of level 0][3], given as zeros, see pixel_row. */
MGF_API void mgf_loss_finish(int32_t *next, const Level *levels, int64_t count, const uint8_t *flags, int64_t ids,
                             const Finish *f, const Factors *k, const float *scratch, double *sums, int32_t *failed) {
    enum { PLANE = TILE_H * TILE_W };
    void *block;
    float *work = worker_scratch(WORK + 2 * SLOPES + 6 * PLANE, &block), *g_ssim = work + WORK, *g_cs = g_ssim + SLOPES;
    if (!work) {
        *failed = 1;
        return;
    }
    float *inside = g_cs + SLOPES, *l1 = inside + PLANE, *ga = l1 + PLANE, *distance = ga + PLANE,
          *coarse = distance + PLANE;
    float *similarity = coarse + PLANE;
    memset(coarse, 0, sizeof(float) * 2 * PLANE);
    const int64_t h = levels->height, w = levels->width, tiles = levels->tiles_y * levels->tiles_x;
    const int64_t bands = (f->frame_height + TILE_H - 1) / TILE_H, plane = f->frame_height * f->frame_width;
    const LabelMap map = {f->labels, f->edges, w};
    for (int64_t index; (index = take_work(next)) < tiles + bands;) {
        if (index >= tiles) {
            clear_band(f, index - tiles, h, w);
            continue;
        }
        const Tile t = tile_at(levels, 1, index);
        if (!(flags[index] & (HAS_LABEL | HAS_BAND))) {
            clear_rows(f, f->y0 + t.y0, t.height, f->x0 + t.x0, t.width);
            for (int64_t r = 0; r < t.height; r++)
                memset(f->error + (t.y0 + r) * f->error_row + t.x0, 0, sizeof(float) * t.width);
            continue;
        }
        const int blurred = f->slopes && flags[index] & HAS_LABEL;
        memset(ga, 0, sizeof(float) * 2 * PLANE); /* and distance */
        weight_lines(f, k, &t, w, inside, l1);
        if (blurred) slope_lines(levels, &t, &map, &(Slopes){f->slopes, f->slopes + ids, k->edge_slope}, g_ssim, g_cs);
        else memset(similarity, 0, sizeof(float) * TILE_W), memset(coarse, 0, sizeof(float) * PLANE);
        for (int c = 0; c < 3; c++) {
            if (blurred) blur_back(levels, &t, c, scratch, g_ssim, g_cs, work);
            if (blurred && count > 1) gather_levels(levels, count, &t, c, scratch, coarse);
            for (int64_t r = 0; r < t.height; r++) {
                const int64_t at = (c * h + t.y0 + r) * w + t.x0, line = r * TILE_W;
                const float *x = scratch + levels->color + at, *y = scratch + levels->photo + at;
                if (blurred) image_gradient(work + line, x, y, t.width, similarity);
                color_row(x, y, inside + line, l1 + line, similarity, coarse + r / 2 * (TILE_W / 2), k->backdrop[c],
                          t.width, f->gradient + c * plane + (f->y0 + t.y0 + r) * f->frame_width + f->x0 + t.x0,
                          ga + line, distance + line);
            }
        }
        for (int64_t r = 0; r < t.height; r++)
            pixel_row(f, k, t.y0 + r, t.x0, t.width, w, inside + r * TILE_W, l1 + r * TILE_W, distance + r * TILE_W,
                      ga + r * TILE_W, sums + 3 * index);
    }
    free(block);
}
