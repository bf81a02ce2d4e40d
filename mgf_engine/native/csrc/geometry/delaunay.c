// SPDX-License-Identifier: GPL-3.0-or-later
// Delaunay tetrahedra of points, inserted one after another (Bowyer 1981, Watson 1981) with exact predicates.
//
// Of five points on one sphere the numbers decide (Edelsbrunner and Muecke 1990, as tetgen does), so that the
// tetrahedra are the same in whichever order points come. Outside of the hull lie tetrahedra whose fourth corner is
// OUTSIDE: each has its face of the hull and the three beyond that face's edges as neighbours. Arrays of whole numbers
// keep this below a third of what structures with pointers take.
#include <stdlib.h>

#include "common/export.h"
#include "geometry/predicates.h"

enum { OUTSIDE = -1, FREE = -2, MORE = -1, FLAT = -2, STOPPED = -3, NO_MEMORY = -4 };
enum { ASK = 1024, FEW = 48 };  // points between two looks at `stop`; lists up to this are sorted by insertion
// Corners of the face opposite of each corner, outward.
static const int FACE[4][3] = {{1, 2, 3}, {0, 3, 2}, {0, 1, 3}, {0, 2, 1}};

typedef struct {
    int32_t *item;
    int64_t count, capacity;
} List;

typedef struct {
    uint64_t edge;
    int32_t at;     // 4 x tetrahedron + corner, opposite of which the edge's face waits for its other side
    uint32_t turn;  // of the point that this was written for
} Slot;

typedef struct {
    const double *points;  // [n][3]
    int32_t *corner;       // [capacity][4] points, OUTSIDE; the first one FREE where nothing is
    int32_t *beyond;  // [capacity][4] 4 x tetrahedron beyond the face opposite of a corner + its corner opposite of it
    uint8_t *known;        // [capacity] of this point: 1 in conflict, 2 not
    int64_t capacity, count;
    List spare, cavity, rim,
        tested;  // free numbers; in conflict; 4 x tetrahedron + corner of the faces around; all asked
    Slot *slots;
    int64_t slot_count;
    uint32_t turn;
} Mesh;

static int push(List *list, int32_t item) {
    if (list->count == list->capacity) {
        const int64_t capacity = 2 * list->capacity + 1024;
        int32_t *more = realloc(list->item, (size_t)capacity * sizeof *more);
        if (!more) return 0;
        list->item = more, list->capacity = capacity;
    }
    list->item[list->count++] = item;
    return 1;
}

static const double *at(const Mesh *m, int32_t v) { return m->points + 3 * (int64_t)v; }

// Whether point p lies inside of a tetrahedron's sphere; where it lies on it, as if points were lifted and those of
// lower numbers a little less.
static int in_own_sphere(const Mesh *m, const int32_t *corner, int32_t p) {
    const double *of[4] = {at(m, corner[0]), at(m, corner[1]), at(m, corner[2]), at(m, corner[3])};
    const int found = in_sphere(of, at(m, p));
    if (found) return found > 0;
    int32_t v[5] = {corner[0], corner[1], corner[2], corner[3], p};
    int odd = 0;
    for (int end = 4; end > 0; end--)
        for (int k = 0; k < end; k++)
            if (v[k] > v[k + 1]) {
                const int32_t swapped = v[k];
                v[k] = v[k + 1], v[k + 1] = swapped, odd = !odd;
            }
    const int first = side(at(m, v[1]), at(m, v[2]), at(m, v[3]), at(m, v[4]));
    if (first) return odd ? first < 0 : first > 0;
    const int second = side(at(m, v[0]), at(m, v[2]), at(m, v[3]), at(m, v[4]));
    return odd ? second > 0 : second < 0;
}

static int outer_corner(const int32_t *corner) {
    for (int k = 0; k < 4; k++)
        if (corner[k] == OUTSIDE) return k;
    return -1;
}

// Whether a tetrahedron goes when point p comes.
static int in_conflict(const Mesh *m, int32_t t, int32_t p) {
    const int32_t *corner = m->corner + 4 * (int64_t)t;
    const int k = outer_corner(corner);
    if (k < 0) return in_own_sphere(m, corner, p);
    const int *f = FACE[k];  // outward of this one: the hull lies on the other side of its face
    const int found = side(at(m, corner[f[0]]), at(m, corner[f[1]]), at(m, corner[f[2]]), at(m, p));
    if (found) return found < 0;
    return in_own_sphere(m, m->corner + (m->beyond[4 * (int64_t)t + k] & ~3), p);
}

