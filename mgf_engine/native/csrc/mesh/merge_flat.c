// SPDX-License-Identifier: GPL-3.0-or-later
// Vertices of one cell that are joined by edges and lie in one plane: which they are, and where the one lies that
// stands for all of them (vertex clustering after Rossignac and Borrel 1993, told by topology and flatness instead of
// place alone).
//
// A group may become one vertex only where it is a disc: vertices - edges + faces == 1. Rings around thin bars, bubbles
// and handles are none, so nothing closes, and no bar is lost.
#include <stdlib.h>

#include "common/export.h"
#include "mesh/union_find.h"
#include "mesh/triangle.h"

typedef struct {
    int32_t vertices, half_edges, faces;  // those that lie in the group with all their vertices
    int32_t first, fold;                  // its first vertex; whether a face would turn over
    double even;  // sum of the areas of the faces around; then length of their mean normal, 0..1
    double off, tolerance;                // mean square distance from the plane, root of the largest one allowed
    Point normal, middle;                 // of the plane; sums first
} Group;

typedef struct {
    int64_t vertices, count;
    const Point *at;
    const int32_t *faces;
    int32_t *of;  // group of each vertex
    Group *groups;
} Groups;

// Numbers the sets in the order of their first vertices; returns how many there are.
static int32_t number(int32_t *of, int64_t vertices) {
    int32_t sets = 0;
    for (int64_t v = 0; v < vertices; v++) of[v] = root(of, (int32_t)v);
    for (int64_t v = 0; v < vertices; v++) of[v] = of[v] == v ? -1 - sets++ : of[of[v]];  // roots come first
    for (int64_t v = 0; v < vertices; v++) of[v] = -1 - of[v];
    return sets;
}

static Point normal_of(const int32_t *face, const Point *at) {
    return cross(minus(at[face[1]], at[face[0]]), minus(at[face[2]], at[face[0]]));
}

// Adds up faces and vertices; the first vertex of a group speaks for its tolerance.
static void add_up(const Groups *g, const float *tolerance) {
    for (int64_t f = 0; f < g->count; f++) {
        const int32_t *face = g->faces + 3 * f;
        const Point normal = normal_of(face, g->at);
        const double area = sqrt(dot(normal, normal));
        int inside = 0;
        for (int k = 0; k < 3; k++) {
            Group *own = g->groups + g->of[face[k]];
            const int same = g->of[face[(k + 1) % 3]] == g->of[face[k]];
            inside += same, own->half_edges += same;
            own->even += area, own->normal = plus(own->normal, normal, 1);
        }
        if (inside == 3) g->groups[g->of[face[0]]].faces++;
    }
    for (int64_t v = 0; v < g->vertices; v++) {
        Group *own = g->groups + g->of[v];
        if (own->vertices++ == 0) own->first = (int32_t)v, own->tolerance = tolerance[v];
        own->middle = plus(own->middle, g->at[v], 1);
    }
}

static void measure_planes(const Groups *g, int64_t sets) {
    for (int64_t i = 0; i < sets; i++) {
        Group *own = g->groups + i;
        const Point zero = {0, 0, 0};
        const double length = sqrt(dot(own->normal, own->normal));
        own->middle = plus(zero, own->middle, 1.0 / own->vertices);
        own->even = own->even > 0 ? length / own->even : 0;
        own->normal = plus(zero, own->normal, length > 0 ? 1 / length : 0);
    }
    for (int64_t v = 0; v < g->vertices; v++) {
        Group *own = g->groups + g->of[v];
        const double off = dot(own->normal, minus(g->at[v], own->middle));
        own->off += off * off / own->vertices;
    }
}

static int is_disc(const Group *g) {
    return g->half_edges % 2 == 0 && g->vertices - g->half_edges / 2 + g->faces == 1;
}

// Whether a group becomes one vertex.
static int merges(const Group *g, double even) {
    return g->vertices > 1 && !g->fold && is_disc(g) && g->even >= even && g->off <= g->tolerance * g->tolerance;
}

// Marks groups that would turn a face over.
static void find_folds(const Groups *g, float even) {
    for (int64_t f = 0; f < g->count; f++) {
        const int32_t *face = g->faces + 3 * f;
        const int32_t a = g->of[face[0]], b = g->of[face[1]], c = g->of[face[2]];
        if (a == b || b == c || c == a) continue;
        Point moved[3];
        for (int k = 0; k < 3; k++) {
            const Group *own = g->groups + g->of[face[k]];
            moved[k] = merges(own, even) ? own->middle : g->at[face[k]];
        }
        const Point now = cross(minus(moved[1], moved[0]), minus(moved[2], moved[0]));
        if (dot(now, normal_of(face, g->at)) > 0) continue;
        for (int k = 0; k < 3; k++) g->groups[g->of[face[k]]].fold = 1;
    }
}

/* The vertex that stands for each of `vertices`: into [vertices], and where it lies, at [vertices][3] in place;
   vertices that stand for themselves keep their place. Returns 0, or -1 without memory.
   cell: [vertices]; tolerance: root mean square distance from the plane [vertices]; even: least length of the mean of
   the normals of a group's faces. */
MGF_API int64_t mgf_merge_flat(int64_t vertices, int64_t count, Point *at, const int32_t *faces, const int32_t *cell,
                               const float *tolerance, float even, int32_t *into) {
    for (int64_t v = 0; v < vertices; v++) into[v] = (int32_t)v;
    for (int64_t c = 0; c < 3 * count; c++) {
        const int32_t a = faces[c], b = faces[c % 3 == 2 ? c - 2 : c + 1];
        if (cell[a] == cell[b]) join(into, a, b);
    }
    const int32_t sets = number(into, vertices);
    Group *groups = calloc((size_t)sets + 1, sizeof(Group));
    if (!groups) return -1;
    const Groups g = {vertices, count, at, faces, into, groups};
    add_up(&g, tolerance), measure_planes(&g, sets), find_folds(&g, even);
    for (int64_t v = 0; v < vertices; v++) {
        const Group *own = groups + into[v];
        const int merged = merges(own, even);
        if (merged) at[v] = own->middle;
        into[v] = merged ? own->first : (int32_t)v;
    }
    free(groups);
    return 0;
}
