// SPDX-License-Identifier: GPL-3.0-or-later
// Where the samples of a surface fall in a view, and how far away it is seen first: the masks ask that of every photo
// in every round, for hundreds of thousands of samples.
#include "common/export.h"

enum { BLOCK = 512 };  // samples projected together

// Samples [3][count], and the matrix [3][4] that takes them into a map [height][width].
typedef struct {
    int64_t count, height, width;
    const float *samples, *matrix;
} Projection;

// Those of a block that lie before the camera and inside the frame, in their order.
typedef struct {
    int32_t row[BLOCK], place[BLOCK];  // which sample; its pixel y * width + x
    float depth[BLOCK], nearness[BLOCK];
} Seen;

// a * b + c, rounded once where the processor can.
static inline float fused(float a, float b, float c) {
#if defined(__FMA__) || defined(__aarch64__)
    return __builtin_fmaf(a, b, c);
#else
    return a * b + c;
#endif
}

// One row [4] of the matrix times (x, y, z, 1), added up from the left, as matrix products do.
static inline float times(const float *m, float x, float y, float z) {
    return fused(m[2], z, fused(m[1], y, m[0] * x)) + m[3];
}

static int64_t project_block(const Projection *p, int64_t first, Seen *seen) {
    float u[BLOCK], v[BLOCK], depth[BLOCK], nearness[BLOCK];
    const int64_t count = p->count - first < BLOCK ? p->count - first : BLOCK;
    const float *x = p->samples + first, *y = x + p->count, *z = y + p->count, *m = p->matrix;
    for (int64_t i = 0; i < count; i++) {
        depth[i] = times(m + 8, x[i], y[i], z[i]);
        nearness[i] = 1.0f / depth[i];
        u[i] = times(m, x[i], y[i], z[i]) * nearness[i];
        v[i] = times(m + 4, x[i], y[i], z[i]) * nearness[i];
    }
    const float width = p->width, height = p->height;
    int64_t found = 0;
    for (int64_t i = 0; i < count; i++) {
        const int inside = (depth[i] > 1e-6f) & (u[i] >= 0.0f) & (u[i] < width) & (v[i] >= 0.0f) & (v[i] < height);
        seen->row[found] = (int32_t)(first + i);
        seen->place[found] = inside ? (int32_t)v[i] * (int32_t)p->width + (int32_t)u[i] : 0;
        seen->depth[found] = depth[i], seen->nearness[found] = nearness[i];
        found += inside;
    }
    return found;
}

/* The samples [3][count] that a view sees by its matrix [3][4], in their order: their pixels y * width + x, depths, and
   radii, which are `unit` times the spacing [count] over the depth; [count] each, of which the first so many as are
   returned. */
MGF_API int64_t mgf_project_samples(int64_t count, const float *samples, const float *spacing, const float *matrix,
                                    int64_t height, int64_t width, float unit, int32_t *places, float *depths,
                                    float *radii) {
    const Projection p = {count, height, width, samples, matrix};
    Seen seen;
    int64_t total = 0;
    for (int64_t first = 0; first < count; first += BLOCK) {
        const int64_t found = project_block(&p, first, &seen);
        for (int64_t i = 0; i < found; i++) {
            places[total + i] = seen.place[i], depths[total + i] = seen.depth[i];
            radii[total + i] = spacing[seen.row[i]] * unit * seen.nearness[i];
        }
        total += found;
    }
    return total;
}

/* The least depth of the samples in each pixel of a view, by how large they look.

   Where a sample's depth is below so many of the limits [levels - 1], it goes into the map of that number, of nearest
   [levels][height][width], given as infinity. samples [3][count]; matrix [3][4]. Returns the maps used, a bit for each.
   */
MGF_API int64_t mgf_nearest_samples(int64_t count, const float *samples, const float *matrix, int64_t height,
                                    int64_t width, int64_t levels, const float *limits, float *nearest) {
    const Projection p = {count, height, width, samples, matrix};
    Seen seen;
    int64_t used = 0;
    for (int64_t first = 0; first < count; first += BLOCK) {
        const int64_t found = project_block(&p, first, &seen);
        for (int64_t i = 0; i < found; i++) {
            int64_t level = 0;
            for (int64_t k = 0; k < levels - 1; k++) level += seen.depth[i] < limits[k];
            float *held = nearest + level * height * width + seen.place[i];
            *held = seen.depth[i] < *held ? seen.depth[i] : *held;
            used |= (int64_t)1 << level;
        }
    }
    return used;
}
