// SPDX-License-Identifier: GPL-3.0-or-later
// The minimum cut between tetrahedra, by two search trees that grow towards each other (Boykov and Kolmogorov 2004).
//
// Every tetrahedron has four neighbours at most, so that a place in the tables names an arc and its neighbour the arc
// back: 71 bytes a tetrahedron, where a graph of nodes, arcs and pointers takes 175. Which tetrahedra can reach the
// inside in the end does not depend on the order of the work.
#include "common/export.h"

enum { NONE = -1, ROOT = 4, ORPHAN = 5 };  // what stands for a parent beside the four neighbours
enum { OUTSIDE = 0, INSIDE = 1 };          // trees
enum { NEVER = INT32_MAX };

// First in, first out; `next` [n]: who follows, the node itself for the last one, NONE for those that are not in it.
typedef struct {
    int32_t *next, first, last;
} Queue;

typedef struct {
    const int32_t *neighbour;  // [n][4]
    double *residual;          // [n][4] what may still flow to each neighbour
    double *excess;            // [n] what may still come from outside; negative: go inside
    int8_t *parent;            // [n] which neighbour
    uint8_t *tree;             // [n] of those that have a parent
    int32_t *stamp,
        *depth;  // [n] steps to the root, and when that was known; stale ones are no shorter than the way is
    int32_t now;
    Queue active, orphans;
    double flow;
} Graph;

static void push(Queue *q, int32_t i) {
    if (q->next[i] != NONE) return;
    if (q->first == NONE) q->first = i;
    else q->next[q->last] = i;
    q->next[i] = q->last = i;
}

static void push_front(Queue *q, int32_t i) {
    if (q->next[i] != NONE) return;
    q->next[i] = q->first == NONE ? i : q->first;
    if (q->first == NONE) q->last = i;
    q->first = i;
}

static int32_t pop(Queue *q) {
    const int32_t i = q->first;
    if (i == NONE) return NONE;
    q->first = q->next[i] == i ? NONE : q->next[i];
    q->next[i] = NONE;
    return i;
}

static int32_t beyond(const Graph *g, int32_t i, int k) { return g->neighbour[4 * (int64_t)i + k]; }

// Which of j's neighbours i is.
static int back(const Graph *g, int32_t j, int32_t i) {
    int k = 0;
    while (beyond(g, j, k) != i) k++;
    return k;
}

static double *arc(const Graph *g, int32_t i, int k) { return g->residual + 4 * (int64_t)i + k; }

// What still flows between i and its neighbour j = beyond(i, k): from i to j where i's tree comes from outside.
static double open_to(const Graph *g, int32_t i, int k, int32_t j) {
    return g->tree[i] == OUTSIDE ? *arc(g, i, k) : *arc(g, j, back(g, j, i));
}

// What still flows between i and the neighbour k it would hang on, j.
static double open_from(const Graph *g, int32_t i, int k, int32_t j) {
    return g->tree[i] == OUTSIDE ? *arc(g, j, back(g, j, i)) : *arc(g, i, k);
}

static void plant(Graph *g, int64_t n) {
    for (int32_t i = 0; i < n; i++) {
        g->stamp[i] = 0, g->depth[i] = 1, g->active.next[i] = g->orphans.next[i] = NONE;
        g->parent[i] = g->excess[i] != 0 ? ROOT : NONE;
        g->tree[i] = g->excess[i] < 0 ? INSIDE : OUTSIDE;
    }
    for (int32_t i = 0; i < n; i++)
        if (g->parent[i] == ROOT) push(&g->active, i);
}

// Lets a node take its neighbours into its tree; whether one is of the other tree: then *k is the way to it.
static int grow(Graph *g, int32_t i, int *k) {
    for (*k = 0; *k < 4; ++*k) {
        const int32_t j = beyond(g, i, *k);
        if (j < 0 || !(open_to(g, i, *k, j) > 0)) continue;
        if (g->parent[j] == NONE) {
            g->tree[j] = g->tree[i], g->parent[j] = (int8_t)back(g, j, i);
            g->stamp[j] = g->stamp[i], g->depth[j] = g->depth[i] + 1;
            push(&g->active, j);
        } else if (g->tree[j] != g->tree[i]) {
            return 1;
        } else if (g->stamp[j] <= g->stamp[i] && g->depth[j] > g->depth[i] + 1 && g->parent[j] != ROOT) {
            g->parent[j] = (int8_t)back(g, j, i);  // a shorter way to the root
            g->stamp[j] = g->stamp[i], g->depth[j] = g->depth[i] + 1;
        }
    }
    return 0;
}

static void cut_off(Graph *g, int32_t i) {
    g->parent[i] = ORPHAN;
    push_front(&g->orphans, i);
}

// The least of `most` and of what flows along the way from a node to its root.
static double least_to_root(const Graph *g, int32_t i, double most) {
    while (g->parent[i] != ROOT) {
        const int k = g->parent[i];
        const int32_t j = beyond(g, i, k);
        const double open = open_from(g, i, k, j);
        if (open < most) most = open;
        i = j;
    }
    const double left = g->excess[i] < 0 ? -g->excess[i] : g->excess[i];
    return left < most ? left : most;
}

