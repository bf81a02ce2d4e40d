# SPDX-License-Identifier: GPL-3.0-or-later
"""Measure the relief of a wall that is flattened: mouldings, frames and ornament that stand out by less than a pixel.

Stereo errs from vertex to vertex, and in waves wider than a window frame. The height over the plane between these two
scales (a difference of Gaussians) is kept as far as its local power exceeds that of the noise (the Wiener filter of
Lee, *Digital image enhancement and noise filtering by use of local statistics*, 1980), and where photos have contrast
and agree. What lies deeper than its surroundings is not kept: walls sink around windows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from mgf_engine.geometry.normals import vertex_normals
from mgf_engine.mesh.photo_consistency import PatchPhotos, compare_patches
from mgf_engine.mesh.plane_detection import Planes
from mgf_engine.model.mesh import Mesh
from mgf_engine.options.algorithms import parameter

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True)
class ReliefOptions:
    """Options of relief on planes."""

    grain: float = parameter(1.5, "Standard deviation of the Gaussian that removes noise from vertex to vertex",
                             "ground px", low=0.1)  # fmt: skip
    waves: float = parameter(8.0, "Standard deviation of the Gaussian whose mean is not relief", "ground px", low=0.1)
    noise: float = parameter(0.25, "Standard deviation of noise between these two scales", "ground px")
    window: float = parameter(5.0, "Standard deviation of the Gaussian over which the power of relief is measured",
                              "ground px", low=0.1)  # fmt: skip
    contrast: tuple[float, float] = parameter(
        (4.0, 8.0), "Standard deviation of a patch up to which no relief is kept, and from which all is", "grey levels"
    )
    correlation: tuple[float, float] = parameter(
        (0.7, 0.9), "Correlation of patches between photos up to which no relief is kept, and from which all is"
    )
    band: float = parameter(1.0, "Distance from a plane up to which a vertex may belong to its relief", "ground px")


@dataclass(frozen=True)
class Relief:
    """What tells relief from noise.

    Attributes:
        photos: what sees the vertices.
        options: scales and noise.
    """

    photos: PatchPhotos
    options: ReliefOptions = ReliefOptions()

    def heights(self, mesh: Mesh, pixel: Array, planes: Planes, vertex: Index, plane: Index) -> Array:
        """Measure how far the relief at vertices stands out of their planes, in the mesh's units, [K].

        Args:
            mesh: of any frame.
            pixel: size of a ground pixel at each vertex, [N].
            planes: found on this mesh.
            vertex: numbers of vertices, [K].
            plane: the plane of each, [K].
        """
        off = planes.distances(mesh.vertices[vertex], plane) / pixel[vertex]
        height, near = np.zeros(len(vertex)), np.flatnonzero(np.abs(off) < self.options.band)
        order = near[np.argsort(plane[near], kind="stable")]
        for rows in np.split(order, np.flatnonzero(np.diff(plane[order])) + 1):
            if len(rows):
                across = np.linalg.svd(planes.normals[plane[rows[:1]]])[2][1:]
                flat = mesh.vertices[vertex[rows]] @ across.T / np.median(pixel[vertex[rows]])
                height[rows] = _relief(flat, off[rows], self.options)
        some = np.flatnonzero(height)
        at = vertex[some]
        correlation, contrast = compare_patches(self.photos, at, mesh.vertices[at], vertex_normals(mesh)[at], pixel[at])
        height[some] *= _ramp(correlation, self.options.correlation) * _ramp(contrast, self.options.contrast)
        return np.asarray(height * pixel[vertex])


def _relief(flat: Array, off: Array, options: ReliefOptions) -> Array:
    """Return the relief [K] of heights ``off`` [K] at places [K, 2] of a plane, all in ground pixels."""
    column, row = np.floor(flat - flat.min(0)).astype(np.int64).T
    shape = (int(column.max()) + 1, int(row.max()) + 1)
    cell = column * shape[1] + row
    count = shape[0] * shape[1]
    weight = np.bincount(cell, minlength=count).reshape(shape).astype(np.float64)
    sums = np.bincount(cell, off, count).reshape(shape).astype(np.float64)

    def mean(values: Array, sigma: float) -> Array:
        smooth = [gaussian_filter(grid, sigma, mode="constant") for grid in (values, weight)]
        return np.asarray(smooth[0] / np.maximum(smooth[1], 1e-12))

    height = mean(sums, options.grain) - mean(sums, options.waves)
    power = mean(weight * height**2, options.window)
    kept = height * np.maximum(1 - options.noise**2 / np.maximum(power, 1e-12), 0)
    return np.asarray(np.maximum(kept, 0)[column, row])


def _ramp(value: Array, ends: tuple[float, float]) -> Array:
    """Return 0 up to the first of two values, 1 from the second, and a straight line between."""
    return np.clip((value - ends[0]) / max(ends[1] - ends[0], 1e-12), 0, 1)
