// SPDX-License-Identifier: GPL-3.0-or-later
// Depth of a photo by PatchMatch stereo (Bleyer et al. 2011) against several neighbours: each pixel holds a plane,
// tries those of pixels around it and random perturbations of its own, and keeps the one with which the photos look
// most alike. Half of the pixels, those of one colour of a checkerboard, are moved at a time by what the others hold
// (Galliani et al. 2015), so the result does not depend on how the work is shared out.
//
// A plane is inverse + dx * across + dy * down, the inverse depth dx, dy pixels away: linear in the picture.
#include "common/export.h"
#include "stereo/correlate.h"

enum { PIECE = 64, MOST_NEIGHBOURS = 8, MOST_BEST = 4, NEAR = 8, REACH = 5, PERTURBATIONS = 3 };
#define SPACING 2.0f

typedef uint32_t u16x __attribute__((vector_size(64), aligned(64)));

// As mgf_patch_match takes them.
typedef struct {
    float low, high;  // inverse depths that are tried
    float texture;    // least deviation of brightness in a patch, grey levels
    float contrast;   // difference of brightness at which a pixel of the patch weighs 1 / e, grey levels
    float shift;      // largest random change of the inverse depth, in pixels of parallax
    float tilt;       // largest random change of the slope (tangent)
    float consistency, most_off;  // cost per pixel off a neighbour's own depth; the distance up to which it grows, px
    float inverse_focal[2];
    int64_t best, seed;
} Search;

typedef struct {
    v16 inverse, across, down;
} Plane;

typedef struct {
    i16 at, good;
    v16 x, y, here[MOST_NEIGHBOURS][3];  // here: m (x, y, 1) of each neighbour
} Group;

static Group load_group(const Photo *p, const int32_t *pixels, int64_t count, const Photo *others, int64_t neighbours) {
    Group g;
    for (int l = 0; l < VECTOR; l++) {
        const int32_t pixel = pixels[l < count ? l : 0];
        g.good[l] = l < count ? -1 : 0, g.at[l] = pixel;
        g.x[l] = (float)(pixel % p->width) + 0.5f, g.y[l] = (float)(pixel / p->width) + 0.5f;
    }
    for (int64_t n = 0; n < neighbours; n++)
        for (int r = 0; r < 3; r++)
            g.here[n][r] =
                (float)others[n].m[3 * r] * g.x + (float)others[n].m[3 * r + 1] * g.y + (float)others[n].m[3 * r + 2];
    return g;
}

// The patches around pixels, each of their pixels weighted by how like the middle one it is (bilateral weights).
static void load_weighted(const Photo *p, Group *g, const Search *search, Patch *patch) {
    v16 sum = splat(0.0f), squares = splat(0.0f);
    const v16 middle = __builtin_convertvector(gather(p->quads, g->at) & 255, v16);
    const float scale = 1.442695f / (search->contrast * search->contrast);
    patch->total = splat(0.0f);
    for (int k = 0; k < SAMPLES; k++) {
        const int dx = (int)SPACING * (k % SIDE - RADIUS), dy = (int)SPACING * (k / SIDE - RADIUS);
        patch->grey[k] = __builtin_convertvector(gather(p->quads, g->at + (dy * (int32_t)p->width + dx)) & 255, v16);
        const v16 off = patch->grey[k] - middle;
        patch->weight[k] = exp2_16(-scale * off * off);
        patch->total += patch->weight[k], sum += patch->weight[k] * patch->grey[k];
    }
    patch->mean = sum / patch->total;
    for (int k = 0; k < SAMPLES; k++) {
        const v16 off = patch->grey[k] - patch->mean;
        patch->grey[k] = patch->weight[k] * off;
        squares += patch->grey[k] * off;
    }
    g->good &= squares > search->texture * search->texture * patch->total;
    patch->spread = vsqrt(choose(g->good, squares, splat(1.0f)));
}

static Homography on_plane(const Photo *other, const v16 here[3], const Plane *plane) {
    Homography h;
    for (int r = 0; r < 3; r++) {
        const float b = (float)other->b[r];
        h.centre[r] = here[r] + b * plane->inverse;
        h.across[r] = (float)other->m[3 * r] + b * plane->across;
        h.down[r] = (float)other->m[3 * r + 1] + b * plane->down;
    }
    return h;
}

// Pixels that a pixel moves in a photo for a relative change of its inverse depth.
static v16 parallax(const Photo *other, const v16 here[3], v16 inverse) {
    const v16 w = here[2] + (float)other->b[2] * inverse, scale = inverse / vmax(w * w, splat(1e-12f));
    const v16 du = ((float)other->b[0] * here[2] - (float)other->b[2] * here[0]) * scale;
    const v16 dv = ((float)other->b[1] * here[2] - (float)other->b[2] * here[1]) * scale;
    return vsqrt(du * du + dv * dv);
}

// Distance in pixels between where a plane lies and what the neighbour's own depth says, at most `most`.
static v16 inconsistency(const Photo *other, const v16 here[3], const Plane *plane, const Place *place, float most) {
    const i16 x = __builtin_convertvector(place->at[0] + 0.5f, i16),
              y = __builtin_convertvector(place->at[1] + 0.5f, i16);
    const v16 known = (v16)gather(other->depth, y * (int32_t)other->width + x);
    const v16 expected = (here[2] + (float)other->b[2] * plane->inverse) / plane->inverse;
    const v16 off = expected / choose(known > 0.0f, known, splat(1.0f)) - 1.0f;
    const v16 pixels = vmax(off, -off) * parallax(other, here, plane->inverse);
    return choose(known > 0.0f, vmin(pixels, splat(most)), splat(most));
}

