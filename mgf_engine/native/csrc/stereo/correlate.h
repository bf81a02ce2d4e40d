// SPDX-License-Identifier: GPL-3.0-or-later
// Normalised cross-correlation of patches of one photo with where a plane carries them in another, sixteen at a time.
#pragma once
#include "common/vector.h"

enum { RADIUS = 2, SIDE = 2 * RADIUS + 1, SAMPLES = SIDE * SIDE };  // of a patch, in samples

// A photo with the surface it shows, [height][width] each; m, b take pixels of the first photo to this one:
// (u, v, 1) ~ m (x, y, 1) + b / depth.
typedef struct {
    const uint32_t *quads;  // brightness 0..255 of a pixel, and in the higher bytes of those right, below, below right
    const float *depth;     // 0 where unknown
    int64_t height, width;
    double m[9], b[3];
} Photo;

typedef struct {
    v16 weight[SAMPLES], grey[SAMPLES];  // is the pixel on the plane? its brightness less the mean, times the weight
    v16 total, mean, spread;             // sum of weights, mean, square root of the sum of squares about it
} Patch;

// Where a lane's pixel falls in a photo: (u, v, 1) ~ centre + dx * across + dy * down, for one depth.
typedef struct {
    v16 centre[3], across[3], down[3];
} Homography;

// Where a patch falls in a photo: u = at[0] + dx across[0] + dy down[0] pixels from the middle of its first pixel, v
// alike.
//
// The homography is replaced by its derivative at the middle of the patch: what that leaves out goes with the square of
// the patch's size by the distance, hundredths of a pixel.
typedef struct {
    v16 at[2], across[2], down[2];
    i16 inside;  // lanes that lie in the picture as a whole; the others stand still at one pixel
} Place;

static Place place_of(const Photo *o, const Homography *h, i16 good, float spacing) {
    Place p;
    p.inside = good & (h->centre[2] > 0.0f);
    const v16 inverse = 1.0f / choose(p.inside, h->centre[2], splat(1.0f));
    for (int r = 0; r < 2; r++) {
        const v16 middle = h->centre[r] * inverse;
        p.at[r] = middle - 0.5f;
        p.across[r] = (h->across[r] - middle * h->across[2]) * inverse;
        p.down[r] = (h->down[r] - middle * h->down[2]) * inverse;
        const v16 reach = (float)RADIUS * spacing * (vmax(p.across[r], -p.across[r]) + vmax(p.down[r], -p.down[r]));
        const float limit = (float)(r ? o->height : o->width) - 1.0f;
        p.inside &= (p.at[r] - reach >= 0.0f) & (p.at[r] + reach < limit);
    }
    for (int r = 0; r < 2; r++)
        p.at[r] = keep(p.inside, p.at[r]), p.across[r] = keep(p.inside, p.across[r]),
        p.down[r] = keep(p.inside, p.down[r]);
    return p;
}

// Correlation of the patches, whose samples are `spacing` pixels apart, with those at `place`; anything in lanes that
// are not inside.
static v16 correlate(const Patch *patch, const Place *place, const Photo *o, float texture, float spacing) {
    v16 sum = splat(0.0f), squares = splat(0.0f), products = splat(0.0f);
    for (int k = 0; k < SAMPLES; k++) {
        const float dx = spacing * (k % SIDE - RADIUS), dy = spacing * (k / SIDE - RADIUS);
        const v16 u = place->at[0] + (dx * place->across[0] + dy * place->down[0]);
        const v16 v = place->at[1] + (dx * place->across[1] + dy * place->down[1]);
        const i16 i = __builtin_convertvector(u, i16), j = __builtin_convertvector(v, i16);
        const v16 a = u - __builtin_convertvector(i, v16), b = v - __builtin_convertvector(j, v16);
        const i16 quad = gather(o->quads, j * (int32_t)o->width + i);
        const v16 p = __builtin_convertvector(quad & 255, v16), q = __builtin_convertvector(quad >> 8 & 255, v16);
        const v16 r = __builtin_convertvector(quad >> 16 & 255, v16),
                  s = __builtin_convertvector(quad >> 24 & 255, v16);
        const v16 top = p + a * (q - p), bottom = r + a * (s - r), value = top + b * (bottom - top) - patch->mean;
        const v16 weighted = patch->weight[k] * value;
        sum += weighted, squares += weighted * value, products += patch->grey[k] * value;
    }
    squares -= sum * sum / patch->total;
    const i16 rich = squares > texture * texture * patch->total;
    return choose(rich, products / (patch->spread * vsqrt(squares)), splat(-1.0f));
}
