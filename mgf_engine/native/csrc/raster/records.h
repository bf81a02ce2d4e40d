// SPDX-License-Identifier: GPL-3.0-or-later
// What the projection of one Gaussian hands to the kernels that blend it: 32 floats, and the camera they were made for.
//
// A Gaussian with centre m and covariance S (both in the camera frame, 3D filter included) answers a ray t -> t d,
// d = (x', y', 1), so that t is the depth along the optical axis, with its largest value on that ray (eq. 6-11):
//     power = -q / (2 A),   t* = B / A,   contribution = min(0.99, opacity * exp(power)),
// where, with (dx, dy) = pixel - projected centre,
//     q = q0 dx^2 + 2 q1 dx dy + q2 dy^2                       |r_c|^2 times the squared distance of ray and centre
//     A = 1 + a1 dx + a2 dy + a3 dx^2 + 2 a4 dx dy + a5 dy^2   |r|^2 / |r_c|^2, |r|^2 = d' S^-1 d,
//                                                              r_c: ray through the centre
//     B = b0 + b1 dx + b2 dy                                   m' S^-1 d / |r_c|^2
// Written around the projected centre, where q vanishes together with its gradient, the quotient has no cancellation
// in float32. A > 0 always. The set where contribution >= 1/255 is the conic q <= 2 ln(255 opacity) A: the exact
// footprint.
//
// A Gaussian is blended into a pixel when, front to back by depth of the centres,
//     transmittance before it > 1e-4,   opacity * exp(power) > 1/255,   t* > near.
#pragma once
#include <stdint.h>

enum {
    REC_CX = 0,
    REC_CY = 1,  // projected centre, pixels (centre of the top-left pixel: 0.5, 0.5)
    REC_Q0 = 2,
    REC_Q1 = 3,
    REC_Q2 = 4,
    REC_A1 = 5,
    REC_A2 = 6,
    REC_A3 = 7,
    REC_A4 = 8,
    REC_A5 = 9,
    REC_B0 = 10,
    REC_B1 = 11,
    REC_B2 = 12,       // REC_B0 is the depth of the centre
    REC_OPACITY = 13,  // 3D filter included
    REC_R = 14,
    REC_G = 15,
    REC_B = 16,
    REC_NX = 17,
    REC_NY = 18,
    REC_NZ = 19,  // normal, camera frame, facing the camera
    REC_Y0 = 20,
    REC_Y1 = 21,         // footprint in y, pixels (infinite when it is no ellipse)
    REC_THRESHOLD = 22,  // log2(1 / (255 opacity)): contribution > 1/255 <=> power * log2(e) > this
    REC_RAY2 = 23,       // |r_c|^2 = d_c' S^-1 d_c; |r|^2 = REC_RAY2 * A
    REC_X0 = 24,
    REC_X1 = 25,      // footprint in x
    REC_RADIUS = 26,  // larger half extent of the footprint, pixels (half the diagonal at most)
    REC_SLOPE = 27,
    REC_WIDTH2 = 28,
    REC_FALL = 29,
    REC_Y_RIGHT = 30,  // shape of the footprint (footprint.h)
    REC_SIZE = 32,
};

enum { TILE = 16 };                                // tiles are 16 x 16 pixels

#define T_STOP 1e-4f                               // a pixel takes no more Gaussians from this transmittance on
#define ALPHA_MAX 0.99f
#define ALPHA_MIN (1.0f / 255.0f)
#define LOG2_E 1.44269504f

// The camera as Python packs it: 32 floats (api.py, Camera.packed).
typedef struct {
    float rotation[9];                             // row-major; camera = rotation * normalised + translation
    float translation[3];
    float centre[3];                               // of projection, normalised frame
    float fx, fy, cx, cy;                          // pixels
    float near, far;  // depth: nothing nearer is drawn; both scale the distortion (blend.c)
    float width, height;                           // pixels
    float unused[9];
} Camera;