// Mean of the best correlations of a plane with the neighbours, less what contradicts their depths; -1 where it cannot
// be.
static v16 score_of(const Group *g, const Patch *patch, const Plane *plane, const Photo *others, int64_t neighbours,
                    const Search *search) {
    v16 top[MOST_BEST];
    for (int64_t k = 0; k < search->best; k++) top[k] = splat(-1.0f);
    const i16 valid = g->good & (plane->inverse >= search->low) & (plane->inverse <= search->high);
    if (!any(valid)) return top[0];
    for (int64_t n = 0; n < neighbours; n++) {
        const Homography h = on_plane(others + n, g->here[n], plane);
        const Place place = place_of(others + n, &h, valid, SPACING);
        if (!any(place.inside)) continue;
        v16 value = correlate(patch, &place, others + n, search->texture, SPACING);
        if (search->consistency > 0.0f)
            value -= search->consistency * inconsistency(others + n, g->here[n], plane, &place, search->most_off);
        value = choose(place.inside, value, splat(-1.0f));
        for (int64_t k = 0; k < search->best; k++) {
            const v16 less = vmin(top[k], value);
            top[k] = vmax(top[k], value), value = less;
        }
    }
    v16 sum = top[0];
    for (int64_t k = 1; k < search->best; k++) sum += top[k];
    return choose(valid, sum / (float)search->best, splat(-1.0f));
}

// Numbers from -1 to 1, other ones for each pixel, seed and draw (hash of Wellons' lowbias32).
static v16 at_random(i16 at, int64_t seed, int draw) {
    u16x h = (u16x)at * 16u + (uint32_t)draw + (uint32_t)seed * 0x9e3779b9u;
    h ^= h >> 16, h *= 0x7feb352du, h ^= h >> 15, h *= 0x846ca68bu, h ^= h >> 16;
    return __builtin_convertvector((i16)(h >> 8), v16) * (2.0f / 16777216.0f) - 1.0f;
}

static void keep_better(const Plane *tried, v16 score, Plane *plane, v16 *best) {
    const i16 better = score > *best;
    plane->inverse = choose(better, tried->inverse, plane->inverse);
    plane->across = choose(better, tried->across, plane->across);
    plane->down = choose(better, tried->down, plane->down);
    *best = choose(better, score, *best);
}

// The plane with a random change of its depth, its slope or both.
static Plane perturb(const Group *g, const Plane *plane, v16 step, const Search *search, int number) {
    Plane tried = *plane;
    if (number != 1)
        tried.inverse += plane->inverse * search->shift * step * at_random(g->at, search->seed, 4 * number);
    const v16 ratio = tried.inverse / plane->inverse;
    const float tilt = number == 0 ? 0.0f : search->tilt;
    tried.across = tried.across * ratio +
                   tilt * at_random(g->at, search->seed, 4 * number + 1) * tried.inverse * search->inverse_focal[0];
    tried.down = tried.down * ratio +
                 tilt * at_random(g->at, search->seed, 4 * number + 2) * tried.inverse * search->inverse_focal[1];
    return tried;
}

/* Moves the planes of pixels [n] (y * width + x, REACH from the rim, of one colour of the checkerboard).

   inverse, across, down, score [height][width]: planes and how alike the photos look with them; inverse 0 where there
   is none. The scores are set; those of other photos or another `consistency` do not matter. */
MGF_API void mgf_patch_match(int32_t *next, int64_t n, const int32_t *pixels, const Photo *first, const Photo *others,
                             int64_t neighbours, const Search *search, float *inverse, float *across, float *down,
                             float *score) {
    static const int around[NEAR][2] = {{1, 0},     {-1, 0},     {0, 1},     {0, -1},
                                        {REACH, 0}, {-REACH, 0}, {0, REACH}, {0, -REACH}};
    for (;;) {
        const int64_t start = take_work(next) * PIECE, end = start + PIECE < n ? start + PIECE : n;
        if (start >= n) return;
        for (int64_t i = start; i < end; i += VECTOR) {
            const int64_t lanes = end - i < VECTOR ? end - i : VECTOR;
            Group g = load_group(first, pixels + i, lanes, others, neighbours);
            Patch patch;
            load_weighted(first, &g, search, &patch);
            Plane plane = {(v16)gather(inverse, g.at), (v16)gather(across, g.at), (v16)gather(down, g.at)};
            v16 best = score_of(&g, &patch, &plane, others, neighbours, search);
            for (int k = 0; k < NEAR && any(g.good); k++) {
                const i16 there = g.at + (around[k][1] * (int32_t)first->width + around[k][0]);
                Plane tried = {(v16)gather(inverse, there), (v16)gather(across, there), (v16)gather(down, there)};
                const i16 known = tried.inverse > 0.0f;
                tried.inverse -= (float)around[k][0] * tried.across + (float)around[k][1] * tried.down;
                tried.inverse = keep(known, tried.inverse);
                keep_better(&tried, score_of(&g, &patch, &tried, others, neighbours, search), &plane, &best);
            }
            v16 most = splat(1e-6f);
            for (int64_t k = 0; k < neighbours; k++) most = vmax(parallax(others + k, g.here[k], plane.inverse), most);
            for (int k = 0; k < PERTURBATIONS && any(g.good); k++) {
                const Plane tried = perturb(&g, &plane, 1.0f / most, search, k);
                keep_better(&tried, score_of(&g, &patch, &tried, others, neighbours, search), &plane, &best);
            }
            for (int64_t l = 0; l < lanes; l++) {
                const int32_t at = g.at[l];
                inverse[at] = plane.inverse[l], across[at] = plane.across[l], down[at] = plane.down[l],
                score[at] = best[l];
            }
        }
    }
}
