// SPDX-License-Identifier: GPL-3.0-or-later
// What blending backward leaves for each entry of the tile lists: sums over the pixels of that tile.
#pragma once

enum {
    SUM_QX, SUM_QY, SUM_QXX, SUM_QXY, SUM_QYY,             // sum gq x^i y^j, gq = dL/dq, (x, y) = pixel - centre
    SUM_A, SUM_AX, SUM_AY, SUM_AXX, SUM_AXY, SUM_AYY,      // the same of gA = dL/dA
    SUM_OPACITY,                                           // dL / d log(alpha)
    SUM_R, SUM_G, SUM_B,
    SUM_WEIGHT,                                            // sum w, the weight of the Gaussian
    SUM_B0, SUM_BX, SUM_BY,                                // sum gB, gB x, gB y, gB = dL/dB
    SUM_NX, SUM_NY, SUM_NZ,
    SUM_ERROR,                                             // sum w * error of the pixel
    SUM_MOTION,                                            // sum |dL/d centre|, each pixel's own, centre in half frames
    SUM_SIZE,
};
