// SPDX-License-Identifier: GPL-3.0-or-later
// vector.h for one number at a time: with it gaussian.h, harmonics.h, project.h and project_gradients.h, written for
// sixteen Gaussians a vector in C, become the code of one CUDA thread that looks after one Gaussian. Same names, same
// rules for NaN.
#pragma once
#include <stdint.h>  // NVRTC has no system headers: native/cuda/compiler.py hands it one of this name

#if defined(__CUDACC__)
#define __builtin_sqrt sqrt
#define __builtin_sqrtf sqrtf
#define __builtin_fabs fabs
#define __builtin_fabsf fabsf
#define __builtin_ceilf ceilf
#define __builtin_floorf floorf
#define __builtin_floor floor
#else
#include <math.h>
#endif

typedef float v16;
typedef int i16;
enum { VECTOR = 1 };  // lanes

typedef double d16;
static inline double widen(float x) { return x; }
static inline float narrow(double x) { return (float)x; }
static inline double dsqrt(double x) { return sqrt(x); }

static inline float splat(float x) { return x; }
static inline float choose(int m, float a, float b) { return m ? a : b; }
static inline float keep(int m, float a) { return m ? a : 0.0f; }
static inline int any(int m) { return m; }
static inline float vmin(float a, float b) { return a < b ? a : b; }
static inline float vmax(float a, float b) { return a > b ? a : b; }
static inline float vsqrt(float x) { return sqrtf(x); }
static inline float reciprocal(float x) { return 1.0f / x; }
static inline float exp2_16(float x) { return exp2f(vmax(x, -126.0f)); }
