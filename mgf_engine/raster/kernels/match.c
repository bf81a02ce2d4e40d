// SPDX-License-Identifier: GPL-3.0-or-later
// How alike a photo and its neighbour look around a pixel, for several depths of the surface there: normalised
// cross-correlation of a patch, carried over by the plane through the surface (plane sweep with known normals; Collins
// 1996, Gallup et al. 2007).
//
// Brightness and contrast drop out of the measure, so photos of other exposure compare as well.
#include <string.h>

#include "export.h"

enum { PIECE = 64, RADIUS = 2, SIDE = 2 * RADIUS + 1, SAMPLES = SIDE * SIDE, PADDED = 32, MOST_STEPS = 33 };

// A photo with its rendered surface; grey [height][width] in 0..1, depth [height][width], 0 where unknown.
typedef struct {
    const float *grey, *depth;
    int64_t height, width;
} Picture;

typedef struct {
    float grey[PADDED], weight[PADDED];
    float total, mean, spread;  // sum of weights, weighted mean, square root of the weighted sum of squares about it
} Patch;

// The pixels around (x, y) that lie on the plane `plane` . (x, y, 1) = 1 / depth; 0 when there is nothing to match.
static int load_patch(const Picture *p, int64_t x, int64_t y, const float *plane, float jump, float texture, Patch *patch) {
    if (x < RADIUS || y < RADIUS || x + RADIUS >= p->width || y + RADIUS >= p->height) return 0;
    memset(patch, 0, sizeof *patch);
    float sum = 0;
    for (int k = 0; k < SAMPLES; k++) {
        const int64_t px = x + k % SIDE - RADIUS, py = y + k / SIDE - RADIUS, i = py * p->width + px;
        const float inverse = plane[0] * (px + 0.5f) + plane[1] * (py + 0.5f) + plane[2];
        // depth = 0 (unknown) differs by one from every plane.
        patch->weight[k] = __builtin_fabsf(p->depth[i] * inverse - 1.0f) < jump ? 1.0f : 0.0f;
        patch->grey[k] = p->grey[i];
        patch->total += patch->weight[k], sum += patch->weight[k] * p->grey[i];
    }
    if (patch->total < 0.5f * SAMPLES) return 0;
    patch->mean = sum / patch->total;
    float squares = 0;
    for (int k = 0; k < SAMPLES; k++) {
        const float d = patch->grey[k] - patch->mean;
        squares += patch->weight[k] * d * d;
    }
    patch->spread = __builtin_sqrtf(squares);
    return squares > texture * texture * patch->total;
}

// Correlation of a patch with `other` seen through `h` (pixel of the one -> of the other, row-major); -2 out of frame.
static float correlate(const Patch *patch, int64_t x, int64_t y, const float *h, const Picture *other, float texture) {
    float u[PADDED], v[PADDED], low_u = 1e30f, high_u = -1e30f, low_v = 1e30f, high_v = -1e30f, low_w = 1e30f;
    for (int k = 0; k < PADDED; k++) {
        const int s = k < SAMPLES ? k : 0;
        const float a = x + s % SIDE - RADIUS + 0.5f, b = y + s / SIDE - RADIUS + 0.5f;
        const float w = h[6] * a + h[7] * b + h[8], inverse = 1.0f / w;
        u[k] = (h[0] * a + h[1] * b + h[2]) * inverse - 0.5f, v[k] = (h[3] * a + h[4] * b + h[5]) * inverse - 0.5f;
        low_w = w < low_w ? w : low_w;
        low_u = u[k] < low_u ? u[k] : low_u, high_u = u[k] > high_u ? u[k] : high_u;
        low_v = v[k] < low_v ? v[k] : low_v, high_v = v[k] > high_v ? v[k] : high_v;
    }
    if (!(low_w > 0 && low_u >= 0 && low_v >= 0 && high_u < other->width - 1 && high_v < other->height - 1)) return -2.0f;
    const float *grey = other->grey;
    const int32_t width = (int32_t)other->width;
    float sum = 0, squares = 0, products = 0;
    for (int k = 0; k < PADDED; k++) {
        const int32_t i = (int32_t)u[k], j = (int32_t)v[k], at = j * width + i;
        const float a = u[k] - i, b = v[k] - j;
        const float top = grey[at] + a * (grey[at + 1] - grey[at]);
        const float bottom = grey[at + width] + a * (grey[at + width + 1] - grey[at + width]);
        const float value = top + b * (bottom - top) - patch->mean, weighted = patch->weight[k] * value;
        sum += weighted, squares += weighted * value, products += weighted * (patch->grey[k] - patch->mean);
    }
    squares -= sum * sum / patch->total;
    if (!(squares > texture * texture * patch->total)) return -1.0f;
    return products / (patch->spread * __builtin_sqrtf(squares));
}

