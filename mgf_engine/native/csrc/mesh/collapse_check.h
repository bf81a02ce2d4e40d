// SPDX-License-Identifier: GPL-3.0-or-later
// What collapse.c may do: the faces around an edge, and whether they stay a sound surface near its samples without it.
#pragma once
#include "mesh/collapse_mesh.h"

enum { STAR = 96 };                // faces around an edge; edges with more stay
static const double TURN = 0.3;    // least cosine between the normals of a face before and after
static const double SHAPE = 0.05;  // least shape of a new face: 1 equilateral, 0 no area

typedef struct {
    int count, shared;             // faces around the edge, those with both ends first
    int32_t face[STAR];
    int32_t corner[STAR];          // place of the end in the face
    Point old[STAR][3], now[STAR][3];
} Star;

/* The faces around an edge; corners of faces that are gone are taken out of the vertices' lists on the way. */

static int gather(Mesh *m, int32_t vertex, int32_t other, int shared, Star *star) {
    for (int32_t *link = m->first + vertex; *link >= 0;) {
        const int32_t face = *link / 3, place = *link % 3;
        if (m->face[face][0] < 0) {
            *link = m->next[*link];
            continue;
        }
        const int32_t *f = m->face[face];
        if ((f[0] == other || f[1] == other || f[2] == other) == shared) {
            if (star->count == STAR) return 0;
            star->face[star->count] = face, star->corner[star->count++] = place;
        }
        link = m->next + *link;
    }
    return 1;
}

// Whether the faces around an edge stay a surface of the same kind when it collapses (link condition).
static int linked(const Mesh *m, int32_t a, int32_t b, const Star *star, int from_b) {
    if (star->shared < 1 || star->shared > 2 || star->count == star->shared) return 0;
    if (star->shared == 2 && m->rim[a] && m->rim[b]) return 0;
    int32_t opposite[2] = {-1, -1};
    for (int i = 0; i < star->shared; i++)
        for (int k = 0; k < 3; k++) {
            const int32_t v = m->face[star->face[i]][k];
            if (v != a && v != b) opposite[i] = v;
        }
    if (star->shared == 2 && opposite[0] == opposite[1]) return 0;
    int closing[2] = {0, 0};  // faces of each end that have both opposite corners: two would fall together
    for (int i = star->shared; i < star->count && star->shared == 2; i++) {
        const int32_t *f = m->face[star->face[i]];
        int met = 0;
        for (int k = 0; k < 3; k++) met += f[k] == opposite[0] || f[k] == opposite[1];
        closing[i >= from_b] |= met == 2;
    }
    if (closing[0] && closing[1]) return 0;
    for (int i = star->shared; i < from_b; i++)
        for (int k = 0; k < 3; k++) {
            const int32_t v = m->face[star->face[i]][k];
            if (v == a || v == opposite[0] || v == opposite[1]) continue;
            for (int j = from_b; j < star->count; j++) {
                const int32_t *g = m->face[star->face[j]];
                if (g[0] == v || g[1] == v || g[2] == v) return 0;
            }
        }
    return 1;
}

static double shape(Point normal, const Point v[3]) {
    const Point a = minus(v[1], v[0]), b = minus(v[2], v[1]), c = minus(v[0], v[2]);
    const double sum = dot(a, a) + dot(b, b) + dot(c, c);
    return sum > 0 ? 3.4641016151377544 * sqrt(dot(normal, normal)) / sum : 0;
}

// Twice the vector area of the old faces around an edge: the way that they look all together.
static Point vector_area(const Star *star) {
    Point whole = {0, 0, 0};
    for (int i = 0; i < star->count; i++) {
        const Point *o = star->old[i];
        whole = plus(whole, cross(minus(o[1], o[0]), minus(o[2], o[0])), 1);
    }
    return whole;
}

// Whether one of the old faces looks the other way than all together: the surface is folded there.
static int folded(const Star *star) {
    const Point whole = vector_area(star);
    for (int i = 0; i < star->count; i++) {
        const Point *o = star->old[i];
        if (dot(cross(minus(o[1], o[0]), minus(o[2], o[0])), whole) < 0) return 1;
    }
    return 0;
}

// Whether the new faces are no needles (or no worse ones than before) and look the same way as the old ones, or as all
// old ones together: steep little bumps of noise may be levelled. What is folded over does not grow.
static int sound(const Star *star) {
    double worst_old = SHAPE, worst_new = 1;
    const Point whole = vector_area(star);
    for (int i = 0; i < star->count; i++) {
        const Point *o = star->old[i];
        worst_old = fmin(worst_old, shape(cross(minus(o[1], o[0]), minus(o[2], o[0])), o));
    }
    for (int i = star->shared; i < star->count; i++) {
        const Point *o = star->old[i], *v = star->now[i];
        const Point old = cross(minus(o[1], o[0]), minus(o[2], o[0])),
                    now = cross(minus(v[1], v[0]), minus(v[2], v[0]));
        const double size = sqrt(dot(now, now));
        if (dot(old, now) < TURN * size * sqrt(dot(old, old)) &&
            dot(whole, now) < TURN * size * sqrt(dot(whole, whole)))
            return 0;
        if (dot(now, whole) < 0 && size > sqrt(dot(old, old))) return 0;
        worst_new = fmin(worst_new, shape(now, v));
    }
    return worst_new >= worst_old && worst_new > 0;
}

