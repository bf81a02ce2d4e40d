// SPDX-License-Identifier: GPL-3.0-or-later
// Poisson disks by greedy selection (dart throwing, Cook 1986): of points that are in each other's way the first stays.
#include <math.h>
#include <string.h>

#include "common/export.h"

typedef struct {
    int64_t slots;  // of the hash table, a power of two
    int32_t *head;  // last point kept in the cell of each slot, -1 for none
    int32_t *next;  // of each kept point, the one kept before it in its slot, -1 for none
    const double *points;
} Grid;

// Cells along x are neighbours in memory, too. Cells that share a slot only cost comparisons.
static int64_t slot_of(const Grid *grid, int64_t x, int64_t y, int64_t z) {
    uint64_t row = (uint64_t)y * 0x9E3779B97F4A7C15u ^ (uint64_t)z * 0xC2B2AE3D27D4EB4Fu;
    row ^= row >> 29, row *= 0xBF58476D1CE4E5B9u, row ^= row >> 32;
    return (int64_t)((row + (uint64_t)x) & (uint64_t)(grid->slots - 1));
}

static int is_free(const Grid *grid, int64_t slot, const double *p) {
    for (int32_t q = grid->head[slot]; q >= 0; q = grid->next[q]) {
        const double *other = grid->points + 3 * (int64_t)q;
        const double x = p[0] - other[0], y = p[1] - other[1], z = p[2] - other[2];
        if (x * x + y * y + z * z <= 1) return 0;
    }
    return 1;
}

// Selects the points (double[count][3], in radii) that are more than 1 from all points selected before them.
//
// head: int32_t[slots], where slots is a power of two, best twice the number of points that stay; next: int32_t[count].
// kept: uint8_t[count].
MGF_API void mgf_poisson_disk(int64_t count, const double *points, int64_t slots, int32_t *head, int32_t *next,
                              uint8_t *kept) {
    const Grid grid = {slots, head, next, points};
    memset(head, 0xff, (size_t)slots * sizeof *head);
    for (int64_t n = 0; n < count; n++) {
        const double *p = points + 3 * n;
        const int64_t x = (int64_t)floor(p[0]), y = (int64_t)floor(p[1]), z = (int64_t)floor(p[2]);
        int64_t own = slot_of(&grid, x, y, z);
        int open = is_free(&grid, own, p);
        for (int k = 0; open && k < 27; k++)
            if (k != 13) open = is_free(&grid, slot_of(&grid, x + k % 3 - 1, y + k / 3 % 3 - 1, z + k / 9 - 1), p);
        kept[n] = (uint8_t)open;
        if (open) next[n] = head[own], head[own] = (int32_t)n;
    }
}
