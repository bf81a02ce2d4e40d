// SPDX-License-Identifier: GPL-3.0-or-later
// One text, two builds: CUDA for a GPU, and plain C++ in which one processor thread plays a whole block.
//
// Every kernel runs in blocks of 256 threads and is written in *phases*, stretches between two barriers:
//
//     PHASE { ... }       every thread of the block once; a block barrier follows
//     EACH_WARP { ... }   every warp once; inside it LANES { ... } is every lane once, with a warp barrier after it,
//                         and between LANES the collectives below may be called; a block barrier follows the whole
//     EACH(i, n) { ... }  no barriers at all: every i in 0..n - 1, one thread each
//
// On a GPU a phase is its body followed by __syncthreads(). On the CPU it is a loop over the threads, one after the
// other: what a phase reads must have been written in an earlier one, and no two threads of a phase may write different
// values to one place. To prove it, the CPU build can run all its loops backwards (mgf_reverse): the results must be
// the same bits.
//
// What a thread keeps from one phase to the next lives in an Own<T>: a register on the GPU, an array over the threads
// on the CPU; *own and own->member are the running thread's. `continue` ends a thread's share of a phase. Between
// phases control flow must be the same for all threads: only shared memory, constants and kernel arguments may decide
// it. Shared memory that is read there must not be written by the phase that follows, only by the one after: threads do
// not wait for each other between the reading and that phase. Inside LANES and PHASE a thread may loop and branch as it
// likes.
//
// Arguments: pointers, int (every whole number), float, and structs by value.
#pragma once
#include "cuda/lane.h"

enum { BLOCK = 256, WARP = 32, WARPS = BLOCK / WARP };

#if defined(__CUDACC__)

#define INFINITY_F __int_as_float(0x7f800000)
#define KERNEL(name, ...) extern "C" __global__ void __launch_bounds__(BLOCK) name(__VA_ARGS__)
#define SHARED __shared__
#define TABLE static __constant__
#define BY_VALUE const __grid_constant__  // of a struct among the arguments: read where it lies
#define BLOCK_X ((int)blockIdx.x)
#define BLOCK_Y ((int)blockIdx.y)
#define THREAD ((int)threadIdx.x)
#define PHASE for (bool once_ = true; once_; once_ = false, __syncthreads())
#define EACH_WARP PHASE
#define LANES for (bool lane_ = true; lane_; lane_ = false, __syncwarp())
#define EACH(i, n) for (int i = BLOCK_X * BLOCK + THREAD, once_ = 1; once_ && i < (n); once_ = 0)

template <class T> struct Own {
    T value;
    T &operator*() { return value; }
    T *operator->() { return &value; }
};

static inline float fast_exp2(float x) { return exp2f(x); }
static inline float fast_reciprocal(float x) { return __fdividef(1.0f, x); }
static inline int bits_set(unsigned x) { return __popc(x); }
static inline unsigned lanes_before() { return (1u << (THREAD & 31)) - 1u; }
static inline void add_atomic(long long *to, long long x) {
    atomicAdd((unsigned long long *)to, (unsigned long long)x);
}
static inline void add_atomic(int *to, int x) { atomicAdd(to, x); }

#else  // the CPU build

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

// The thread of the block that runs right now, the block, and whether everything runs in opposite order.
static struct {
    int thread, block_x, block_y, reverse;
} now_;

#define INFINITY_F __builtin_inff()
#define SHARED
#define TABLE static
#define BY_VALUE const
#define BLOCK_X (now_.block_x)
#define BLOCK_Y (now_.block_y)
#define THREAD (now_.thread)
#define PHASE for (Walk walk_(0, BLOCK, 1); walk_.go(); walk_.next())
#define EACH_WARP for (Walk walk_(0, BLOCK, WARP); walk_.go(); walk_.next())
#define LANES for (Walk lane_(now_.thread & ~(WARP - 1), WARP, 1); lane_.go(); lane_.next())
#define EACH(i, n) PHASE if (const int i = BLOCK_X * BLOCK + THREAD; i < (n))

