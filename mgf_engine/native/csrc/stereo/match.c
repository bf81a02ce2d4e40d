// SPDX-License-Identifier: GPL-3.0-or-later
// How alike a photo and its neighbours look around a pixel, for several depths of the surface there: normalised
// cross-correlation of a patch, carried over by the plane through the surface (plane sweep with known normals; Collins
// 1996, Gallup et al. 2007).
//
// Brightness and contrast drop out of the measure, so photos of other exposure compare as well. Sixteen pixels go side
// by side, one in each lane. Four neighbouring pixels of a photo are packed into one word, since fetching them from
// sixteen places is what takes the time.
#include "common/export.h"
#include "stereo/correlate.h"

enum { GROUPS = 4, MOST_STEPS = 33 };

// Sixteen pixels, and the plane through the surface at each: inverse + dx * slope[0] + dy * slope[1] is 1 / depth
// beside it.
typedef struct {
    i16 at, good;  // index in the picture; may the lane be used?
    v16 x, y, depth, inverse, slope[2];
} Pixels;

static Pixels load_pixels(const Photo *p, const int32_t *pixels, int64_t count, const float *normals, const float *k) {
    Pixels r;
    v16 m[3];
    const int32_t width = (int32_t)p->width, height = (int32_t)p->height;
    for (int l = 0; l < VECTOR; l++) {
        const int64_t i = l < count ? l : 0;
        const int32_t x = pixels[i] % width, y = pixels[i] / width;
        const int inside = x >= RADIUS && y >= RADIUS && x + RADIUS < width && y + RADIUS < height;
        r.good[l] = l < count && inside ? -1 : 0;
        r.at[l] = inside ? pixels[i] : RADIUS * width + RADIUS;
        r.x[l] = x + 0.5f, r.y[l] = y + 0.5f, r.depth[l] = p->depth[pixels[i]];
        for (int c = 0; c < 3; c++) m[c][l] = normals[3 * i + c];
    }
    const v16 facing = (m[0] * ((r.x - k[2]) * k[0]) + m[1] * ((r.y - k[3]) * k[1]) + m[2]) * r.depth;
    r.good &= (r.depth > 0.0f) & (facing < 0.0f);
    const v16 scale = 1.0f / choose(r.good, facing, splat(1.0f));
    r.slope[0] = m[0] * k[0] * scale, r.slope[1] = m[1] * k[1] * scale;
    r.inverse = 1.0f / choose(r.good, r.depth, splat(1.0f));
    return r;
}

// The patches around pixels; lanes where there is nothing to match are marked.
static void load_patches(const Photo *p, Pixels *pixels, float jump, float texture, Patch *patch) {
    v16 sum = splat(0.0f), squares = splat(0.0f);
    patch->total = splat(0.0f);
    for (int k = 0; k < SAMPLES; k++) {
        const float dx = k % SIDE - RADIUS, dy = k / SIDE - RADIUS;
        const i16 at = pixels->at + ((k / SIDE - RADIUS) * (int32_t)p->width + k % SIDE - RADIUS);
        const v16 off =
            (v16)gather(p->depth, at) * (pixels->inverse + dx * pixels->slope[0] + dy * pixels->slope[1]) - 1.0f;
        // depth = 0 (unknown) differs by one from every plane.
        patch->weight[k] = keep((off < jump) & (off > -jump), splat(1.0f));
        patch->grey[k] = __builtin_convertvector(gather(p->quads, at) & 255, v16);
        patch->total += patch->weight[k], sum += patch->weight[k] * patch->grey[k];
    }
    pixels->good &= patch->total >= 0.5f * SAMPLES;
    patch->total = choose(pixels->good, patch->total, splat(1.0f));
    patch->mean = sum / patch->total;
    for (int k = 0; k < SAMPLES; k++) {
        patch->grey[k] = patch->weight[k] * (patch->grey[k] - patch->mean);
        squares += patch->grey[k] * patch->grey[k];
    }
    pixels->good &= squares > texture * texture * patch->total;
    patch->spread = vsqrt(squares);
}

// What takes the first photo's pixels to `o`, at their depths; `here` is m (x, y, 1).
static void carry(const Photo *o, const Pixels *pixels, v16 here[3]) {
    for (int r = 0; r < 3; r++)
        for (int l = 0; l < VECTOR; l++)
            here[r][l] = (float)(o->m[3 * r] * pixels->x[l] + o->m[3 * r + 1] * pixels->y[l] + o->m[3 * r + 2]);
}

static Homography at_depth(const Photo *o, const Pixels *pixels, const v16 here[3], v16 factor) {
    Homography h;
    for (int r = 0; r < 3; r++) {
        const v16 shift = factor * (float)o->b[r];
        h.centre[r] = here[r] + shift * pixels->inverse;
        h.across[r] = (float)o->m[3 * r] + shift * pixels->slope[0];
        h.down[r] = (float)o->m[3 * r + 1] + shift * pixels->slope[1];
    }
    return h;
}

