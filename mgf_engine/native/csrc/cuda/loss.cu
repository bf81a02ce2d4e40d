// SPDX-License-Identifier: GPL-3.0-or-later
// Forward half of the training loss (eq. 16-19): compose the render over the backdrop, pyramids of render and photo,
// similarity maps of every level pooled per label, and from these the slopes that the other half (loss_backward.cu)
// starts from.
#include "cuda/loss.cuh"

struct Backdrop {
    float of[3];
};

// Colour and photo of level 0: the render over the backdrop where there is a label, else the photo. color: planes
// `plane` and rows `row` floats apart, first pixel of the box; alpha: rows `row` apart; photo uint8 [3][h][w].
KERNEL(loss_compose, BY_VALUE Levels levels, const float *color, int plane, int row, const float *alpha,
       const uint8_t *photo, const uint8_t *labels, BY_VALUE Backdrop backdrop, float *scratch) {
    const Level &l = levels.of[0];
    EACH(i, l.height * l.width) {
        const int64_t from = (int64_t)(i / l.width) * row + i % l.width, size = (int64_t)l.height * l.width;
        const float through = 1.0f - alpha[from];
        for (int c = 0; c < 3; c++) {
            const float p = photo[c * size + i] * (1.0f / 255),
                        over = color[c * (int64_t)plane + from] + through * backdrop.of[c];
            scratch[l.color + c * size + i] = labels[i] ? over : p;
            scratch[l.photo + c * size + i] = p;
        }
    }
}

// Level s from the level before; grid: pixels of the level.
KERNEL(loss_halve, BY_VALUE Levels levels, int s, float *scratch) {
    const Level &from = levels.of[s - 1], &to = levels.of[s];
    EACH(i, to.height * to.width) {
        const int64_t at = (int64_t)(i / to.width) * 2 * from.width + i % to.width * 2;
        for (int plane = 0; plane < 6; plane++) {
            const int c = plane % 3;
            const float *a =
                scratch + (plane < 3 ? from.color : from.photo) + c * (int64_t)from.height * from.width + at;
            const float *b = a + from.width;
            scratch[(plane < 3 ? to.color : to.photo) + c * (int64_t)to.height * to.width + i] =
                0.25f * ((a[0] + a[1]) + (b[0] + b[1]));
        }
    }
}

// The tile of both images with its halo, zeros beyond the level's edge.
struct Staged {
    float x[HALO][HALO], y[HALO][HALO];
};

// Blurred along rows: both images, the sum of their squares, their product.
struct Rows {
    float x[HALO][SIDE], y[HALO][SIDE], squares[HALO][SIDE], product[HALO][SIDE];
};

static inline void stage(const Level &l, const TileAt &t, int c, const float *scratch, Staged &to) {
    const int64_t plane = (int64_t)c * l.height * l.width;
    for (int i = THREAD; i < HALO * HALO; i += BLOCK) {
        const int r = i / HALO, k = i % HALO, y = t.y0 + r - RADIUS, x = t.x0 + k - RADIUS;
        const bool inside = inside_level(l, y, x);
        const int64_t at = plane + (int64_t)y * l.width + x;
        to.x[r][k] = inside ? scratch[l.color + at] : 0.0f;
        to.y[r][k] = inside ? scratch[l.photo + at] : 0.0f;
    }
}

static inline void blur_moments(const Staged &from, Rows &to) {
    for (int i = THREAD; i < HALO * SIDE; i += BLOCK) {
        const int r = i / SIDE, k = i % SIDE;
        float mx = 0.0f, my = 0.0f, squares = 0.0f, product = 0.0f;
        for (int j = 0; j < WINDOW; j++) {
            const float x = from.x[r][k + j], y = from.y[r][k + j], wx = WEIGHTS[j] * x, wy = WEIGHTS[j] * y;
            mx += wx, my += wy, squares += wx * x + wy * y, product += wx * y;
        }
        to.x[r][k] = mx, to.y[r][k] = my, to.squares[r][k] = squares, to.product[r][k] = product;
    }
}

// The thread's similarities summed over channels.
struct Similar {
    float ssim, cs;
};