// The tetrahedron that holds point p, or one outside of the hull that sees it, by a walk from another.
static int32_t locate(const Mesh *m, int32_t t, int32_t p) {
    int from = -1;
    for (;;) {
        const int32_t *corner = m->corner + 4 * (int64_t)t;
        int over = -1;
        if (outer_corner(corner) >= 0) return t;
        for (int k = 0; k < 4 && over < 0; k++) {
            const int *f = FACE[k];
            if (k != from && side(at(m, corner[f[0]]), at(m, corner[f[1]]), at(m, corner[f[2]]), at(m, p)) > 0)
                over = k;
        }
        if (over < 0) return t;
        const int32_t next = m->beyond[4 * (int64_t)t + over];
        t = next >> 2, from = next & 3;
    }
}

static int is_corner(const Mesh *m, int32_t t, int32_t p) {
    for (int k = 0; k < 4; k++) {
        const int32_t v = m->corner[4 * (int64_t)t + k];
        if (v >= 0 && at(m, v)[0] == at(m, p)[0] && at(m, v)[1] == at(m, p)[1] && at(m, v)[2] == at(m, p)[2]) return 1;
    }
    return 0;
}

static int mark(Mesh *m, int32_t t, uint8_t what) {
    m->known[t] = what;
    return push(&m->tested, t) && (what != 1 || push(&m->cavity, t));
}

// Gathers what is in conflict with point p, and the faces around it; 0 without memory.
static int find_cavity(Mesh *m, int32_t start, int32_t p) {
    m->cavity.count = m->rim.count = m->tested.count = 0;
    if (!mark(m, start, 1)) return 0;
    for (int64_t i = 0; i < m->cavity.count; i++) {
        const int32_t t = m->cavity.item[i];
        for (int k = 0; k < 4; k++) {
            const int32_t other = m->beyond[4 * (int64_t)t + k] >> 2;
            if (!m->known[other] && !mark(m, other, in_conflict(m, other, p) ? 1 : 2)) return 0;
            if (m->known[other] == 2 && !push(&m->rim, 4 * t + k)) return 0;
        }
    }
    return 1;
}

// The slot of an edge, empty in this turn or with its first side.
static Slot *slot_of(Mesh *m, int32_t a, int32_t b) {
    const uint64_t low = (uint32_t)(a < b ? a : b) + 1u, high = (uint32_t)(a < b ? b : a) + 1u, edge = low << 32 | high;
    for (uint64_t h = edge * 0x9E3779B97F4A7C15u >> 20;; h++) {
        Slot *slot = m->slots + (h & (uint64_t)(m->slot_count - 1));
        if (slot->turn != m->turn) {
            slot->edge = edge;
            return slot;
        }
        if (slot->edge == edge) return slot;
    }
}

static int enough_slots(Mesh *m) {
    int64_t wanted = m->slot_count ? m->slot_count : 1024;
    while (wanted < 4 * m->rim.count) wanted *= 2;
    if (wanted > m->slot_count) {
        free(m->slots);
        m->slots = calloc((size_t)wanted, sizeof *m->slots);
        m->slot_count = m->slots ? wanted : 0, m->turn = 0;
    }
    if (++m->turn == 0) {  // after 2^32 points
        for (int64_t i = 0; i < m->slot_count; i++) m->slots[i].turn = 0;
        m->turn = 1;
    }
    return m->slots != NULL;
}

static void join(Mesh *m, int32_t one, int32_t two) { m->beyond[one] = two, m->beyond[two] = one; }

