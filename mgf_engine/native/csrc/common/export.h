// SPDX-License-Identifier: GPL-3.0-or-later
// What every kernel that Python calls has in common.
//
// Convention of the interface, so that Python needs no table of signatures: pointers are pointers, every whole number
// is an int64_t, every real number is a float. A *work loop* takes `int32_t *next` first: any number of threads call it
// with the same pointer, and each call takes the next free piece of work until none is left.
#pragma once
#include <stddef.h>
#include <stdint.h>

#ifdef _WIN32
#define MGF_API __declspec(dllexport)
#else
#define MGF_API __attribute__((visibility("default")))
#endif

// The next free piece of work; the caller stops when it is >= the number of pieces.
static inline int64_t take_work(int32_t *next) { return __atomic_fetch_add(next, 1, __ATOMIC_RELAXED); }