// Adds one channel of the thread's pixel; saves what the backward half needs, planes `plane` floats apart.
static inline void compare(const Rows &rows, float *saved, int64_t plane, Similar &to) {
    const float x = blur_column(rows.x), y = blur_column(rows.y), cross = x * y, both = x * x + y * y;
    const float spread = 1.0f / (blur_column(rows.squares) - both + C2);
    const float structure = (2 * (blur_column(rows.product) - cross) + C2) * spread;
    saved[MEAN_X * plane] = x, saved[MEAN_Y * plane] = y, saved[STRUCTURE * plane] = structure,
                   saved[SPREAD * plane] = spread;
    to.ssim += (2 * cross + C1) / (both + C1) * structure;
    to.cs += structure;
}

// Similarities of all tiles with a label, pooled: sums [levels][2][ids] of ssim and cs per label, then SUM_EDGES, each
// three times too large (channels are added up). grid: tiles of all levels.
KERNEL(loss_similarity, BY_VALUE Levels levels, Labels maps, int ids, float *scratch, long long *sums) {
    SHARED Staged staged;
    SHARED Rows rows;
    SHARED long long pooled[2][MAX_IDS], edges;
    SHARED int labelled;
    Own<Similar> own;
    Own<unsigned> label, peers;
    Own<float> value;
    const TileAt t = tile_at(levels, BLOCK_X);
    const Level &l = levels.of[t.level];
    PHASE {
        pooled[0][THREAD] = pooled[1][THREAD] = 0;
        if (THREAD == 0) labelled = 0, edges = 0;
    }
    PHASE {
        const int y = t.y0 + own_y(), x = t.x0 + own_x();
        *label = inside_level(l, y, x) ? label_at(levels, maps.labels, t.level, y, x) : 0;
        if (*label) labelled = 1;
        own->ssim = own->cs = 0.0f;
    }
    if (!labelled) return;
    for (int c = 0; c < 3; c++) {
        PHASE { stage(l, t, c, scratch, staged); }
        PHASE { blur_moments(staged, rows); }
        PHASE {
            const int y = t.y0 + own_y(), x = t.x0 + own_x();
            const int64_t plane = (int64_t)l.height * l.width;
            if (inside_level(l, y, x))
                compare(rows, scratch + l.saved + c * SAVED * plane + (int64_t)y * l.width + x, plane, *own);
        }
    }
    EACH_WARP {
        match_lanes(label, peers);
        if (*peers == ~0u) {  // one label in the whole warp, as nearly always: add up first
            for (int map = 0; map < 2; map++) {
                LANES { *value = *label ? (map ? own->cs : own->ssim) : 0.0f; }
                add_lanes(value, FIXED, &pooled[map][*label]);
            }
        } else {
            LANES {
                if (*label)
                    add_atomic(&pooled[0][*label], fixed(own->ssim, FIXED)),
                        add_atomic(&pooled[1][*label], fixed(own->cs, FIXED));
            }
        }
        LANES {
            const bool edge =
                t.level == 0 && *label && maps.edges[(int64_t)(t.y0 + own_y()) * l.width + t.x0 + own_x()];
            *value = edge ? own->ssim : 0.0f;
        }
        add_lanes(value, FIXED, &edges);
    }
    PHASE {
        for (int map = 0; map < 2; map++)
            if (THREAD < ids && pooled[map][THREAD])
                add_atomic(sums + (2 * t.level + map) * ids + THREAD, pooled[map][THREAD]);
        if (THREAD == 0 && edges) add_atomic(sums + 2 * levels.count * ids + SUM_EDGES, edges);
    }
}

// How the similarities are weighted; base, edge: eq. 16 and 17 for a labelled pixel, and what an edge adds.
struct SimilarityFactors {
    float ssim, multilevel, base, edge, inside, edge_area;
};