// Bit k is set when edge k (corners k, k + 1) of new face i lies on an open rim.
static int rim_edges(const Mesh *m, const Star *star, int i) {
    const int32_t *f = m->face[star->face[i]];
    int bits = 0;
    for (int k = 0; k < 3; k++) {
        const int32_t s = f[k], t = f[(k + 1) % 3];
        int uses = 0;
        if (k == star->corner[i] || (k + 1) % 3 == star->corner[i]) {
            const int32_t far = k == star->corner[i] ? t : s;
            for (int j = star->shared; j < star->count; j++)
                for (int n = 0; n < 3; n++) uses += m->face[star->face[j]][n] == far;
        } else {
            if (!m->rim[s] || !m->rim[t]) continue;
            for (int32_t c = m->first[s]; c >= 0; c = m->next[c]) {
                const int32_t *g = m->face[c / 3];
                if (g[0] >= 0) uses += g[0] == t || g[1] == t || g[2] == t;
            }
        }
        bits |= (uses == 1) << k;
    }
    return bits;
}

// The nearest place on the new faces, or on the open rims among them; the face is -1 where there is none as near as the
// square root of `limit`.
static Foot nearest(const Star *star, const int *rims, Point p, double limit, int *face) {
    Foot best = {{0, 0, 0}, limit};
    *face = -1;
    for (int i = star->shared; i < star->count; i++) {
        if (!rims) {
            const Foot foot = on_triangle_within(p, star->now[i], best.squared);
            if (foot.squared < best.squared) best = foot, *face = i;
            continue;
        }
        for (int k = 0; k < 3; k++) {
            if (!(rims[i] >> k & 1)) continue;
            const Foot foot = on_segment(p, star->now[i][k], star->now[i][(k + 1) % 3]);
            if (!(foot.squared < best.squared)) continue;
            best.squared = foot.squared, *face = i;
            best.share[k] = foot.share[0], best.share[(k + 1) % 3] = foot.share[1], best.share[(k + 2) % 3] = 0;
        }
    }
    return best;
}

// Squared difference between a sample's colour and that of the new face at its foot, all channels.
static double color_error(const Mesh *m, const Star *star, int i, const Foot *foot, const float color[3], int32_t s) {
    const int32_t *f = m->face[star->face[i]];
    double sum = 0;
    for (int k = 0; k < 3; k++) {
        double c = 0;
        for (int n = 0; n < 3; n++) c += foot->share[n] * (n == star->corner[i] ? color[k] : m->color[f[n]][k]);
        sum += (c - m->given_color[3 * s + k]) * (c - m->given_color[3 * s + k]);
    }
    return sum;
}

// Notes on which face a sample would lie; 0 without memory.
static int note(Mesh *m, int32_t sample, int32_t face) {
    if (m->places == m->place_capacity) {
        const int64_t capacity = 2 * m->place_capacity + 256;
        Place *grown = realloc(m->place, (size_t)capacity * sizeof(Place));
        if (!grown) return m->failed = 1, 0;
        m->place = grown, m->place_capacity = capacity;
    }
    m->place[m->places++] = (Place){sample, face};
    return 1;
}

// Whether every sample stays near the new faces and their colours are right on average; notes where each would lie.
static int faithful(Mesh *m, const Star *star, int32_t a, int32_t b, Point where, const float color[3]) {
    double near = HUGE_VAL;
    for (int i = 0; i < star->count; i++) near = fmin(near, on_triangle_within(where, star->old[i], near).squared);
    const double allowed = fmin(tolerance(m, a), tolerance(m, b));
    if (near > allowed * allowed) return 0;
    int rims[STAR], known = 0;
    double wrong = 0;
    m->places = 0;
    for (int i = 0; i < star->count; i++)
        for (int32_t s = m->held[star->face[i]]; s >= 0; s = m->after[s]) {
            const int on_rim = m->rim[s];
            if (on_rim && !known++)
                for (int j = star->shared; j < star->count; j++) rims[j] = rim_edges(m, star, j);
            int face;
            const double squared = tolerance(m, s) * tolerance(m, s);
            const Foot foot = nearest(star, on_rim ? rims : NULL, given(m, s), 1.001 * squared, &face);
            if (face < 0 || foot.squared > squared) return 0;
            if (m->color_tolerance >= 0) wrong += color_error(m, star, face, &foot, color, s);
            if (!note(m, s, star->face[face])) return 0;
        }
    return m->color_tolerance < 0 || wrong <= 3 * m->color_tolerance * m->color_tolerance * (double)m->places;
}