// Lanes whose spot a photo sees, and nothing in front of it.
static i16 sees(const Photo *o, const Pixels *pixels, const v16 here[3], float hidden) {
    const Homography h = at_depth(o, pixels, here, splat(1.0f));
    i16 seen = pixels->good & (h.centre[2] > 0.0f);
    const v16 inverse = 1.0f / choose(seen, h.centre[2], splat(1.0f)), u = h.centre[0] * inverse,
              v = h.centre[1] * inverse;
    seen &= (u >= 0.0f) & (v >= 0.0f) & (u < (float)o->width) & (v < (float)o->height);
    const i16 x = __builtin_convertvector(keep(seen, u), i16), y = __builtin_convertvector(keep(seen, v), i16);
    const v16 depth = h.centre[2] * pixels->depth, off = (v16)gather(o->depth, y * (int32_t)o->width + x) - depth;
    return seen & (off < hidden * depth) & (off > -hidden * depth);
}

// Relative change of the inverse depth that moves a pixel by `length` where it moves the most, at most `limit`.
static v16 step_of(const Photo *others, int64_t count, const Pixels *pixels, float length, float limit) {
    v16 most = splat(1e-6f);
    for (int64_t n = 0; n < count; n++) {
        const Photo *o = others + n;
        v16 here[3];
        carry(o, pixels, here);
        const Homography h = at_depth(o, pixels, here, splat(1.0f));
        const i16 ahead = h.centre[2] > 0.0f;
        const v16 w = choose(ahead, h.centre[2], splat(1.0f)), scale = pixels->inverse / (w * w);
        const v16 du = ((float)o->b[0] * here[2] - (float)o->b[2] * here[0]) * scale;
        const v16 dv = ((float)o->b[1] * here[2] - (float)o->b[2] * here[1]) * scale;
        most = choose(ahead, vmax(vsqrt(du * du + dv * dv), most), most);
    }
    return vmin(length / most, splat(limit));
}

/* pixels [n]: y * width + x in `first`, where its depth is known; normals [n][3]: of the surface there, in the frame of
   the first camera, facing it; inverse_intrinsics: (1 / fx, 1 / fy, cx, cy) of the first.
   step [n] is set to the relative change of the inverse depth that moves a pixel by `length` in the neighbour where it
   moves the most; the tried inverse depths are those of the first depth map times (1 + (k - steps / 2) step[n]).
   scores [n][steps] are set to the sums of the correlations with the neighbours that had a say at every depth, counts
   [n] to their number. jump: share of the depth by which pixels of one surface differ from its plane at most; hidden:
   by which the neighbour's own depth may differ; texture: least deviation of brightness. */
MGF_API void mgf_match_photos(int32_t *next, int64_t n, const int32_t *pixels, const float *normals, float length,
                              int64_t steps, const Photo *first, const float *inverse_intrinsics, const Photo *others,
                              int64_t neighbours, float jump, float hidden, float texture, float *step, float *scores,
                              float *counts) {
    if (first->width < SIDE || first->height < SIDE || steps > MOST_STEPS) return;
    for (;;) {
        const int64_t start = take_work(next) * GROUPS * VECTOR,
                      end = start + GROUPS * VECTOR < n ? start + GROUPS * VECTOR : n;
        if (start >= n) return;
        for (int64_t i = start; i < end; i += VECTOR) {
            const int64_t lanes = end - i < VECTOR ? end - i : VECTOR;
            Pixels here = load_pixels(first, pixels + i, lanes, normals + 3 * i, inverse_intrinsics);
            const v16 stride = step_of(others, neighbours, &here, length, 0.5f / (float)steps);
            v16 sum[MOST_STEPS], number = splat(0.0f);
            for (int64_t s = 0; s < steps; s++) sum[s] = splat(0.0f);
            Patch patch;
            load_patches(first, &here, jump, texture, &patch);
            for (int64_t k = 0; k < neighbours; k++) {
                v16 at[3], found[MOST_STEPS];
                carry(others + k, &here, at);
                i16 said = sees(others + k, &here, at, hidden);
                for (int64_t s = 0; s < steps && any(said); s++) {
                    const Homography h = at_depth(others + k, &here, at, 1.0f + (float)(s - steps / 2) * stride);
                    const Place place = place_of(others + k, &h, said, 1.0f);
                    said = place.inside;
                    found[s] = correlate(&patch, &place, others + k, texture, 1.0f);
                }
                if (!any(said)) continue;
                for (int64_t s = 0; s < steps; s++) sum[s] += keep(said, found[s]);
                number += keep(said, splat(1.0f));
            }
            for (int64_t l = 0; l < lanes; l++) {
                step[i + l] = stride[l], counts[i + l] = number[l];
                for (int64_t s = 0; s < steps; s++) scores[(i + l) * steps + s] = sum[s][l];
            }
        }
    }
}
