// SPDX-License-Identifier: GPL-3.0-or-later
// Stable radix sort of 32-bit keys with 32-bit values, eight bits a pass, least significant first: three kernels a
// pass.
//
//   radix_count    how often each digit occurs in each run of 1024 items
//   radix_rows     per digit, the running sum of those counts over the runs
//   radix_scatter  every item to its place: digits before its own, runs before its own, then its rank within the run
//
// How many items there are may be known on the GPU alone: `listed` points at the number (null: all n), n is the
// capacity. Ranks come from the votes of warps, not from atomics, so equal keys keep their order and the result is the
// same every time.
#include "cuda/block.cuh"

#include <stdint.h>

enum {
    DIGITS = 256,
    EACH_LANE = 4,
    RUN = BLOCK * EACH_LANE
};  // a warp of a run has 128 items, a lane every 32nd of them

static inline int item_of(int j) { return BLOCK_X * RUN + THIS_WARP * WARP * EACH_LANE + j * WARP + THIS_LANE; }

// counts [256, runs]; grid: runs.
KERNEL(radix_count, int n, const int *listed, int runs, const uint32_t *keys, int shift, int *counts) {
    SHARED int found[DIGITS];
    const int count = listed ? *listed : n;
    PHASE { found[THREAD] = 0; }
    PHASE {
        for (int j = 0; j < EACH_LANE; j++) {
            const int i = item_of(j);
            if (i < count) add_atomic(found + ((keys[i] >> shift) & (DIGITS - 1)), 1);
        }
    }
    PHASE { counts[THREAD * runs + BLOCK_X] = found[THREAD]; }
}

// counts become sums over the runs before; totals [256]. grid: 256, a block a digit.
KERNEL(radix_rows, int runs, int *counts, int *totals) {
    SHARED int scratch[WARPS + 1];
    int *row = counts + BLOCK_X * runs, before = 0;
    Own<int> value;
    for (int first = 0; first < runs; first += BLOCK) {
        PHASE { *value = first + THREAD < runs ? row[first + THREAD] : 0; }
        const int all = scan_block(value, scratch);
        PHASE {
            if (first + THREAD < runs) row[first + THREAD] = before + *value;
        }
        before += all;
    }
    PHASE {
        if (THREAD == 0) totals[BLOCK_X] = before;
    }
}

// values null: the items' own numbers. grid: runs.
KERNEL(radix_scatter, int n, const int *listed, int runs, const uint32_t *keys, const int *values, int shift,
       const int *counts, const int *totals, uint32_t *sorted_keys, int *sorted_values) {
    SHARED int places[WARPS][DIGITS], scratch[WARPS + 1];
    struct Items {
        uint32_t key[EACH_LANE];
        int value[EACH_LANE], rank[EACH_LANE];
    };
    Own<Items> items;
    Own<unsigned> digit, peers;
    Own<int> start;
    const int count = listed ? *listed : n;
    if (BLOCK_X * RUN >= count) return;
    PHASE {
        for (int w = 0; w < WARPS; w++) places[w][THREAD] = 0;
        *start = totals[THREAD];
    }
    scan_block(start, scratch);  // thread d: where digit d begins
    EACH_WARP {
        for (int j = 0; j < EACH_LANE; j++) {
            LANES {
                const int i = item_of(j);
                items->key[j] = i < count ? keys[i] : 0;
                items->value[j] = i < count && values ? values[i] : i;
                // those beyond are no one's peers
                *digit = i < count ? (items->key[j] >> shift) & (DIGITS - 1) : DIGITS + THIS_LANE;
            }
            match_lanes(digit, peers);
            LANES {
                if (*digit < DIGITS) items->rank[j] = places[THIS_WARP][*digit] + bits_set(*peers & lanes_before());
            }
            LANES {
                if (*digit < DIGITS && !(*peers & lanes_before())) places[THIS_WARP][*digit] += bits_set(*peers);
            }
        }
    }
    PHASE {  // thread d: counts of its digit per warp become places
        int place = *start + counts[THREAD * runs + BLOCK_X];
        for (int w = 0; w < WARPS; w++) {
            const int size = places[w][THREAD];
            places[w][THREAD] = place, place += size;
        }
    }
    PHASE {
        for (int j = 0; j < EACH_LANE; j++) {
            if (item_of(j) >= count) continue;
            const int to = places[THIS_WARP][(items->key[j] >> shift) & (DIGITS - 1)] + items->rank[j];
            sorted_keys[to] = items->key[j], sorted_values[to] = items->value[j];
        }
    }
}
