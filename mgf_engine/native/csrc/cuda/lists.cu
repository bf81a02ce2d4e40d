// SPDX-License-Identifier: GPL-3.0-or-later
// From projected Gaussians to one list per tile, front to back.
//
// Walking through the Gaussians by depth, each appends one entry for every wanted tile that it touches; the number of
// an entry in that order is its *slot*, where the backward pass leaves gradients: the slots of a Gaussian lie side by
// side. A stable sort of the slots by tile (sort.cu) then gives lists that are sorted by depth, without a depth in the
// keys.
//
// The lists hold `capacity` entries at most, which the host chose without knowing how many there are: asking would mean
// waiting for the GPU in every iteration. A rendering that needs more draws nothing (tile_counts, lists and gradients
// are empty), leaves the number it needs in total[0], and the host raises the capacity
// (raster/cuda/tile_list_capacity.py).
//
// How many entries a Gaussian has was counted by another program (project.cu, points.cu), and the compiler may round
// the same formula differently here, where a footprint ends at the edge of a tile. So the count decides: a Gaussian
// never writes beyond its slots, and those it leaves over go to a tile after the last, which sorts to the end and which
// nobody draws.
#include "cuda/block.cuh"

#include "raster/footprint.h"

enum { NEEDED, LISTED };  // total[2]: entries there are; entries that fit the capacity, all of them or 0

// sums [blocks of 256]: entries of each block of the order.
KERNEL(list_sums, int n, const int *order, const int *tile_counts, int *sums) {
    SHARED int scratch[WARPS + 1];
    Own<int> count;
    PHASE {
        const int i = BLOCK_X * BLOCK + THREAD;
        *count = i < n ? tile_counts[order[i]] : 0;
    }
    const int all = scan_block(count, scratch);
    PHASE {
        if (THREAD == 0) sums[BLOCK_X] = all;
    }
}

// sums become the entries before each block. One block.
KERNEL(list_offsets, int blocks, int capacity, int *sums, int *total) {
    SHARED int scratch[WARPS + 1];
    Own<int> count;
    const int most = 0x7fffffff;
    long long before = 0;
    for (int first = 0; first < blocks; first += BLOCK) {
        PHASE { *count = first + THREAD < blocks ? sums[first + THREAD] : 0; }
        const int all = scan_block(count, scratch);
        PHASE {
            if (first + THREAD < blocks) sums[first + THREAD] = before + *count > most ? most : (int)(before + *count);
        }
        before += all;
    }
    PHASE {
        if (THREAD == 0)
            total[NEEDED] = before > most ? most : (int)before, total[LISTED] = before <= capacity ? (int)before : 0;
    }
}

// Per slot its tile and Gaussian, and hits zero; slot_starts [n] by Gaussian.
KERNEL(list_fill, int n, const int *order, const Footprint *footprints, const uint8_t *mask, int tiles_x, int tiles_y,
       const int *sums, const int *total, int *tile_counts, int *slot_starts, uint32_t *slot_tiles, int *slot_gid,
       uint8_t *hits) {
    SHARED int scratch[WARPS + 1];
    Own<int> slot;
    PHASE {
        const int i = BLOCK_X * BLOCK + THREAD;
        *slot = i < n ? tile_counts[order[i]] : 0;
    }
    scan_block(slot, scratch);
    PHASE {
        const int i = BLOCK_X * BLOCK + THREAD;
        if (i >= n) continue;
        const int gid = order[i];
        if (total[NEEDED] != total[LISTED]) tile_counts[gid] = 0;
        int at = sums[BLOCK_X] + *slot;
        slot_starts[gid] = at;
        const int end = at + tile_counts[gid];
        if (at == end) continue;
        const Footprint p = footprints[gid];
        int first_y, last_y, first, last;
        tile_rows(&p, tiles_y, &first_y, &last_y);
        for (int ty = first_y; ty <= last_y && at < end; ty++) {
            tile_columns(&p, ty, tiles_x, &first, &last);
            for (int t = ty * tiles_x + first; t <= ty * tiles_x + last && at < end; t++) {
                if (mask && !mask[t]) continue;
                slot_tiles[at] = t, slot_gid[at] = gid, hits[at] = 0;
                at++;
            }
        }
        for (; at < end; at++) slot_tiles[at] = tiles_x * tiles_y, slot_gid[at] = gid, hits[at] = 0;
    }
}

// ranges [tiles + 1]: where each tile's list starts in the sorted slots, and where the last one ends: before slots left
// over, whose tile is `tiles`. gid: the Gaussian of each slot.
KERNEL(list_ranges, int capacity, int tiles, const int *total, const uint32_t *sorted_tiles, const int *slots,
       const int *slot_gid, int *ranges, int *gid) {
    EACH(k, capacity + 1) {
        const int count = total[LISTED];
        if (k > count) continue;
        const int tile = k < count ? (int)sorted_tiles[k] : tiles, before = k ? (int)sorted_tiles[k - 1] : -1;
        for (int t = before + 1; t <= tile; t++) ranges[t] = k;
        if (k < count) gid[k] = slot_gid[slots[k]];
    }
}
