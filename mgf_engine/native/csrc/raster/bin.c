// SPDX-License-Identifier: GPL-3.0-or-later
// From projected Gaussians to one list per tile, front to back.
//
// The Gaussians are sorted by the depth of their centres once (radix sort); walking through them in that order and
// appending each to the lists of the tiles it touches leaves every list sorted. To do so on several threads, the order
// is cut into chunks; a first pass counts how many entries each chunk adds to each tile, so that a second pass knows
// where to write.
//
// Every entry of a list also has a *slot*: its place in an order by Gaussian, where the backward pass leaves gradients.
// All results are independent of the number of threads.
#include <string.h>

#include "common/export.h"
#include "raster/footprint.h"

enum { RADIX_BITS = 11, RADIX = 1 << RADIX_BITS };

// Indices of the Gaussians with tiles, by depth (equal depths: by index), into order [n]; slot_starts [n + 1] is the
// running sum of tile_counts. scratch: uint32 [3 * n]. Returns the number of Gaussians in order.
MGF_API int64_t mgf_sort(int64_t n, const uint32_t *depth_keys, const int32_t *tile_counts, int32_t *order,
                         int64_t *slot_starts, uint32_t *scratch) {
    uint32_t *keys = scratch, *other_keys = scratch + n;
    int32_t *other = (int32_t *)(scratch + 2 * n), *items = order;
    int64_t count = 0, slots = 0;
    uint32_t histogram[3][RADIX];
    memset(histogram, 0, sizeof histogram);
    for (int64_t i = 0; i < n; i++) {
        slot_starts[i] = slots;
        if (!tile_counts[i]) continue;
        slots += tile_counts[i];
        const uint32_t key = depth_keys[i];
        for (int pass = 0; pass < 3; pass++) histogram[pass][(key >> (pass * RADIX_BITS)) & (RADIX - 1)]++;
        keys[count] = key, items[count++] = (int32_t)i;
    }
    slot_starts[n] = slots;
    for (int pass = 0; pass < 3; pass++) {
        uint32_t sum = 0, *place = histogram[pass];
        for (int b = 0; b < RADIX; b++) {
            const uint32_t size = place[b];
            place[b] = sum, sum += size;
        }
        for (int64_t i = 0; i < count; i++) {
            const uint32_t to = place[(keys[i] >> (pass * RADIX_BITS)) & (RADIX - 1)]++;
            other_keys[to] = keys[i], other[to] = items[i];
        }
        uint32_t *swap_keys = keys;
        keys = other_keys, other_keys = swap_keys;
        int32_t *swap = items;
        items = other, other = swap;
    }
    if (items != order) memcpy(order, items, (size_t)count * sizeof *order);
    return count;
}

// Bounds of one of `chunks` equal parts of 0..count.
static inline int64_t part(int64_t count, int64_t chunks, int64_t i) { return count * i / chunks; }

// The order jumps about in memory: footprints that come soon are fetched ahead.
static inline const Footprint *footprint_at(const Footprint *footprints, const int32_t *order, int64_t i, int64_t end) {
    enum { AHEAD = 12 };
    if (i + AHEAD < end) __builtin_prefetch(footprints + order[i + AHEAD]);
    return footprints + order[i];
}

// counts [chunks, tiles]: how many entries each chunk of the order adds to each tile.
MGF_API void mgf_bin_count(int32_t *next, int64_t chunks, int64_t count, const int32_t *order,
                           const Footprint *footprints, const uint8_t *mask, int64_t tiles_x, int64_t tiles_y,
                           int32_t *counts) {
    for (int64_t chunk; (chunk = take_work(next)) < chunks;) {
        int32_t *own = counts + chunk * tiles_x * tiles_y;
        memset(own, 0, (size_t)(tiles_x * tiles_y) * sizeof *own);
        const int64_t end = part(count, chunks, chunk + 1);
        for (int64_t i = part(count, chunks, chunk); i < end; i++) {
            const Footprint *p = footprint_at(footprints, order, i, end);
            int first_y, last_y, first, last;
            tile_rows(p, (int)tiles_y, &first_y, &last_y);
            for (int ty = first_y; ty <= last_y; ty++) {
                tile_columns(p, ty, (int)tiles_x, &first, &last);
                for (int64_t t = ty * tiles_x + first; t <= ty * tiles_x + last; t++) own[t] += mask[t];
            }
        }
    }
}

// ranges [tiles + 1]: where each tile's list starts; counts become the place where each chunk starts to write.
MGF_API void mgf_bin_ranges(int64_t chunks, int64_t tiles, int32_t *counts, int32_t *ranges) {
    int32_t sum = 0;
    for (int64_t t = 0; t < tiles; t++) {
        ranges[t] = sum;
        for (int64_t chunk = 0; chunk < chunks; chunk++) {
            const int32_t size = counts[chunk * tiles + t];
            counts[chunk * tiles + t] = sum, sum += size;
        }
    }
    ranges[tiles] = sum;
}

// The lists: gid (Gaussian) and slot of every entry.
MGF_API void mgf_bin_fill(int32_t *next, int64_t chunks, int64_t count, const int32_t *order,
                          const Footprint *footprints, const uint8_t *mask, int64_t tiles_x, int64_t tiles_y,
                          int32_t *places, const int64_t *slot_starts, int32_t *gid, int32_t *slots) {
    for (int64_t chunk; (chunk = take_work(next)) < chunks;) {
        int32_t *own = places + chunk * tiles_x * tiles_y;
        const int64_t end = part(count, chunks, chunk + 1);
        for (int64_t i = part(count, chunks, chunk); i < end; i++) {
            const Footprint *p = footprint_at(footprints, order, i, end);
            int32_t slot = (int32_t)slot_starts[order[i]];
            int first_y, last_y, first, last;
            tile_rows(p, (int)tiles_y, &first_y, &last_y);
            for (int ty = first_y; ty <= last_y; ty++) {
                tile_columns(p, ty, (int)tiles_x, &first, &last);
                for (int64_t t = ty * tiles_x + first; t <= ty * tiles_x + last; t++) {
                    if (!mask[t]) continue;
                    gid[own[t]] = order[i], slots[own[t]++] = slot++;
                }
            }
        }
    }
}
