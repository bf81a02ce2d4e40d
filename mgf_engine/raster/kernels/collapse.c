// SPDX-License-Identifier: GPL-3.0-or-later
// Fewer faces by collapsing edges, cheapest first (quadric error metric), within bounds that are checked, not estimated.
//
// Every vertex of the given mesh stays behind as a *sample* that lies on one of the present faces. A collapse is done
// only if each sample around it stays within its tolerance of the new faces, and their colours are right on average; a
// sample of an open rim must stay that near to the new rim. Topology stays as it is (link condition): what was manifold
// stays manifold, no hole opens or closes, no part is lost. No face turns over, and none becomes a needle.
//
// Threads share the mesh in *slabs*: each works on the edges whose faces all around have their corners in its own slab.
// Nothing that one changes is read by another, so the result does not depend on their number. What lies across the
// border of two slabs stays marked as touched, and is tried when the slabs are cut elsewhere.
//
// Positions should be near the origin: the quadrics are sums of squares of coordinates.
#include <stdlib.h>
#include <string.h>

#include "export.h"
#include "triangle.h"

enum { STAR = 96 };                  // faces around an edge; edges with more stay
static const double TURN = 0.3;      // least cosine between the normals of a face before and after
static const double SHAPE = 0.05;    // least shape of a new face: 1 equilateral, 0 no area
static const double LENGTH = 1e-4;   // of the squared length of an edge, added to its cost: flat parts shrink evenly
static const double RIM = 10;        // weight of the planes that hold an open rim

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
    int64_t entries, room;
    Place *place;
    int64_t places, place_room;
    double loose, color_tolerance;   // factor on the tolerances; negative: colours do not matter
    int failed;
} Mesh;

