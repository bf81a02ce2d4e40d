// SPDX-License-Identifier: GPL-3.0-or-later
// Which faces of a triangle mesh hang together, asked vertex by vertex.
//
// A *corner* is 3 * face + place. The corners around vertex v are corner[start[v]] to corner[start[v + 1] - 1]; the
// edge of a corner leads to the next vertex of its face. All faces along an edge are found around either of its ends,
// and around a vertex there are few: so nothing needs sorting, and every vertex can be asked by another thread.
#include "common/export.h"
#include "mesh/union_find.h"

enum { PIECE = 4096 };

typedef struct {
    const int32_t *faces, *start, *corner;
} Around;

// Vertices from .from up to .to, for one thread.
typedef struct {
    int64_t from, to;
} Piece;

static inline Piece take_piece(int32_t *next, int64_t vertices) {
    const int64_t from = take_work(next) * (int64_t)PIECE;
    return (Piece){from, from + PIECE < vertices ? from + PIECE : vertices};
}

static inline int32_t next_of(const int32_t *faces, int32_t c) { return faces[c % 3 == 2 ? c - 2 : c + 1]; }
static inline int32_t previous_of(const int32_t *faces, int32_t c) { return faces[c % 3 == 0 ? c + 2 : c - 1]; }

// How many faces around v have the edge to w.
static inline int uses(const Around *a, int64_t v, int32_t w) {
    int count = 0;
    for (int32_t i = a->start[v]; i < a->start[v + 1]; i++)
        count += (next_of(a->faces, a->corner[i]) == w) + (previous_of(a->faces, a->corner[i]) == w);
    return count;
}

/* Lists the corners around each vertex: start [vertices + 1], corner [3 * count], ascending around each. */
MGF_API void mgf_corners_around(int64_t vertices, int64_t count, const int32_t *faces, int32_t *start,
                                int32_t *corner) {
    for (int64_t v = 0; v <= vertices; v++) start[v] = 0;
    for (int64_t c = 0; c < 3 * count; c++) start[faces[c]]++;
    int32_t sum = 0;
    for (int64_t v = 0; v < vertices; v++) sum += start[v], start[v] = sum;
    start[vertices] = sum;
    for (int64_t c = 3 * count - 1; c >= 0; c--) corner[--start[faces[c]]] = (int32_t)c;
}

// Joins corners (numbered from 0 around v) across edges that two faces use in opposite directions. Tells whether an
// edge is used twice in one direction.
static int join_fans(const Around *a, int64_t v, int32_t *parent) {
    const int32_t count = a->start[v + 1] - a->start[v], *corner = a->corner + a->start[v];
    int twisted = 0;
    for (int32_t i = 0; i < count; i++) parent[i] = i;
    for (int32_t i = 0; i < count; i++) {
        const int32_t w = next_of(a->faces, corner[i]), u = previous_of(a->faces, corner[i]);
        int along = 0, against = 0, other = -1, back = 0;
        for (int32_t j = 0; j < count; j++) {
            const int32_t next = next_of(a->faces, corner[j]), previous = previous_of(a->faces, corner[j]);
            along += next == w, against += previous == w, back += previous == u;
            if (previous == w) other = j;
        }
        if (along == 1 && against == 1) join(parent, i, other);
        twisted |= along > 1 || back > 1;
    }
    return twisted;
}

/* Numbers the fans around each vertex, from 0: fan [3 * count] in the order of `corner`, fans [vertices] how many. */
MGF_API void mgf_vertex_fans(int32_t *next, int64_t vertices, const int32_t *faces, const int32_t *start,
                             const int32_t *corner, int32_t *fan, int32_t *fans) {
    const Around a = {faces, start, corner};
    for (Piece piece = take_piece(next, vertices); piece.from < vertices; piece = take_piece(next, vertices)) {
        for (int64_t v = piece.from; v < piece.to; v++) {
            int32_t *own = fan + start[v], number = 0;
            const int32_t count = start[v + 1] - start[v], *c = corner + start[v];
            const int twisted = join_fans(&a, v, own);
            for (int32_t i = 0; i < count; i++) {  // roots come first, and become -1 - their number
                if (own[i] == i) {
                    own[i] = -1 - number++;
                    continue;
                }
                int32_t r = own[i];
                while (r >= 0) r = own[r];
                own[i] = r;
            }
            for (int32_t i = 0; i < count; i++) own[i] = -1 - own[i];
            // Two faces of one fan that run along an edge in one direction are the ends of the fan: one of them leaves.
            for (int32_t i = 0; i < count && twisted; i++)
                for (int32_t j = i + 1; j < count; j++)
                    if (own[i] == own[j] && (next_of(faces, c[i]) == next_of(faces, c[j]) ||
                                             previous_of(faces, c[i]) == previous_of(faces, c[j])))
                        own[j] = number++;
            fans[v] = number;
        }
    }
}

