// SPDX-License-Identifier: GPL-3.0-or-later
// Backward half of the training loss: gradients of the pooled similarities through windows and pyramid, the normal
// term, the terms of single pixels (L1, background, distortion), and the total.
#include "cuda/loss.cuh"

// dL/dssim and dL/dcs of single pixels [levels][2][ids], and what a labelled edge adds to the former (level 0); null:
// no term.
struct Slopes {
    const float *of;
    float edge;
};

// dL/d(blurred x), dL/d(blurred x^2 + y^2), dL/d(blurred x y): with the halo, and blurred along rows.
struct Adjoint {
    float m[HALO][HALO], q[HALO][HALO], p[HALO][HALO];
    float rows[3][HALO][SIDE];
};

static inline void adjoint_of(const Levels &levels, const TileAt &t, const Labels &maps, const Slopes &slopes, int ids,
                              int c, const float *scratch, Adjoint &to) {
    const Level &l = levels.of[t.level];
    const int64_t plane = (int64_t)l.height * l.width;
    for (int i = THREAD; i < HALO * HALO; i += BLOCK) {
        const int r = i / HALO, k = i % HALO, y = t.y0 + r - RADIUS, x = t.x0 + k - RADIUS;
        float g_ssim = 0.0f, g_cs = 0.0f;
        if (inside_level(l, y, x)) {
            const int label = label_at(levels, maps.labels, t.level, y, x);
            g_ssim = slopes.of[2 * t.level * ids + label], g_cs = slopes.of[(2 * t.level + 1) * ids + label];
            if (t.level == 0 && label && maps.edges[(int64_t)y * l.width + x]) g_ssim += slopes.edge;
        }
        to.m[r][k] = to.q[r][k] = to.p[r][k] = 0.0f;
        if (g_ssim == 0.0f && g_cs == 0.0f) continue;  // nothing was saved where there is no label
        const float *saved = scratch + l.saved + c * SAVED * plane + (int64_t)y * l.width + x;
        const float mx = saved[MEAN_X * plane], my = saved[MEAN_Y * plane], structure = saved[STRUCTURE * plane];
        const float spread = saved[SPREAD * plane], below = 1.0f / (mx * mx + my * my + C1);
        const float light = (2 * mx * my + C1) * below, g = (g_ssim * light + g_cs) * spread, q = -g * structure,
                    p = 2 * g;
        to.q[r][k] = q, to.p[r][k] = p;
        to.m[r][k] = 2 * g_ssim * structure * (my - mx * light) * below - 2 * mx * q - my * p;
    }
}

// dL/dcolor of one channel at the thread's pixel, once the adjoint's rows are there.
static inline float image_gradient(const Level &l, int c, int y, int x, const float *scratch, const Adjoint &from) {
    const int64_t at = ((int64_t)c * l.height + y) * l.width + x;
    return blur_column(from.rows[0]) + 2 * scratch[l.color + at] * blur_column(from.rows[1]) +
           scratch[l.photo + at] * blur_column(from.rows[2]);
}

// Gradients of the similarities of levels > 0 at their own pixels. grid: tiles of these levels.
KERNEL(loss_coarse, BY_VALUE Levels levels, Labels maps, int ids, Slopes slopes, float *scratch) {
    SHARED Adjoint adjoint;
    const TileAt t = tile_at(levels, levels.of[1].first_tile + BLOCK_X);
    const Level &l = levels.of[t.level];
    for (int c = 0; c < 3; c++) {
        PHASE { adjoint_of(levels, t, maps, slopes, ids, c, scratch, adjoint); }
        PHASE {
            blur_rows(adjoint.m, adjoint.rows[0]), blur_rows(adjoint.q, adjoint.rows[1]),
                blur_rows(adjoint.p, adjoint.rows[2]);
        }
        PHASE {
            const int y = t.y0 + own_y(), x = t.x0 + own_x();
            if (inside_level(l, y, x))
                scratch[l.grad + ((int64_t)c * l.height + y) * l.width + x] =
                    image_gradient(l, c, y, x, scratch, adjoint);
        }
    }
}

// The render's maps at the box: rows `row` floats apart, planes of the normal `plane`. Null where the term is off.
struct Maps {
    const float *alpha, *distortion, *depth, *normal;
    int row, plane;
};

// Planes of the gradient of the whole frame [planes][height][width], given as zeros; the box begins at (y0, x0).
struct Gradient {
    float *of;
    int height, width, y0, x0;
};

enum { G_COLOR, G_ALPHA = 3, G_DISTORTION, G_DEPTH, G_NORMAL };

