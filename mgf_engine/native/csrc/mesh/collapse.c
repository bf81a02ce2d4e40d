// SPDX-License-Identifier: GPL-3.0-or-later
// Fewer faces by collapsing edges, cheapest first (quadric error metric), within bounds that are checked, not
// estimated.
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
#include "mesh/collapse_check.h"
#include "common/export.h"

static const double LENGTH = 1e-4;  // of the squared length of an edge, added to its cost: flat parts shrink evenly

/* What an edge becomes. */

// Where the vertex goes that takes the place of both ends.
static Point target(const Mesh *m, int32_t a, int32_t b, const Quadric *sum) {
    if (m->rim[a] != m->rim[b]) return m->at[m->rim[a] ? a : b];
    const Point along = minus(m->at[b], m->at[a]), middle = plus(m->at[a], along, 0.5);
    if (!m->rim[a]) return quadric_best(sum, middle);
    const double start = quadric_at(sum, m->at[a]), end = quadric_at(sum, m->at[b]);  // a rim stays in its plane
    const double bend = 2 * (start + end - 2 * quadric_at(sum, middle));
    const double t = bend > 0 ? 0.5 - 0.5 * (end - start) / bend : 0.5;
    return plus(m->at[a], along, fmin(fmax(t, 0), 1));
}

// Puts an edge into the queue, at the cost of its collapse: squared distances times areas, and those of the colours.
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

/* The collapse itself. */

// Collapses b into a, which moves to `where`; each sample around goes to the face that was noted for it.
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

// Whether all faces around lie in this thread's slab.
static int within(const Mesh *m, const Star *star) {
    for (int i = 0; i < star->count; i++)
        for (int k = 0; k < 3; k++)
            if (m->slab[m->face[star->face[i]][k]] != m->own) return 0;
    return 1;
}

// Whether both ends may go to `where`; notes the samples.
static int fits(Mesh *m, Star *star, int32_t a, int32_t b, Point where, const float color[3]) {
    for (int i = 0; i < star->count; i++)
        for (int k = 0; k < 3; k++) star->now[i][k] = k == star->corner[i] ? where : star->old[i][k];
    return sound(star) && faithful(m, star, a, b, where, color);
}

// Collapses an edge if everything around stays as it should; returns whether it did.
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
    float color[3];
    const double share = m->quadric[b].weight / (sum.weight + 1e-300);
    for (int k = 0; k < 3; k++) color[k] = (float)(m->color[a][k] + share * (m->color[b][k] - m->color[a][k]));
    for (int i = 0; i < star.count; i++)
        for (int k = 0; k < 3; k++) star.old[i][k] = m->at[m->face[star.face[i]][k]];
    Point where = target(m, a, b, &sum);
    if (!fits(m, &star, a, b, where, color)) {  // a fold that one place leaves may be gone with another
        if (m->rim[a] || !folded(&star)) return 0;
        where = m->at[a];
        if (!fits(m, &star, a, b, where, color) && !fits(m, &star, a, b, where = m->at[b], color)) return 0;
    }
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

/* Begins to reduce a mesh in place; the arrays must live until mgf_collapse_end. Returns a handle, 0: no memory.
   at, colors: [vertices][3], near the origin. samples: the same places as float32, tolerances: [vertices] distance that
   a sample may have from the result. color_tolerance: root mean square per channel; negative: any. */
MGF_API int64_t mgf_collapse_begin(int64_t vertices, int64_t faces, Point *at, int32_t *face, const float *samples,
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
MGF_API void mgf_collapse_loosen(int64_t handle, float loose, float color_tolerance) {
    Mesh *m = (Mesh *)(intptr_t)handle;
    m->loose = loose, m->color_tolerance = color_tolerance;
    memset(m->touched, 1, (size_t)m->vertices);
}

/* Collapses edges within slabs number first to last - 1, a piece of work each, until `stop` faces are left (exact only
   for a single slab). slab: [vertices]; order: [vertices] by slab; start: [slabs + 1], where each begins in `order`. */
MGF_API void mgf_collapse(int32_t *next, int64_t handle, const uint8_t *slab, const int32_t *order,
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
MGF_API int64_t mgf_collapse_live(int64_t handle) {
    const Mesh *m = (const Mesh *)(intptr_t)handle;
    return m->failed ? -1 : m->live;
}

/* Ends the work: faces that are gone have corner 0 = -1, colors [vertices][3] are those of the vertices left. */
MGF_API void mgf_collapse_end(int64_t handle, uint8_t *colors) {
    Mesh *m = (Mesh *)(intptr_t)handle;
    for (int64_t i = 0; i < m->vertices; i++)
        for (int k = 0; k < 3; k++) colors[3 * i + k] = (uint8_t)fminf(fmaxf(m->color[i][k] + 0.5f, 0), 255);
    release(m);
}
