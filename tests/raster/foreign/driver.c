// SPDX-License-Identifier: GPL-3.0-or-later
// Runs the rasterizer's kernels once, forward and backward, without Python: linked with them for another processor and run in an
// emulator by test_foreign.py. stdin: six int64 (n, width, height, degree, tiles_x, tiles_y), the packed camera, the parameters,
// gradients of the ten outputs; stdout: the twelve image planes, the five gradients.
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

void mgf_project(int32_t *, int64_t, const float *, const float *, const float *, const float *, const float *, const float *,
                 const float *, int64_t, int64_t, int64_t, const int32_t *, float *, void *, int32_t *, uint32_t *);
int64_t mgf_sort(int64_t, const uint32_t *, const int32_t *, int32_t *, int64_t *, uint32_t *);
void mgf_bin_count(int32_t *, int64_t, int64_t, const int32_t *, const void *, const uint8_t *, int64_t, int64_t, int32_t *);
void mgf_bin_ranges(int64_t, int64_t, int32_t *, int32_t *);
void mgf_bin_fill(int32_t *, int64_t, int64_t, const int32_t *, const void *, const uint8_t *, int64_t, int64_t, int32_t *,
                  const int64_t *, int32_t *, int32_t *);
void mgf_blend(int32_t *, int64_t, const float *, const float *, const int32_t *, const int32_t *, const int32_t *, int64_t, int64_t,
               float *, uint16_t *);
void mgf_blend_backward(int32_t *, int64_t, const float *, const float *, const int32_t *, const int32_t *, const int32_t *, int64_t,
                        const float *, const uint16_t *, const float *, const float *, const float *, const float *, const float *,
                        const float *, const float *, int64_t, int64_t, float *);
void mgf_project_backward(int32_t *, int64_t, const float *, const float *, const float *, const float *, const float *, const float *,
                          const float *, int64_t, const float *, const int32_t *, const int64_t *, const uint16_t *, const float *,
                          int64_t, float *, float *, float *, float *, float *, float *, float *, float *, float *, int32_t *);

static void *space(int64_t bytes) {
    void *p = aligned_alloc(64, (size_t)(bytes + 127) / 64 * 64);
    if (!p) exit(3);
    return memset(p, 0, (size_t)(bytes + 127) / 64 * 64);
}

static float *input(int64_t count) {
    float *p = space(4 * count);
    if (fread(p, 4, (size_t)count, stdin) != (size_t)count) exit(2);
    return p;
}

int main(void) {
    int64_t h[6];
    if (fread(h, 8, 6, stdin) != 6) return 2;
    const int64_t n = h[0], pixels = h[1] * h[2], degree = h[3], tx = h[4], ty = h[5], tiles = tx * ty, chunks = 4;
    const float *camera = input(32), *p = input(3 * n), *s = input(3 * n), *q = input(4 * n), *o = input(n), *sh = input(48 * n),
                *f = input(n), *g = input(10 * pixels);
    int32_t *sums = space(4 * ty * (tx + 1)), next = 0;
    uint8_t *mask = space(tiles);
    memset(mask, 1, (size_t)tiles);
    for (int64_t i = 0; i < ty * (tx + 1); i++) sums[i] = (int32_t)(i % (tx + 1));
    float *records = space(128 * n);
    void *footprints = space(32 * n);
    int32_t *counts = space(4 * n), *order = space(4 * n), *places = space(4 * chunks * tiles), *ranges = space(4 * tiles + 4);
    uint32_t *keys = space(4 * n), *scratch = space(12 * n);
    int64_t *starts = space(8 * n + 8);
    mgf_project(&next, n, camera, p, s, q, o, sh, f, degree, tx, ty, sums, records, footprints, counts, keys);
    const int64_t drawn = mgf_sort(n, keys, counts, order, starts, scratch), entries = starts[n];
    next = 0, mgf_bin_count(&next, chunks, drawn, order, footprints, mask, tx, ty, places);
    mgf_bin_ranges(chunks, tiles, places, ranges);
    int32_t *gid = space(4 * entries), *slots = space(4 * entries);
    next = 0, mgf_bin_fill(&next, chunks, drawn, order, footprints, mask, tx, ty, places, starts, gid, slots);
    float *image = space(12 * 256 * 4 * tiles), *slot_sums = space(96 * entries);
    uint16_t *hits = space(2 * entries);
    next = 0, mgf_blend(&next, tiles, camera, records, gid, slots, ranges, tx, 1, image, hits);
    next = 0, mgf_blend_backward(&next, tiles, camera, records, gid, slots, ranges, tx, image, hits, g, g + 3 * pixels, g + 4 * pixels,
                                 g + 5 * pixels, g + 6 * pixels, g + 9 * pixels, 0, 2, 0, slot_sums);
    float *out = space(4 * 59 * n);
    next = 0, mgf_project_backward(&next, n, camera, p, s, q, o, sh, f, degree, records, counts, starts, hits, slot_sums, 24, out,
                                   out + 3 * n, out + 6 * n, out + 10 * n, out + 11 * n, 0, 0, 0, 0, 0);
    fwrite(image, 4, (size_t)(12 * 256 * tiles), stdout);
    fwrite(out, 4, (size_t)(59 * n), stdout);
    return 0;
}