static inline float *gradient_at(const Gradient &g, int plane, int y, int x) {
    return g.of + ((int64_t)plane * g.height + g.y0 + y) * g.width + g.x0 + x;
}

struct Intrinsics {
    float fx, fy, cx, cy;  // pixels of the box
};

enum { AROUND = SIDE + 4, NEXT = SIDE + 2 };

// Expected depth of the tile's pixels and two around it, 0 where a pixel does not count; and dL/dX, dL/dY of those and
// one around.
struct Surface {
    float z[AROUND][AROUND], slope[6][NEXT][NEXT];
};

// The normal of the staged depths at one pixel against the rendered one: fills slope[..][r][k]; the pixel is at (y, x)
// of the box. Formulas: the C kernels' normals.h. Returns whether the pixel counts; then loss is its loss and n its
// normal.
static inline bool compare_normals(Surface &s, const Maps &maps, const Intrinsics &in, int r, int k, int y, int x,
                                   float *loss, float *n) {
    const float here = s.z[r + 1][k + 1], a = s.z[r + 1][k], b = s.z[r + 1][k + 2], c = s.z[r][k + 1],
                d = s.z[r + 2][k + 1];
    for (int i = 0; i < 6; i++) s.slope[i][r][k] = 0.0f;
    if (!(here > 0 && a > 0 && b > 0 && c > 0 && d > 0)) return false;
    const float ix = 1.0f / in.fx, iy = 1.0f / in.fy, u = (x + 0.5f - in.cx) * ix, v = (y + 0.5f - in.cy) * iy,
                v0 = v - iy, v1 = v + iy;
    const float X0 = b * (u + ix) - a * (u - ix), X2 = b - a, X1 = X2 * v, Y1 = d * v1 - c * v0, Y2 = d - c,
                Y0 = Y2 * u;
    n[0] = Y1 * X2 - Y2 * X1, n[1] = Y2 * X0 - Y0 * X2, n[2] = Y0 * X1 - Y1 * X0;
    const float square = n[0] * n[0] + n[1] * n[1] + n[2] * n[2];
    if (!(square > 1e-30f)) return false;
    const float inverse = 1.0f / sqrtf(square);
    const int64_t at = (int64_t)y * maps.row + x;
    float N[3], dot = 0.0f, h[3];
    for (int i = 0; i < 3; i++) n[i] *= inverse, N[i] = maps.normal[i * (int64_t)maps.plane + at], dot += N[i] * n[i];
    *loss = maps.alpha[at] - dot;
    for (int i = 0; i < 3; i++)
        h[i] = -inverse * (N[i] - dot * n[i]);  // dL/d(Y x X); d(h . Y x X) = dX . (h x Y) + dY . (X x h)
    s.slope[0][r][k] = h[1] * Y2 - h[2] * Y1, s.slope[1][r][k] = h[2] * Y0 - h[0] * Y2,
    s.slope[2][r][k] = h[0] * Y1 - h[1] * Y0;
    s.slope[3][r][k] = X1 * h[2] - X2 * h[1], s.slope[4][r][k] = X2 * h[0] - X0 * h[2],
    s.slope[5][r][k] = X0 * h[1] - X1 * h[0];
    return true;
}