/* Numbers the parts of a mesh that hang together by edges, in the order of their first faces: part [count]. */
MGF_API void mgf_face_components(int64_t vertices, int64_t count, const int32_t *faces, const int32_t *start,
                                 const int32_t *corner, int32_t *part) {
    for (int64_t f = 0; f < count; f++) part[f] = (int32_t)f;
    for (int64_t v = 0; v < vertices; v++)
        for (int32_t i = start[v]; i < start[v + 1]; i++) {
            const int32_t w = next_of(faces, corner[i]);
            for (int32_t j = start[v]; j < start[v + 1]; j++)
                if ((j > i && next_of(faces, corner[j]) == w) || (v < w && previous_of(faces, corner[j]) == w))
                    join(part, corner[i] / 3, corner[j] / 3);
        }
    int32_t number = 0;
    for (int64_t f = 0; f < count; f++) {
        const int32_t r = part[f];  // the first face of a part is its root, and has its number already
        part[f] = r == f ? -1 - number++ : r;
        while (part[f] >= 0) part[f] = part[part[f]];
    }
    for (int64_t f = 0; f < count; f++) part[f] = -1 - part[f];
}

/* Marks the corners whose edge no other face uses: open [3 * count]. */
MGF_API void mgf_open_edges(int32_t *next, int64_t vertices, const int32_t *faces, const int32_t *start,
                            const int32_t *corner, uint8_t *open) {
    const Around a = {faces, start, corner};
    for (Piece piece = take_piece(next, vertices); piece.from < vertices; piece = take_piece(next, vertices)) {
        for (int64_t v = piece.from; v < piece.to; v++)
            for (int32_t i = start[v]; i < start[v + 1]; i++)
                open[corner[i]] = uses(&a, v, next_of(faces, corner[i])) == 1;
    }
}

/* Moves vertices [vertices][3] half way to the mean of their neighbours, but for those that are fixed. */
MGF_API void mgf_smooth_vertices(int32_t *next, int64_t vertices, const int32_t *faces, const int32_t *start,
                                 const int32_t *corner, const uint8_t *fixed, const double *at, double *moved) {
    for (Piece piece = take_piece(next, vertices); piece.from < vertices; piece = take_piece(next, vertices)) {
        for (int64_t v = piece.from; v < piece.to; v++) {
            double sum[3] = {0, 0, 0};
            int count = 0;
            for (int32_t i = start[v]; i < start[v + 1] && !fixed[v]; i++) {
                const int32_t w[2] = {next_of(faces, corner[i]), previous_of(faces, corner[i])};
                int known[2] = {0, 0};  // each neighbour counts once
                for (int32_t j = start[v]; j < start[v + 1]; j++) {
                    const int32_t n = next_of(faces, corner[j]);
                    known[0] |= j < i && n == w[0];
                    known[1] |= n == w[1] || (j < i && previous_of(faces, corner[j]) == w[1]);
                }
                for (int k = 0; k < 2; k++) {
                    if (known[k]) continue;
                    for (int c = 0; c < 3; c++) sum[c] += at[3 * (int64_t)w[k] + c];
                    count++;
                }
            }
            for (int c = 0; c < 3; c++) {
                const double here = at[3 * v + c];
                moved[3 * v + c] = count ? here + 0.5 / count * (sum[c] - count * here) : here;
            }
        }
    }
}

/* Sums of the normals of the faces around each vertex, weighted by twice their areas: normal [vertices][3]. */
MGF_API void mgf_vertex_normals(int32_t *next, int64_t vertices, const int32_t *faces, const int32_t *start,
                                const int32_t *corner, const double *at, double *normal) {
    for (Piece piece = take_piece(next, vertices); piece.from < vertices; piece = take_piece(next, vertices)) {
        for (int64_t v = piece.from; v < piece.to; v++) {
            double sum[3] = {0, 0, 0};
            for (int32_t i = start[v]; i < start[v + 1]; i++) {
                const int32_t *f = faces + corner[i] / 3 * (int64_t)3;
                const double *p = at + 3 * (int64_t)f[0], *q = at + 3 * (int64_t)f[1], *r = at + 3 * (int64_t)f[2];
                const double a[3] = {q[0] - p[0], q[1] - p[1], q[2] - p[2]},
                             b[3] = {r[0] - p[0], r[1] - p[1], r[2] - p[2]};
                for (int k = 0; k < 3; k++) sum[k] += a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3];
            }
            for (int k = 0; k < 3; k++) normal[3 * v + k] = sum[k];
        }
    }
}