struct float4 {
    float x, y, z, w;
};

// Visits first, first + step, .. below first + count as the running thread, or the same from the end.
struct Walk {
    int first, steps, step, done = 0, before;
    Walk(int first, int count, int step) : first(first), steps(count / step), step(step), before(now_.thread) {}
    ~Walk() { now_.thread = before; }
    bool go() const {
        now_.thread = first + step * (now_.reverse ? steps - 1 - done : done);
        return done < steps;
    }
    void next() { done++; }
};

template <class T> struct Own {
    T values[BLOCK];
    T &operator*() { return values[now_.thread]; }
    T *operator->() { return &values[now_.thread]; }
    T &lane(int l) { return values[(now_.thread & ~(WARP - 1)) + l]; }
};

template <class T, T... I> struct Numbers_ {};

template <class... P, int... I> void run_block_(void (*body)(P...), void **arguments, Numbers_<int, I...>) {
    body(*static_cast<P *>(arguments[I])...);
}

// Calls a kernel for every block of the grid; arguments as cuLaunchKernel takes them: the address of each.
template <class... P> void run_grid_(void (*body)(P...), int x, int y, int reverse, void **arguments) {
    now_.reverse = reverse, now_.thread = 0;
    for (int i = 0; i < x * y; i++) {
        const int block = reverse ? x * y - 1 - i : i;
        now_.block_x = block % x, now_.block_y = block / x;
        run_block_(body, arguments, __make_integer_seq<Numbers_, int, sizeof...(P)>());
    }
}