// The normal term of labelled pixels that are more than half covered. Gradients go unscaled into the planes of depth,
// normal and alpha, sums into SUM_NORMALS and SUM_NORMAL_WEIGHTS; loss_finish scales. grid: tiles of level 0.
KERNEL(loss_normals, BY_VALUE Levels levels, Labels labels, Maps maps, BY_VALUE Intrinsics in, Gradient gradient,
       int ids, long long *sums) {
    SHARED Surface s;
    SHARED long long totals[2];
    Own<float> loss, weight;
    const TileAt t = tile_at(levels, BLOCK_X);
    const Level &l = levels.of[0];
    PHASE {
        for (int i = THREAD; i < AROUND * AROUND; i += BLOCK) {
            const int y = t.y0 + i / AROUND - 2, x = t.x0 + i % AROUND - 2;
            float z = 0.0f;
            if (inside_level(l, y, x) && labels.labels[(int64_t)y * l.width + x]) {
                const int64_t at = (int64_t)y * maps.row + x;
                if (maps.alpha[at] > 0.5f) z = maps.depth[at] / maps.alpha[at];
            }
            s.z[i / AROUND][i % AROUND] = z;
        }
        if (THREAD < 2) totals[THREAD] = 0;
        *loss = *weight = 0.0f;
    }
    PHASE {
        for (int i = THREAD; i < NEXT * NEXT; i += BLOCK) {
            const int r = i / NEXT, k = i % NEXT, y = t.y0 + r - 1, x = t.x0 + k - 1;
            const bool own = r >= 1 && k >= 1 && r <= SIDE && k <= SIDE && inside_level(l, y, x);
            float value, n[3];
            const bool counts = compare_normals(s, maps, in, r, k, y, x, &value, n);
            if (!own) continue;
            for (int c = 0; c < 3; c++) *gradient_at(gradient, G_NORMAL + c, y, x) = counts ? -n[c] : 0.0f;
            *gradient_at(gradient, G_ALPHA, y, x) = counts ? 1.0f : 0.0f;
            if (counts) *loss += value, *weight += 1.0f;
        }
    }
    PHASE {  // depth (x, y) enters X of its left and right neighbour and Y of those above and below
        const int y = t.y0 + own_y(), x = t.x0 + own_x(), r = own_y() + 1, k = own_x() + 1;
        if (!inside_level(l, y, x)) continue;
        const float u = (x + 0.5f - in.cx) / in.fx, v = (y + 0.5f - in.cy) / in.fy, ray[3] = {u, v, 1.0f};
        float sum = 0.0f;
        for (int i = 0; i < 3; i++) {
            sum += ray[i] * (s.slope[i][r][k - 1] - s.slope[i][r][k + 1]);
            sum += ray[i] * (s.slope[3 + i][r - 1][k] - s.slope[3 + i][r + 1][k]);
        }
        *gradient_at(gradient, G_DEPTH, y, x) = sum;
    }
    EACH_WARP {
        add_lanes(loss, FIXED, totals);
        add_lanes(weight, FIXED, totals + 1);
    }
    PHASE {
        if (THREAD < 2 && totals[THREAD])
            add_atomic(sums + 2 * levels.count * ids + SUM_NORMALS + THREAD, totals[THREAD]);
    }
}

struct PixelFactors {
    float backdrop[3], edge_l1, background, distortion, normals;
};

// What the thread's pixel has so far.
struct Finished {
    float ga, distance, l1, inside;
};

// One channel: gradient of the colour, what it takes from alpha, and the distance.
static inline void finish_color(const Levels &levels, int c, int y, int x, float similarity, float backdrop,
                                const float *scratch, const Gradient &gradient, Finished &to) {
    const Level &l = levels.of[0];
    const int64_t at = ((int64_t)c * l.height + y) * l.width + x;
    const float d = scratch[l.color + at] - scratch[l.photo + at], sign = (float)(d > 0) - (float)(d < 0);
    const float v = to.inside * (similarity + to.l1 * sign);
    *gradient_at(gradient, G_COLOR + c, y, x) = v;
    to.ga -= backdrop * v;
    to.distance += fabsf(d);
}

// What coarser levels add to one channel at a pixel of level 0: a quarter a level of the gradient at the pixel above
// it.
static inline float gather_levels(const Levels &levels, int c, int y, int x, const float *scratch) {
    float sum = 0.0f, share = 1.0f;
    for (int s = 1; s < levels.count; s++) {
        const Level &l = levels.of[s];
        share *= 0.25f;
        if (!inside_level(l, y >> s, x >> s)) break;
        sum += share * scratch[l.grad + ((int64_t)c * l.height + (y >> s)) * l.width + (x >> s)];
    }
    return sum;
}

// The gradients of the normal term get their factor; the expected depth is depth / alpha.
static inline void finish_normals(const Maps &maps, const Gradient &gradient, int y, int x, float factor,
                                  Finished &to) {
    const int64_t at = (int64_t)y * maps.row + x;
    const float alpha = maps.alpha[at], inverse = 1.0f / (alpha > 1e-4f ? alpha : 1e-4f);
    const float scaled = to.inside * factor, gd = scaled * *gradient_at(gradient, G_DEPTH, y, x) * inverse;
    *gradient_at(gradient, G_DEPTH, y, x) = gd;
    to.ga += scaled * *gradient_at(gradient, G_ALPHA, y, x) - gd * maps.depth[at] * inverse;
    for (int c = 0; c < 3; c++) *gradient_at(gradient, G_NORMAL + c, y, x) *= scaled;
}

