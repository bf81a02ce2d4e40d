// SPDX-License-Identifier: GPL-3.0-or-later
// The mesh that collapse.c reduces: its vertices, faces and samples as lists, and the heap of edges, cheapest first.
#pragma once
#include <stdlib.h>
#include <string.h>

#include "mesh/triangle.h"

static const double RIM = 10;  // weight of the planes that hold an open rim

typedef struct {
    float cost;
    int32_t a, b, stamp;
} Entry;

typedef struct {
    int32_t sample, face;  // where a sample would lie after the collapse that is tried
} Place;

typedef struct {
    int64_t vertices, faces, live;
    Point *at;
    float (*color)[3];
    int32_t (*face)[3];      // corner 0 is -1 where a face is gone
    int32_t *first, *next;   // the corners of each vertex as a list; a corner is 3 * face + place
    int32_t *stamp;          // changes with the vertex; -1: gone
    Quadric *quadric;
    uint8_t *rim, *touched;  // touched: something around the vertex changed since the last sweep began
    const uint8_t *slab;     // of each vertex, and the one this thread works on
    uint8_t own;
    const float *given, *tolerance;  // samples: place, tolerance,
    const uint8_t *given_color;
    int32_t *held, *after;   // and those on each face as a list
    Entry *heap;
    int64_t entries, capacity;
    Place *place;
    int64_t places, place_capacity;
    double loose, color_tolerance;   // factor on the tolerances; negative: colours do not matter
    int failed;
} Mesh;

static Point given(const Mesh *m, int32_t i) {
    return (Point){m->given[3 * i], m->given[3 * i + 1], m->given[3 * i + 2]};
}

static double tolerance(const Mesh *m, int32_t i) { return m->loose * m->tolerance[i]; }

/* Heap of edges. */

static int before(const Entry *a, const Entry *b) {
    if (a->cost != b->cost) return a->cost < b->cost;
    return a->a != b->a ? a->a < b->a : a->b < b->b;
}

static void push(Mesh *m, Entry entry) {
    if (m->entries == m->capacity) {
        const int64_t capacity = m->capacity + m->capacity / 2 + 1024;
        Entry *grown = realloc(m->heap, (size_t)capacity * sizeof(Entry));
        if (!grown) {
            m->failed = 1;
            return;
        }
        m->heap = grown, m->capacity = capacity;
    }
    int64_t i = m->entries++;
    for (; i > 0 && before(&entry, m->heap + (i - 1) / 2); i = (i - 1) / 2) m->heap[i] = m->heap[(i - 1) / 2];
    m->heap[i] = entry;
}

static Entry pop(Mesh *m) {
    const Entry top = m->heap[0], last = m->heap[--m->entries];
    int64_t i = 0;
    for (;;) {
        int64_t child = 2 * i + 1;
        if (child >= m->entries) break;
        if (child + 1 < m->entries && before(m->heap + child + 1, m->heap + child)) child++;
        if (!before(m->heap + child, &last)) break;
        m->heap[i] = m->heap[child], i = child;
    }
    if (m->entries) m->heap[i] = last;
    return top;
}

/* Setting up. */

// How many faces share the edge of a and b.
static int uses(const Mesh *m, int32_t a, int32_t b) {
    int count = 0;
    for (int32_t c = m->first[a]; c >= 0; c = m->next[c]) {
        const int32_t *f = m->face[c / 3];
        count += f[0] == b || f[1] == b || f[2] == b;
    }
    return count;
}

// Adds a face to its corners' quadrics; marks open rims, and chooses the face that holds each vertex as a sample.
static void add_face(Mesh *m, int64_t i) {
    const int32_t *f = m->face[i];
    const Point *p[3] = {m->at + f[0], m->at + f[1], m->at + f[2]};
    const Point normal = cross(minus(*p[1], *p[0]), minus(*p[2], *p[0]));
    const double twice = sqrt(dot(normal, normal));
    const Point unit = twice > 0 ? plus((Point){0, 0, 0}, normal, 1 / twice) : (Point){0, 0, 0};
    for (int k = 0; k < 3; k++) {
        const int32_t a = f[k], b = f[(k + 1) % 3];
        quadric_add_plane(m->quadric + a, unit, *p[0], twice / 6);
        const int rim = uses(m, a, b) != 2;
        if (!rim && m->rim[a]) continue;
        if (m->after[a] == -2 || (rim && !m->rim[a])) m->after[a] = (int32_t)i;  // the face that will hold the sample
        if (!rim) continue;
        m->rim[a] = 1;
        if (!m->rim[b]) m->rim[b] = 1, m->after[b] = (int32_t)i;
        const Point along = minus(*p[(k + 1) % 3], *p[k]);
        const double length = sqrt(dot(along, along));
        const Point side = cross(along, unit);
        if (!(length > 0)) continue;
        const Point held = plus((Point){0, 0, 0}, side, 1 / length);
        quadric_add_plane(m->quadric + a, held, *p[k], RIM * length * length / 2);
        quadric_add_plane(m->quadric + b, held, *p[k], RIM * length * length / 2);
    }
}

static int set_up(Mesh *m, const uint8_t *colors) {
    const size_t n = (size_t)m->vertices, f = (size_t)m->faces;
    m->color = malloc(n * sizeof *m->color), m->first = malloc(n * 4), m->next = malloc(f * 12),
    m->stamp = calloc(n, 4);
    m->quadric = calloc(n, sizeof(Quadric)), m->rim = calloc(n, 1), m->touched = malloc(n);
    m->held = malloc(f * 4), m->after = malloc(n * 4);
    if (!m->color || !m->first || !m->next || !m->stamp || !m->quadric) return 0;
    if (!m->rim || !m->touched || !m->held || !m->after) return 0;
    memset(m->touched, 1, n), memset(m->first, -1, n * 4), memset(m->held, -1, f * 4);
    for (size_t i = 0; i < n; i++) {
        m->after[i] = -2;
        for (int k = 0; k < 3; k++) m->color[i][k] = colors[3 * i + k];
    }
    for (int64_t c = 3 * m->faces - 1; c >= 0; c--) {
        const int32_t v = m->face[c / 3][c % 3];
        m->next[c] = m->first[v], m->first[v] = (int32_t)c;
    }
    for (int64_t i = 0; i < m->faces; i++) add_face(m, i);
    for (size_t i = 0; i < n; i++) {
        const int32_t face = m->after[i];
        if (face < 0) continue;
        m->after[i] = m->held[face], m->held[face] = (int32_t)i;
    }
    return 1;
}

static void release(Mesh *m) {
    void *owned[] = {m->color, m->first, m->next, m->stamp, m->quadric, m->rim, m->touched, m->held, m->after, m};
    for (size_t i = 0; i < sizeof owned / sizeof *owned; i++) free(owned[i]);
}