// Lets an amount flow along the way from a node to its root; nodes that hang on a full arc are orphans then.
static void fill_to_root(Graph *g, int32_t i, double amount) {
    const double sign = g->tree[i] == OUTSIDE ? 1 : -1;
    while (g->parent[i] != ROOT) {
        const int k = g->parent[i];
        const int32_t j = beyond(g, i, k);
        double *own = arc(g, i, k), *other = arc(g, j, back(g, j, i));
        *own += sign * amount, *other -= sign * amount;
        if (!((sign > 0 ? *other : *own) > 0)) cut_off(g, i);
        i = j;
    }
    g->excess[i] -= sign * amount;
    if (!(sign * g->excess[i] > 0)) {
        g->excess[i] = 0;
        cut_off(g, i);
    }
}

// Fills the way from outside to inside that leads from i to its neighbour k.
static void augment(Graph *g, int32_t i, int k) {
    const int32_t j = beyond(g, i, k), from = g->tree[i] == OUTSIDE ? i : j, to = from == i ? j : i;
    double *between = arc(g, from, back(g, from, to));
    const double amount = least_to_root(g, to, least_to_root(g, from, *between));
    *between -= amount, *arc(g, to, back(g, to, from)) += amount;
    fill_to_root(g, from, amount);
    fill_to_root(g, to, amount);
    g->flow += amount;
}

// Steps from a node to its root, NEVER if it hangs on an orphan. Nodes on the way know their number of steps then.
static int32_t steps_to_root(Graph *g, int32_t i) {
    int32_t at = i, steps = 0;
    for (; g->stamp[at] != g->now; at = beyond(g, at, g->parent[at]), steps++) {
        if (g->parent[at] == ORPHAN || g->parent[at] == NONE) return NEVER;
        if (g->parent[at] == ROOT) {
            g->stamp[at] = g->now, g->depth[at] = 1;
            break;
        }
    }
    steps += g->depth[at];
    for (int32_t left = steps; g->stamp[i] != g->now; i = beyond(g, i, g->parent[i])) {
        g->stamp[i] = g->now, g->depth[i] = left--;
    }
    return steps;
}

// Hangs an orphan on the neighbour nearest to the root; where there is none it leaves the tree, and its children are
// orphans.
static void adopt(Graph *g, int32_t i) {
    int32_t least = NEVER;
    int parent = NONE;
    for (int k = 0; k < 4; k++) {
        const int32_t j = beyond(g, i, k);
        if (j < 0 || g->parent[j] == NONE || g->tree[j] != g->tree[i] || !(open_from(g, i, k, j) > 0)) continue;
        const int32_t steps = steps_to_root(g, j);
        if (steps < least) least = steps, parent = k;
    }
    g->parent[i] = (int8_t)parent;
    if (parent != NONE) {
        g->stamp[i] = g->now, g->depth[i] = least + 1;
        return;
    }
    for (int k = 0; k < 4; k++) {
        const int32_t j = beyond(g, i, k);
        if (j < 0 || g->parent[j] == NONE || g->tree[j] != g->tree[i]) continue;
        if (open_from(g, i, k, j) > 0) push(&g->active, j);
        if (g->parent[j] < ROOT && beyond(g, j, g->parent[j]) == i) {
            g->parent[j] = ORPHAN;
            push(&g->orphans, j);
        }
    }
}

/* Finds the minimum cut between outside and inside, and which tetrahedra [n] are inside: those from where more could
   flow inside; the flow that is added goes to flow [1]. neighbour [n][4], -1 for none. residual [n][4]: what may flow
   to each neighbour, and excess [n]: what may come from outside (negative: go inside); both are left with what is over,
   so that a second call only adds what has been added to them. For the work: parent [n], stamp, depth, active and
   orphans [n]. */
MGF_API void mgf_cut_tetrahedra(int64_t n, const int32_t *neighbour, double *residual, double *excess, uint8_t *inside,
                                double *flow, int8_t *parent, int32_t *stamp, int32_t *depth, int32_t *active,
                                int32_t *orphans) {
    Graph g = {
        neighbour, residual, excess, parent, inside, stamp, depth, 0, {active, NONE, NONE}, {orphans, NONE, NONE}, 0};
    plant(&g, n);
    int32_t i = NONE;
    for (;;) {
        int k;
        if (i == NONE || g.parent[i] == NONE) {
            do i = pop(&g.active);
            while (i != NONE && g.parent[i] == NONE);
            if (i == NONE) break;
        }
        if (!grow(&g, i, &k)) {
            i = NONE;
            continue;
        }
        augment(&g, i, k);
        g.now++;
        for (int32_t lost; (lost = pop(&g.orphans)) != NONE;) adopt(&g, lost);
    }
    for (int64_t c = 0; c < n; c++) inside[c] = g.parent[c] != NONE && g.tree[c] == INSIDE;
    *flow = g.flow;
}
