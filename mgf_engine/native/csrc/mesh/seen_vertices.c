// SPDX-License-Identifier: GPL-3.0-or-later
// Which vertices of a mesh a photo shows, and how well: large and straight is good.
#include "common/export.h"
#include "mesh/triangle.h"

typedef struct {
    Point centre;
    double focal, least;  // pixels; least cosine between normal and direction to the camera
} Camera;

/* index [n], weight [n] are filled with the vertices that a photo [height][width] shows and their weights: the square
   of the cosine of the angle at which each is seen, over that of the size of a pixel there. Returns how many there are.
   corners [n][3]: (u, v, 1 / depth), 1 / depth <= 0 for what is not in front; points, normals [n][3]; farthest: depth
   of the surface there, times `slack` that beyond which a vertex is hidden; inside: pixels that count. Those on the
   outermost pixels are left out. */
MGF_API int64_t mgf_seen_vertices(int64_t n, const double *corners, const Point *points, const Point *normals,
                                  const Camera *camera, const float *farthest, const uint8_t *inside, int64_t height,
                                  int64_t width, float slack, int64_t *index, float *weight) {
    int64_t count = 0;
    for (int64_t i = 0; i < n; i++) {
        const double u = corners[3 * i], v = corners[3 * i + 1], inverse = corners[3 * i + 2];
        if (!((inverse > 0) & (u > 1) & (v > 1) & (u < width - 1) & (v < height - 1))) continue;
        const int64_t at = (int64_t)v * width + (int64_t)u;
        if (!inside[at] || !(farthest[at] * slack * inverse >= 1)) continue;
        const Point toward = minus(camera->centre, points[i]);
        const double distance = sqrt(dot(toward, toward));
        const double facing = dot(normals[i], toward) / (distance > 1e-12 ? distance : 1e-12);
        if (!(facing > camera->least)) continue;
        const double size = camera->focal / distance;
        index[count] = i, weight[count++] = (float)(facing * facing * (size * size));
    }
    return count;
}