#define KERNEL(name, ...)                                                                                           \
    static void name##_body(__VA_ARGS__);                                                                           \
    extern "C" __attribute__((visibility("default"))) void name(int x, int y, int reverse, void **arguments) {      \
        run_grid_(name##_body, x, y, reverse, arguments);                                                           \
    }                                                                                                               \
    static void name##_body(__VA_ARGS__)

static inline float fast_exp2(float x) { return exp2f(x); }
static inline float fast_reciprocal(float x) { return 1.0f / x; }
static inline int bits_set(unsigned x) { return __builtin_popcount(x); }
static inline unsigned lanes_before() { return (1u << (THREAD & 31)) - 1u; }
static inline void add_atomic(long long *to, long long x) { *to += x; }
static inline void add_atomic(int *to, int x) { *to += x; }

#endif

#define THIS_WARP (THREAD / WARP)
#define THIS_LANE (THREAD % WARP)

// ---- Collectives: called between LANES inside EACH_WARP, by whole warps. ----

// peers: the lanes of the warp whose value is the same as the lane's own, one bit each.
static inline void match_lanes(Own<unsigned> &value, Own<unsigned> &peers) {
#if defined(__CUDACC__)
    *peers = __match_any_sync(~0u, *value);
#else
    for (int l = 0; l < WARP; l++) {
        peers.lane(l) = 0;
        for (int m = 0; m < WARP; m++) peers.lane(l) |= (unsigned)(value.lane(m) == value.lane(l)) << m;
    }
#endif
}

// Each lane's value becomes the sum of those up to and with its own.
static inline void scan_lanes(Own<int> &value) {
#if defined(__CUDACC__)
    for (int step = 1; step < WARP; step *= 2) {
        const int other = __shfl_up_sync(~0u, *value, step);
        if (THIS_LANE >= step) *value += other;
    }
#else
    for (int l = 1; l < WARP; l++) value.lane(l) += value.lane(l - 1);
#endif
}

// Every lane's value becomes the sum over the warp, always added in the same order.
static inline void sum_lanes(Own<float> &value) {
#if defined(__CUDACC__)
    for (int step = WARP / 2; step; step /= 2) *value += __shfl_xor_sync(~0u, *value, step);
#else
    for (int step = WARP / 2; step; step /= 2) {
        float before[WARP];
        for (int l = 0; l < WARP; l++) before[l] = value.lane(l);
        for (int l = 0; l < WARP; l++) value.lane(l) = before[l] + before[l ^ step];
    }
#endif
}

template <int COUNT> struct Sums {
    float of[COUNT];
};

// One round of adding VALUES numbers, from number `first` on, over the lanes: of two partners `step` lanes apart, the
// lower keeps the first half of them and the upper the second, each adds what the other hands over, and the number of
// numbers is halved.
template <int VALUES, int COUNT> static inline void fold_lanes(Own<Sums<COUNT>> &value, int first, int step) {
    enum { HALF = VALUES / 2 };
#if defined(__CUDACC__)
    float *v = value->of + first;
    const bool upper = THREAD & step;
#pragma unroll
    for (int i = 0; i < HALF; i++) {
        const float kept = upper ? v[i + HALF] : v[i], given = upper ? v[i] : v[i + HALF];
        v[i] = kept + __shfl_xor_sync(~0u, given, step);
    }
#else
    Sums<COUNT> before[WARP];
    for (int l = 0; l < WARP; l++) before[l] = value.lane(l);
    for (int l = 0; l < WARP; l++)
        for (int i = first; i < first + HALF; i++) {
            const int at = l & step ? i + HALF : i;
            value.lane(l).of[i] = before[l].of[at] + before[l ^ step].of[at];
        }
#endif
}

// The sum of number `at` of both partners, for both.
template <int COUNT> static inline void pair_lanes(Own<Sums<COUNT>> &value, int at, int step) {
#if defined(__CUDACC__)
    value->of[at] += __shfl_xor_sync(~0u, value->of[at], step);
#else
    float before[WARP];
    for (int l = 0; l < WARP; l++) before[l] = value.lane(l).of[at];
    for (int l = 0; l < WARP; l++) value.lane(l).of[at] = before[l] + before[l ^ step];
#endif
}

// out[i] = the sum over the warp of value->of[i], for 16 or 24 numbers: 16 and 25 shuffles, where one number after the
// other would take 80 and 120. The values are used up.
template <int COUNT> static inline void sum_columns(Own<Sums<COUNT>> &value, float *out) {
    static_assert(COUNT == 16 || COUNT == 24, "sums come in sixteens and eights");
    fold_lanes<16>(value, 0, 16), fold_lanes<8>(value, 0, 8), fold_lanes<4>(value, 0, 4), fold_lanes<2>(value, 0, 2);
    pair_lanes(value, 0, 1);
    if (COUNT == 24) {
        fold_lanes<8>(value, COUNT - 8, 16), fold_lanes<4>(value, COUNT - 8, 8), fold_lanes<2>(value, COUNT - 8, 4);
        pair_lanes(value, COUNT - 8, 2), pair_lanes(value, COUNT - 8, 1);
    }
    LANES {
        if (THIS_LANE % 2 == 0) out[THIS_LANE / 2] = value->of[0];
        if (COUNT == 24 && THIS_LANE % 4 == 0) out[16 + THIS_LANE / 4] = value->of[COUNT - 8];
    }
}

// Each thread's value becomes the sum over the threads before it; returns the sum over all. totals: shared memory for
// WARPS + 1 ints, free to use again after the next barrier. Call it between phases.
static inline int scan_block(Own<int> &value, int *totals) {
    Own<int> own;
    EACH_WARP {
        LANES { *own = *value; }
        scan_lanes(value);
        LANES {
            if (THIS_LANE == WARP - 1) totals[THIS_WARP + 1] = *value;
        }
    }
    PHASE {
        int sum = -*own;
        for (int w = 1; w <= THIS_WARP; w++) sum += totals[w];
        *value += sum;
    }
    int all = 0;
    for (int w = 1; w <= WARPS; w++) all += totals[w];
    return all;
}