// One mask of multi-scale SSIM (raster/loss.py, ms_ssim): its value, and its slopes in its pooled sums [levels][2],
// which lie `apart` entries apart; the sizes [levels] of the mask lie `ids` apart.
static inline double pool_mask(const Levels &levels, int ids, const long long *sums, int apart, const int *area,
                               double *slope, int *kind) {
    const double exponents[MAX_LEVELS] = {0.0448, 0.2856, 0.3001, 0.2363, 0.1333};
    int scales = 0;  // in which the label takes part
    double all = 0.0, value = 1.0, kept[MAX_LEVELS];
    while (scales < levels.count && sqrt((double)area[0]) >= (double)(WINDOW << scales)) all += exponents[scales++];
    for (int s = 0; s < levels.count; s++)
        slope[s] = 0.0, kind[s] = s == scales - 1 ? 0 : 1;  // similarity at its last scale
    for (int s = 0; s < scales; s++) {
        const int size = area[s * ids];
        const double mean = size ? (double)sums[(2 * s + kind[s]) * apart] / (3.0 * FIXED) / size : 1.0;
        kept[s] = mean > FLOOR ? mean : FLOOR;
        value *= pow(kept[s], exponents[s] / all);
        slope[s] = mean >= FLOOR && size ? exponents[s] / all / (kept[s] * size) : 0.0;
    }
    for (int s = 0; s < scales; s++) slope[s] *= value;
    return value;
}

// slopes [levels][2][ids]: dL/dssim and dL/dcs of single pixels, divided by the three channels; similarity: the SSIM
// terms of the loss. area [levels][ids], shares [ids]: pixels and weight of each label and, in place of label 0, of the
// whole building, which labels 1..elements make up. One block, a thread a label.
KERNEL(loss_slopes, BY_VALUE Levels levels, int ids, int elements, const long long *sums, const int *area,
       const double *shares, BY_VALUE SimilarityFactors k, float *slopes, double *similarity) {
    SHARED double lost[MAX_IDS], plain[MAX_IDS], from_whole[2 * MAX_LEVELS];
    SHARED long long whole[2 * MAX_LEVELS];
    PHASE {
        if (THREAD >= 2 * levels.count) continue;
        long long sum = 0;
        for (int label = 1; label <= elements; label++) sum += sums[THREAD * ids + label];
        whole[THREAD] = sum, from_whole[THREAD] = 0.0;
    }
    PHASE {
        lost[THREAD] = plain[THREAD] = 0.0;
        if (THREAD || !(k.multilevel > 0.0f)) continue;
        double slope[MAX_LEVELS];
        int kind[MAX_LEVELS];
        const double value = pool_mask(levels, ids, whole, 1, area, slope, kind),
                     share = (double)k.multilevel * k.ssim * shares[0];
        for (int s = 0; s < levels.count; s++) from_whole[2 * s + kind[s]] = -share * slope[s];
        lost[0] = share * (1.0 - value);
    }
    PHASE {
        if (THREAD >= ids) continue;
        const int label = THREAD;
        double slope[MAX_LEVELS];
        int kind[MAX_LEVELS];
        const double value = pool_mask(levels, ids, sums + label, ids, area + label, slope, kind);
        const double share = (double)k.multilevel * k.ssim * shares[label];
        for (int s = 0; s < levels.count; s++) {
            double of[2] = {0.0, 0.0};
            if (k.multilevel > 0.0f && label) of[kind[s]] = -share * slope[s];
            for (int map = 0; map < 2; map++)
                if (label && label <= elements) of[map] += from_whole[2 * s + map];
            if (s == 0 && label) of[0] -= (double)k.ssim * k.base;
            for (int map = 0; map < 2; map++) slopes[(2 * s + map) * ids + label] = (float)(of[map] / 3.0);
        }
        if (!label) continue;
        if (k.multilevel > 0.0f) lost[label] = share * (1.0 - value);
        plain[label] = (double)sums[label] / (3.0 * FIXED);
    }
    PHASE {
        if (THREAD) continue;
        double similar = 0.0, total = 0.0;
        for (int label = 0; label < ids; label++) similar += plain[label], total += lost[label];
        const double edges = (double)sums[2 * levels.count * ids + SUM_EDGES] / (3.0 * FIXED);
        *similarity = total + k.ssim * (k.base * (k.inside - similar) + k.edge * (k.edge_area - edges));
    }
}
