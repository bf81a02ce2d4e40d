// SPDX-License-Identifier: GPL-3.0-or-later
// The image that blending writes, plane by plane.
#pragma once

// Planes of the image buffer. In an image without geometry only the first five exist.
enum {
    OUT_R, OUT_G, OUT_B, OUT_ALPHA, OUT_DEPTH, OUT_MEDIAN, OUT_NX, OUT_NY, OUT_NZ, OUT_DISTORTION,
    OUT_M1, OUT_M2,        // sum w m, sum w m^2 of the shifted mapped depth m (blend.c): kept for the backward pass
    OUT_PLANES,
    OUT_PLANES_BASIC = OUT_DEPTH + 1,
};

// Which outputs take part: colour and alpha; those and depth; everything.
enum { LEVEL_COLOR, LEVEL_DEPTH, LEVEL_ALL };