/* Adds to scores [n][steps] the correlation of one neighbour, and 1 to counts [n] where it had a say at every depth.
   pixels [n]: y * width + x in `first`; normals [n][3]: of the surface there, in the frame of the first camera, facing it.
   The tried inverse depths are those of the first depth map times (1 + (k - steps / 2) step[n]).
   between: what takes a pixel to the other picture, 9 + 3 numbers M, b: (u, v, 1) ~ M (x, y, 1) + b / depth;
   inverse_intrinsics: (1 / fx, 1 / fy, cx, cy) of the first. jump: share of the depth by which pixels of one surface
   differ from its plane at most; hidden: by which the neighbour's own depth may differ; texture: least deviation of grey. */
MGF_API void match_depths_work(int32_t *next, int64_t n, const int32_t *pixels, const float *normals, const float *step,
                               int64_t steps, const float *first_grey, const float *first_depth, int64_t first_height,
                               int64_t first_width, const float *inverse_intrinsics, const double *between,
                               const float *other_grey, const float *other_depth, int64_t other_height,
                               int64_t other_width, float jump, float hidden, float texture, float *scores,
                               float *counts) {
    const Picture first = {first_grey, first_depth, first_height, first_width};
    const Picture other = {other_grey, other_depth, other_height, other_width};
    const float *k = inverse_intrinsics;
    for (;;) {
        const int64_t start = take_work(next) * PIECE, end = start + PIECE < n ? start + PIECE : n;
        if (start >= n) return;
        for (int64_t i = start; i < end; i++) {
            const int64_t x = pixels[i] % first.width, y = pixels[i] / first.width;
            const float depth = first.depth[pixels[i]], *m = normals + 3 * i;
            // The plane through the point with that normal: 1 / depth is linear in the pixel.
            const float rx = (x + 0.5f - k[2]) * k[0], ry = (y + 0.5f - k[3]) * k[1];
            const float facing = (m[0] * rx + m[1] * ry + m[2]) * depth;
            if (!(depth > 0 && facing < 0)) continue;
            const float plane[3] = {m[0] * k[0] / facing, m[1] * k[1] / facing,
                                    (m[2] - m[0] * k[2] * k[0] - m[1] * k[3] * k[1]) / facing};
            // Does the neighbour see this spot, or something in front of it?
            double q[3];
            for (int r = 0; r < 3; r++)
                q[r] = (between[3 * r] * (x + 0.5) + between[3 * r + 1] * (y + 0.5) + between[3 * r + 2]) * depth + between[9 + r];
            if (!(q[2] > 0)) continue;
            const double u = q[0] / q[2], v = q[1] / q[2];
            if (!(u >= 0 && v >= 0 && u < other.width && v < other.height)) continue;
            const float seen = other.depth[(int64_t)v * other.width + (int64_t)u];
            if (!(__builtin_fabs(seen - q[2]) < hidden * q[2])) continue;
            Patch patch;
            if (!load_patch(&first, x, y, plane, jump, texture, &patch)) continue;
            float found[MOST_STEPS];
            int64_t s = 0;
            for (; s < steps; s++) {
                const float factor = 1.0f + (float)(s - steps / 2) * step[i];
                float h[9];
                for (int r = 0; r < 9; r++) h[r] = (float)(between[r] + between[9 + r / 3] * plane[r % 3] * factor);
                found[s] = correlate(&patch, x, y, h, &other, texture);
                if (found[s] < -1.5f) break;
            }
            if (s < steps) continue;
            for (s = 0; s < steps; s++) scores[i * steps + s] += found[s];
            counts[i] += 1.0f;
        }
    }
}