// Fills the cavity with tetrahedra from point p to the faces around; returns the last one, MORE or NO_MEMORY.
static int32_t fill_cavity(Mesh *m, int32_t p) {
    int32_t last = MORE;
    if (!enough_slots(m)) return NO_MEMORY;
    for (int64_t i = 0; i < m->rim.count; i++) {
        const int32_t face = m->rim.item[i];
        const int k = face & 3;
        int32_t t;
        if (m->spare.count) t = m->spare.item[--m->spare.count];
        else if (m->count < m->capacity) t = (int32_t)m->count++;
        else return MORE;
        int32_t *corner = m->corner + 4 * (int64_t)t;
        for (int q = 0; q < 4; q++) corner[q] = q == k ? p : m->corner[(face & ~3) + q];
        m->known[t] = 0;
        join(m, 4 * t + k, m->beyond[face]);
        for (int q = 0; q < 4; q++) {
            if (q == k) continue;
            int32_t edge[2], n = 0;
            for (int r = 0; r < 4; r++)
                if (r != k && r != q) edge[n++] = corner[r];
            Slot *slot = slot_of(m, edge[0], edge[1]);
            if (slot->turn == m->turn) join(m, slot->at, 4 * t + q);
            else slot->turn = m->turn, slot->at = 4 * t + q;
        }
        last = t;
    }
    for (int64_t i = 0; i < m->tested.count; i++) m->known[m->tested.item[i]] = 0;
    for (int64_t i = 0; i < m->cavity.count; i++) {
        m->corner[4 * (int64_t)m->cavity.item[i]] = FREE;
        if (!push(&m->spare, m->cavity.item[i])) return NO_MEMORY;
    }
    return last;
}

static int on_line(const double *a, const double *b, const double *c) {
    int64_t u[3], v[3];
    whole_difference(b, a, u), whole_difference(c, a, v);
    for (int k = 0; k < 3; k++)
        if ((Wide)u[k] * v[(k + 1) % 3] != (Wide)u[(k + 1) % 3] * v[k]) return 0;
    return 1;
}

// Begins with the first four points, in their order, that span a volume; 0 where all lie in one plane.
static int begin(Mesh *m, int64_t n, const int32_t *order) {
    int32_t v[4] = {order[0]};
    int found = 1;
    for (int64_t i = 1; i < n && found < 4; i++) {
        const double *p = at(m, order[i]), *a = at(m, v[0]);
        const int new = found == 1   ? p[0] != a[0] || p[1] != a[1] || p[2] != a[2]
                        : found == 2 ? !on_line(a, at(m, v[1]), p)
                                     : side(a, at(m, v[1]), at(m, v[2]), p) != 0;
        if (new) v[found++] = order[i];
    }
    if (found < 4) return 0;
    if (side(at(m, v[0]), at(m, v[1]), at(m, v[2]), at(m, v[3])) < 0) {
        const int32_t swapped = v[2];
        v[2] = v[3], v[3] = swapped;
    }
    for (int k = 0; k < 4; k++) m->corner[k] = v[k];
    for (int k = 0; k < 4; k++) {  // beyond face k lies tetrahedron k + 1: its corner k is OUTSIDE, two others swapped
        int32_t *corner = m->corner + 4 * (k + 1);
        for (int q = 0; q < 4; q++) corner[q] = q == k ? OUTSIDE : v[q];
        const int a = (k + 1) % 4, b = (k + 2) % 4;
        const int32_t swapped = corner[a];
        corner[a] = corner[b], corner[b] = swapped;
        join(m, k, 4 * (k + 1) + k);
    }
    for (int k = 0; k < 4; k++)
        for (int q = 0; q < 4; q++) {  // of outer tetrahedra k and q: the face without v[q], and without v[k]
            if (q == k) continue;
            int one = 0, two = 0;
            while (m->corner[4 * (k + 1) + one] != v[q]) one++;
            while (m->corner[4 * (q + 1) + two] != v[k]) two++;
            join(m, 4 * (k + 1) + one, 4 * (q + 1) + two);
        }
    m->count = 5;
    for (int t = 0; t < 5; t++) m->known[t] = 0;
    return 1;
}

static int64_t insert_all(Mesh *m, int64_t n, const int32_t *order, const int32_t *stop) {
    if (m->capacity < 5) return MORE;
    if (n < 4 || !begin(m, n, order)) return FLAT;
    int32_t last = 0;
    for (int64_t i = 0; i < n; i++) {
        if (i % ASK == 0 && __atomic_load_n(stop, __ATOMIC_RELAXED)) return STOPPED;
        const int32_t p = order[i], t = locate(m, last, p);
        if (is_corner(m, t, p)) continue;  // one of the first four, or a point that is there twice
        if (!find_cavity(m, t, p)) return NO_MEMORY;
        last = fill_cavity(m, p);
        if (last < 0) return last;
        // The walk to the next point begins inside of the hull.
        const int outer = outer_corner(m->corner + 4 * (int64_t)last);
        if (outer >= 0) last = m->beyond[4 * (int64_t)last + outer] >> 2;
    }
    return m->count;
}