// All gradients, the error map (at the box, rows error_row apart), and the sums of L1, alpha in the background band,
// distortion. l1 [ids]: weight of the distance by label. grid: tiles of level 0.
KERNEL(loss_finish, BY_VALUE Levels levels, Labels labels, Maps maps, int ids, Slopes slopes, const float *l1,
       BY_VALUE PixelFactors k, const float *scratch, Gradient gradient, float *error, int error_row, long long *sums) {
    SHARED Adjoint adjoint;
    SHARED long long totals[3];
    Own<Finished> own;
    Own<float> value;
    const TileAt t = tile_at(levels, BLOCK_X);
    const Level &l = levels.of[0];
    const long long *others = sums + 2 * levels.count * ids;
    PHASE {
        const int y = t.y0 + own_y(), x = t.x0 + own_x();
        const Finished none = {};
        *own = none;
        if (THREAD < 3) totals[THREAD] = 0;
        if (!inside_level(l, y, x)) continue;
        const int64_t at = (int64_t)y * l.width + x;
        const int label = labels.labels[at];
        own->inside = label ? 1.0f : 0.0f;
        own->l1 = l1[label] + (labels.edges[at] ? own->inside * k.edge_l1 : 0.0f);
    }
    for (int c = 0; c < 3; c++) {
        if (slopes.of) {
            PHASE { adjoint_of(levels, t, labels, slopes, ids, c, scratch, adjoint); }
            PHASE {
                blur_rows(adjoint.m, adjoint.rows[0]), blur_rows(adjoint.q, adjoint.rows[1]),
                    blur_rows(adjoint.p, adjoint.rows[2]);
            }
        }
        PHASE {
            const int y = t.y0 + own_y(), x = t.x0 + own_x();
            if (!inside_level(l, y, x)) continue;
            float similarity = 0.0f;
            if (slopes.of && own->inside > 0)
                similarity = image_gradient(l, c, y, x, scratch, adjoint) + gather_levels(levels, c, y, x, scratch);
            finish_color(levels, c, y, x, similarity, k.backdrop[c], scratch, gradient, *own);
        }
    }
    PHASE {
        const int y = t.y0 + own_y(), x = t.x0 + own_x();
        if (!inside_level(l, y, x)) continue;
        const float in_band = labels.background_band[(int64_t)y * l.width + x] ? 1.0f : 0.0f;
        own->ga += in_band * k.background;
        error[(int64_t)y * error_row + x] =
            own->distance * (1.0f / 3) + in_band * maps.alpha[(int64_t)y * maps.row + x];
        if (maps.distortion) *gradient_at(gradient, G_DISTORTION, y, x) = own->inside * k.distortion;
        const float weights = maps.depth ? (float)((double)others[SUM_NORMAL_WEIGHTS] / FIXED) : 0.0f;
        if (maps.depth) finish_normals(maps, gradient, y, x, weights > 0.0f ? k.normals / weights : 0.0f, *own);
        *gradient_at(gradient, G_ALPHA, y, x) = own->ga;
    }
    EACH_WARP {
        for (int sum = 0; sum < 3; sum++) {
            LANES {
                const int y = t.y0 + own_y(), x = t.x0 + own_x();
                const bool inside = inside_level(l, y, x);
                const int64_t at = (int64_t)y * maps.row + x;
                *value = 0.0f;
                if (sum == 0) *value = own->l1 * own->distance;
                if (sum == 1 && inside && labels.background_band[(int64_t)y * l.width + x]) *value = maps.alpha[at];
                if (sum == 2 && inside && maps.distortion && own->inside > 0) *value = maps.distortion[at];
            }
            add_lanes(value, sum == 0 ? FIXED_L1 : FIXED, totals + sum);
        }
    }
    PHASE {
        if (THREAD < 3 && totals[THREAD]) add_atomic(sums + 2 * levels.count * ids + SUM_L1 + THREAD, totals[THREAD]);
    }
}

struct TermFactors {
    float distortion, normals, background;  // already divided by the number of pixels, but for the normals
};

// parts: colour, geometry and background terms; *total their sum. similarity: from loss_slopes, or null. One thread.
KERNEL(loss_total, int first, const long long *sums, const double *similarity, BY_VALUE TermFactors k, float *parts,
       float *total) {
    EACH(i, 1) {
        const long long *others = sums + first + i;
        const double l1 = (double)others[SUM_L1] / FIXED_L1, in_band = (double)others[SUM_IN_BAND] / FIXED;
        const double distortion = (double)others[SUM_DISTORTION] / FIXED, weights = (double)others[SUM_NORMAL_WEIGHTS];
        const double normals = weights > 0.0 ? (double)others[SUM_NORMALS] / weights : 0.0;
        const double color = l1 + (similarity ? *similarity : 0.0),
                     geometry = k.normals * normals + k.distortion * distortion;
        parts[0] = (float)color, parts[1] = (float)geometry, parts[2] = (float)(k.background * in_band);
        *total = (float)(color + geometry + k.background * in_band);
    }
}
