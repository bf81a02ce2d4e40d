// SPDX-License-Identifier: GPL-3.0-or-later
// What a walk through tetrahedra needs beside their corners: those around each point, and the neighbours. Both are
// written in their place: tetrahedra are many, and sorting their faces would take several times their memory.
#include "common/export.h"

enum { PIECE = 4096 };

/* Lists the tetrahedra [n] with corners [n][4] around each of the points [m], ascending: those of point v are
   list[around[v]] to list[around[v + 1]]; list [4 n], around [m + 1]. */
MGF_API void mgf_tetra_around(int64_t n, const int32_t *corner, int64_t m, int64_t *around, int32_t *list) {
    for (int64_t v = 0; v <= m; v++) around[v] = 0;
    for (int64_t i = 0; i < 4 * n; i++) around[corner[i]]++;
    for (int64_t v = 0, end = 0; v <= m; v++) end += around[v], around[v] = end;
    for (int64_t i = 4 * n - 1; i >= 0; i--) list[--around[corner[i]]] = (int32_t)(i / 4);
}

static int has(const int32_t *corner, int32_t v) {
    return corner[0] == v || corner[1] == v || corner[2] == v || corner[3] == v;
}

/* Finds the tetrahedron beyond each face, which is opposite of a corner: neighbour [n][4], -1 for none. `around` and
   `list` as mgf_tetra_around writes them. */
MGF_API void mgf_tetra_neighbours(int32_t *next, int64_t n, const int32_t *corner, const int64_t *around,
                                  const int32_t *list, int32_t *neighbour) {
    for (int64_t piece = take_work(next); piece * PIECE < n; piece = take_work(next)) {
        for (int64_t t = piece * PIECE; t < n && t < (piece + 1) * PIECE; t++) {
            for (int k = 0; k < 4; k++) {
                int32_t face[3], beyond = -1;
                for (int q = 0; q < 3; q++) face[q] = corner[4 * t + (k + 1 + q) % 4];
                // Of its corners the one with the fewest tetrahedra around: all have the one beyond among them.
                int least = 0;
                for (int q = 1; q < 3; q++)
                    if (around[face[q] + 1] - around[face[q]] < around[face[least] + 1] - around[face[least]])
                        least = q;
                const int32_t one = face[(least + 1) % 3], two = face[(least + 2) % 3];
                for (int64_t r = around[face[least]]; r < around[face[least] + 1] && beyond < 0; r++) {
                    const int32_t *other = corner + 4 * (int64_t)list[r];
                    if (list[r] != t && has(other, one) && has(other, two)) beyond = list[r];
                }
                neighbour[4 * t + k] = beyond;
            }
        }
    }
}