typedef struct {
    int count, shared;             // faces around the edge, those with both ends first
    int32_t face[STAR];
    int32_t corner[STAR];          // place of the end in the face
    Point old[STAR][3], now[STAR][3];
} Star;

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
    if (m->entries == m->room) {
        const int64_t room = m->room + m->room / 2 + 1024;
        Entry *grown = realloc(m->heap, (size_t)room * sizeof(Entry));
        if (!grown) {
            m->failed = 1;
            return;
        }
        m->heap = grown, m->room = room;
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

/* What an edge becomes. */

static Point target(const Mesh *m, int32_t a, int32_t b, const Quadric *sum) {
    if (m->rim[a] != m->rim[b]) return m->at[m->rim[a] ? a : b];
    const Point along = minus(m->at[b], m->at[a]), middle = plus(m->at[a], along, 0.5);
    if (!m->rim[a]) return quadric_best(sum, middle);
    const double start = quadric_at(sum, m->at[a]), end = quadric_at(sum, m->at[b]);  // a rim stays in its plane
    const double bend = 2 * (start + end - 2 * quadric_at(sum, middle));
    const double t = bend > 0 ? 0.5 - 0.5 * (end - start) / bend : 0.5;
    return plus(m->at[a], along, fmin(fmax(t, 0), 1));
}

static void offer(Mesh *m, int32_t a, int32_t b) {
    const Quadric sum = quadric_sum(m->quadric + a, m->quadric + b);
    const Point along = minus(m->at[b], m->at[a]);
    double cost = quadric_at(&sum, target(m, a, b, &sum)) + LENGTH * sum.weight * dot(along, along);
    if (m->color_tolerance > 0) {
        double differ = 0;
        for (int k = 0; k < 3; k++) differ += (m->color[a][k] - m->color[b][k]) * (m->color[a][k] - m->color[b][k]);
        const double unit = m->tolerance[a] / m->color_tolerance;
        const double share = m->quadric[a].weight * m->quadric[b].weight / (sum.weight + 1e-300);
        cost += share * differ / 3 * unit * unit;
    }
    push(m, (Entry){(float)cost, a < b ? a : b, a < b ? b : a, m->stamp[a] + m->stamp[b]});
}

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

// Whether the new faces are no needles (or no worse ones than before) and look the same way as the old ones, or as all
// old ones together: steep little bumps of noise may be levelled.
static int sound(const Star *star) {
    double worst_old = SHAPE, worst_new = 1;
    Point whole = {0, 0, 0};
    for (int i = 0; i < star->count; i++) {
        const Point *o = star->old[i], old = cross(minus(o[1], o[0]), minus(o[2], o[0]));
        worst_old = fmin(worst_old, shape(old, o));
        whole = plus(whole, old, 1);
    }
    for (int i = star->shared; i < star->count; i++) {
        const Point *o = star->old[i], *v = star->now[i];
        const Point old = cross(minus(o[1], o[0]), minus(o[2], o[0])), now = cross(minus(v[1], v[0]), minus(v[2], v[0]));
        const double size = sqrt(dot(now, now));
        if (dot(old, now) < TURN * size * sqrt(dot(old, old)) && dot(whole, now) < TURN * size * sqrt(dot(whole, whole)))
            return 0;
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

// The nearest place on the new faces, or on the open rims among them; the face is -1 where there is none.
static Foot nearest(const Star *star, const int *rims, Point p, int *face) {
    Foot best = {{0, 0, 0}, HUGE_VAL};
    *face = -1;
    for (int i = star->shared; i < star->count; i++) {
        if (!rims) {
            const Foot foot = on_triangle(p, star->now[i]);
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

static int note(Mesh *m, int32_t sample, int32_t face) {
    if (m->places == m->place_room) {
        const int64_t room = 2 * m->place_room + 256;
        Place *grown = realloc(m->place, (size_t)room * sizeof(Place));
        if (!grown) return m->failed = 1, 0;
        m->place = grown, m->place_room = room;
    }
    m->place[m->places++] = (Place){sample, face};
    return 1;
}

// Whether every sample stays near the new faces and their colours are right on average; notes where each would lie.
static int faithful(Mesh *m, const Star *star, int32_t a, int32_t b, Point where, const float color[3]) {
    double near = HUGE_VAL;
    for (int i = 0; i < star->count; i++) near = fmin(near, on_triangle(where, star->old[i]).squared);
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
            const Foot foot = nearest(star, on_rim ? rims : NULL, given(m, s), &face);
            if (face < 0 || foot.squared > tolerance(m, s) * tolerance(m, s)) return 0;
            if (m->color_tolerance >= 0) wrong += color_error(m, star, face, &foot, color, s);
            if (!note(m, s, star->face[face])) return 0;
        }
    return m->color_tolerance < 0 || wrong <= 3 * m->color_tolerance * m->color_tolerance * (double)m->places;
}

/* The collapse itself. */

static void apply(Mesh *m, const Star *star, int32_t a, int32_t b, Point where, const float color[3]) {
    const Quadric sum = quadric_sum(m->quadric + a, m->quadric + b);
    m->quadric[a] = sum, m->at[a] = where, memcpy(m->color[a], color, sizeof m->color[a]);
    for (int i = 0; i < star->count; i++) {
        m->held[star->face[i]] = -1;
        if (i < star->shared) m->face[star->face[i]][0] = -1;
        else m->face[star->face[i]][star->corner[i]] = a;
    }
    for (int64_t i = 0; i < m->places; i++) {
        const Place p = m->place[i];
        m->after[p.sample] = m->held[p.face], m->held[p.face] = p.sample;
    }
    int32_t *link = m->first + a;
    while (*link >= 0) link = m->next + *link;
    *link = m->first[b];
    m->first[b] = -1, m->stamp[b] = -1, m->stamp[a]++;
    m->live -= star->shared;
}

// Offers the edges of a vertex that a collapse has left; what is around it has changed.
static void offer_around(Mesh *m, int32_t vertex) {
    int32_t met[2 * STAR];
    int count = 0;
    for (int32_t c = m->first[vertex]; c >= 0; c = m->next[c]) {
        const int32_t *f = m->face[c / 3];
        for (int k = 0; k < 3 && f[0] >= 0; k++) {
            m->touched[f[k]] = 1;
            int known = f[k] == vertex;
            for (int i = 0; i < count && !known; i++) known = met[i] == f[k];
            if (known || count == 2 * STAR) continue;
            met[count++] = f[k];
            offer(m, vertex, f[k]);
        }
    }
}

static int within(const Mesh *m, const Star *star) {
    for (int i = 0; i < star->count; i++)
        for (int k = 0; k < 3; k++)
            if (m->slab[m->face[star->face[i]][k]] != m->own) return 0;
    return 1;
}

static int try_collapse(Mesh *m, int32_t a, int32_t b) {
    if (m->rim[b] && !m->rim[a]) {
        const int32_t swap = a;
        a = b, b = swap;
    }
    Star star;
    star.count = 0;
    if (!gather(m, a, b, 1, &star)) return 0;
    star.shared = star.count;
    if (!gather(m, a, b, 0, &star)) return 0;
    const int from_b = star.count;
    if (!gather(m, b, a, 0, &star)) return 0;
    if (!within(m, &star)) return m->touched[a] = m->touched[b] = 1, 0;
    if (!linked(m, a, b, &star, from_b)) return 0;
    const Quadric sum = quadric_sum(m->quadric + a, m->quadric + b);
    const Point where = target(m, a, b, &sum);
    for (int i = 0; i < star.count; i++)
        for (int k = 0; k < 3; k++) {
            star.old[i][k] = m->at[m->face[star.face[i]][k]];
            star.now[i][k] = k == star.corner[i] ? where : star.old[i][k];
        }
    if (!sound(&star)) return 0;
    float color[3];
    const double share = m->quadric[b].weight / (sum.weight + 1e-300);
    for (int k = 0; k < 3; k++) color[k] = (float)(m->color[a][k] + share * (m->color[b][k] - m->color[a][k]));
    if (!faithful(m, &star, a, b, where, color)) return 0;
    apply(m, &star, a, b, where, color);
    offer_around(m, a);
    return 1;
}

// Offers the edges of a vertex around which something changed; tells whether one of them leads out of the slab.
static int offer_touched(Mesh *m, int32_t a) {
    int leaves = 0;
    for (int32_t c = m->first[a]; c >= 0; c = m->next[c]) {
        const int32_t *f = m->face[c / 3];
        if (f[0] < 0) continue;
        const int32_t b = f[(c + 1) % 3], other = f[(c + 2) % 3];
        leaves |= m->touched[a] && (m->slab[b] != m->own || m->slab[other] != m->own);
        if (m->slab[b] != m->own || !(m->touched[a] || m->touched[b])) continue;
        if (a < b || (m->rim[a] && m->rim[b])) offer(m, a, b);
    }
    return leaves;
}

// Tries every edge of some vertices around which something changed once, cheapest first, and those of each vertex left
// by a collapse again, down to `stop` faces. Where nothing changed, what failed before would fail again.
static void sweep(Mesh *m, const int32_t *vertex, int64_t count, int64_t stop) {
    uint8_t *leaves = malloc((size_t)count + 1);
    if (!leaves) {
        m->failed = 1;
        return;
    }
    for (int64_t i = 0; i < count; i++) leaves[i] = (uint8_t)(m->stamp[vertex[i]] >= 0 && offer_touched(m, vertex[i]));
    for (int64_t i = 0; i < count; i++) m->touched[vertex[i]] = leaves[i];
    free(leaves);
    while (m->entries && m->live > stop && !m->failed) {
        const Entry e = pop(m);
        if (m->stamp[e.a] < 0 || m->stamp[e.b] < 0 || m->stamp[e.a] + m->stamp[e.b] != e.stamp) continue;
        try_collapse(m, e.a, e.b);
    }
}

/* Setting up. */

static int uses(const Mesh *m, int32_t a, int32_t b) {
    int count = 0;
    for (int32_t c = m->first[a]; c >= 0; c = m->next[c]) {
        const int32_t *f = m->face[c / 3];
        count += f[0] == b || f[1] == b || f[2] == b;
    }
    return count;
}

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
    m->color = malloc(n * sizeof *m->color), m->first = malloc(n * 4), m->next = malloc(f * 12), m->stamp = calloc(n, 4);
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

/* Begins to reduce a mesh in place; the arrays must live until collapse_end. Returns a handle, 0: no memory.
   at, colors: [vertices][3], near the origin. given: the same places as float32, tolerance: [vertices] distance that a
   given vertex may have from the result. color_tolerance: root mean square per channel; negative: any. */
MGF_API int64_t collapse_begin(int64_t vertices, int64_t faces, Point *at, int32_t *face, const float *samples,
                               const float *tolerances, const uint8_t *colors, float color_tolerance) {
    Mesh *m = calloc(1, sizeof *m);
    if (!m) return 0;
    *m = (Mesh){.vertices = vertices, .faces = faces, .live = faces, .at = at, .face = (int32_t(*)[3])face,
                .given = samples, .tolerance = tolerances, .given_color = colors, .loose = 1,
                .color_tolerance = color_tolerance};
    if (set_up(m, colors)) return (int64_t)(intptr_t)m;
    release(m);
    return 0;
}

/* From now on distances may be `loose` times the tolerances, and every edge is tried again. */
MGF_API void collapse_loosen(int64_t handle, float loose, float color_tolerance) {
    Mesh *m = (Mesh *)(intptr_t)handle;
    m->loose = loose, m->color_tolerance = color_tolerance;
    memset(m->touched, 1, (size_t)m->vertices);
}

/* Collapses edges within slabs number first to last - 1, a piece of work each, until `stop` faces are left (exact only
   for a single slab). slab: [vertices]; order: [vertices] by slab; start: [slabs + 1], where each begins in `order`. */
MGF_API void collapse_work(int32_t *next, int64_t handle, const uint8_t *slab, const int32_t *order,
                           const int64_t *start, int64_t first, int64_t last, int64_t stop) {
    Mesh *whole = (Mesh *)(intptr_t)handle;
    for (int64_t k; (k = first + take_work(next)) < last;) {
        Mesh m = *whole;
        m.slab = slab, m.own = (uint8_t)k;
        m.live = __atomic_load_n(&whole->live, __ATOMIC_RELAXED);
        const int64_t live = m.live;
        sweep(&m, order + start[k], start[k + 1] - start[k], stop);
        free(m.heap), free(m.place);
        __atomic_fetch_sub(&whole->live, live - m.live, __ATOMIC_RELAXED);
        if (m.failed) __atomic_store_n(&whole->failed, 1, __ATOMIC_RELAXED);
    }
}

/* Faces left, -1: out of memory on the way. */
MGF_API int64_t collapse_live(int64_t handle) {
    const Mesh *m = (const Mesh *)(intptr_t)handle;
    return m->failed ? -1 : m->live;
}

/* Ends the work: faces that are gone have corner 0 = -1, colors [vertices][3] are those of the vertices left. */
MGF_API void collapse_end(int64_t handle, uint8_t *colors) {
    Mesh *m = (Mesh *)(intptr_t)handle;
    for (int64_t i = 0; i < m->vertices; i++)
        for (int k = 0; k < 3; k++) colors[3 * i + k] = (uint8_t)fminf(fmaxf(m->color[i][k] + 0.5f, 0), 255);
    release(m);
}