/* Makes the Delaunay tetrahedra of points [n][3], whole numbers of 2^-53 between 0 and 1, inserted in `order` [n]; of
   equal ones the first counts. corner, beyond [capacity][4] and known [capacity] (0) are for work. *stop is asked now
   and then. Returns how many places of `corner` are in use; those with a corner below 0 are none. Or why not: -1 more
   capacity is needed, -2 all points lie in one plane, -3 stopped, -4 no memory. */
MGF_API int64_t mgf_delaunay(int64_t n, const double *points, const int32_t *order, int64_t capacity, int32_t *corner,
                             int32_t *beyond, uint8_t *known, const int32_t *stop) {
    Mesh m = {.points = points, .corner = corner, .beyond = beyond, .known = known, .capacity = capacity};
    const int64_t result = insert_all(&m, n, order, stop);
    free(m.spare.item), free(m.cavity.item), free(m.rim.item), free(m.tested.item), free(m.slots);
    return result;
}

// Sorts the corners of a tetrahedron; where that takes an odd number of swaps the last two are swapped back.
static void sort_corners(const int32_t *corner, int32_t *to) {
    int odd = 0;
    for (int k = 0; k < 4; k++) to[k] = corner[k];
    for (int end = 3; end > 0; end--)
        for (int k = 0; k < end; k++)
            if (to[k] > to[k + 1]) {
                const int32_t swapped = to[k];
                to[k] = to[k + 1], to[k + 1] = swapped, odd = !odd;
            }
    if (odd) {
        const int32_t swapped = to[2];
        to[2] = to[3], to[3] = swapped;
    }
}

typedef struct {
    int32_t corner[4];
} Four;

static int by_corners(const void *a, const void *b) {
    const int32_t *one = a, *two = b;
    for (int k = 1; k < 4; k++)  // the first ones are the same
        if (one[k] != two[k]) return one[k] < two[k] ? -1 : 1;
    return 0;
}

static void sort_few(Four *list, int64_t count) {
    for (int64_t i = 1; i < count; i++) {
        const Four own = list[i];
        int64_t k = i;
        for (; k > 0 && by_corners(list + k - 1, &own) > 0; k--) list[k] = list[k - 1];
        list[k] = own;
    }
}

/* Writes the tetrahedra among corner [count][4] in an order that does not depend on how they were made: each begins
   with its corner of the lowest number and then the next one, volumes stay positive, and all are sorted by their
   corners. first [points + 1] is for work. Returns how many there are. */
MGF_API int64_t mgf_sort_tetrahedra(int64_t count, const int32_t *corner, int64_t points, int64_t *first,
                                    int32_t *sorted) {
    int32_t own[4];
    for (int64_t v = 0; v <= points; v++) first[v] = 0;
    for (int64_t t = 0; t < count; t++) {
        const int32_t *c = corner + 4 * t;
        if (c[0] < 0 || c[1] < 0 || c[2] < 0 || c[3] < 0) continue;
        sort_corners(c, own), first[own[0]]++;
    }
    for (int64_t v = 0, end = 0; v <= points; v++) end += first[v], first[v] = end;
    for (int64_t t = 0; t < count; t++) {
        const int32_t *c = corner + 4 * t;
        if (c[0] < 0 || c[1] < 0 || c[2] < 0 || c[3] < 0) continue;
        sort_corners(c, own);
        int32_t *to = sorted + 4 * --first[own[0]];
        for (int k = 0; k < 4; k++) to[k] = own[k];
    }
    for (int64_t v = 0; v < points; v++) {
        Four *list = (Four *)sorted + first[v];
        const int64_t own = first[v + 1] - first[v];
        if (own <= FEW) sort_few(list, own);
        else qsort(list, (size_t)own, sizeof *list, by_corners);
    }
    return first[points];
}
