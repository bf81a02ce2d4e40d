// SPDX-License-Identifier: GPL-3.0-or-later
// Sets that are joined in pairs (union-find): parent[i] == i at the root of a set, which is its first member.
#pragma once
#include <stdint.h>

static inline int32_t root(int32_t *parent, int32_t i) {
    while (parent[i] != i) i = parent[i] = parent[parent[i]];
    return i;
}

// The first of both becomes the root, so that labels do not depend on the order of the joins.
static inline void join(int32_t *parent, int32_t i, int32_t j) {
    i = root(parent, i), j = root(parent, j);
    if (i < j) parent[j] = i;
    else parent[i] = j;
}
