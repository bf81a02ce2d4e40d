# SPDX-License-Identifier: GPL-3.0-or-later
"""Size of a ground pixel: what a pixel of the nearest photo covers on the surface. Most distances here are in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mgf_engine.geometry.normals import vertex_normals
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.scene import View

NEAREST = 64  # number of nearest views among which one is sought that shows a vertex
VERTICES_AT_ONCE = 65536  # number of vertices for which these are sought together


def nearest_pixels(points: NDArray[np.float64], views: Sequence[View]) -> NDArray[np.float64]:
    """Compute the size of a pixel of the nearest view at each point [N, 3], in their units, [N]."""
    distance, nearest = cKDTree([view.centre for view in views]).query(points, workers=-1)
    sizes: NDArray[np.float64] = distance / np.array([max(view.fx, view.fy) for view in views])[nearest]
    return sizes


def ground_pixels(mesh: Mesh, views: Sequence[View]) -> NDArray[np.float32]:
    """Compute the size of a ground pixel at each vertex, in the mesh's units, float32 [N].

    It is the size of a pixel of the nearest view that shows the vertex: the vertex faces it and lies in its frame. In a
    court, the nearest cameras look away. Where no view shows the vertex, it is that of the nearest view that it faces,
    then of the nearest view; zero without views. Occlusion is ignored: it makes the value too small at worst.
    """
    if not views or not len(mesh.vertices):
        return np.zeros(len(mesh.vertices), np.float32)
    cameras = _Cameras.of(views)
    tree = cKDTree(cameras.centres)
    pixels = np.array([1.0 / max(view.fx, view.fy) for view in views])
    normals = vertex_normals(mesh)
    distance, nearest = tree.query(mesh.vertices, workers=-1)
    size = (distance * pixels[nearest]).astype(np.float32)
    hidden = np.flatnonzero(~cameras.show(mesh.vertices, normals, nearest))
    for rows in np.array_split(hidden, -(-len(hidden) // VERTICES_AT_ONCE) or 1):  # for these more views are sought
        vertices, directions = mesh.vertices[rows], normals[rows]
        distance, nearest = tree.query(vertices, k=list(range(1, min(NEAREST, len(views)) + 1)), workers=-1)
        found = np.zeros(len(rows), bool)
        for shows in (cameras.show, cameras.are_faced):
            for k in range(nearest.shape[1]):
                left = np.flatnonzero(~found)
                good = left[shows(vertices[left], directions[left], nearest[left, k])]
                size[rows[good]] = distance[good, k] * pixels[nearest[good, k]]
                found[good] = True
    return size


@dataclass(frozen=True)
class _Cameras:
    """The views and their centres, [V, 3]."""

    views: Sequence[View]
    centres: NDArray[np.float64]

    @classmethod
    def of(cls, views: Sequence[View]) -> _Cameras:
        return cls(views, np.array([view.centre for view in views]))

    def are_faced(
        self, vertices: NDArray[np.float64], normals: NDArray[np.float64], number: NDArray[np.integer]
    ) -> NDArray[np.bool_]:
        """Tell which vertices [N, 3] look towards their view, of which the number is given, [N]."""
        towards: NDArray[np.bool_] = ((self.centres[number] - vertices) * normals).sum(1) > 0
        return towards

    def show(
        self, vertices: NDArray[np.float64], normals: NDArray[np.float64], number: NDArray[np.integer]
    ) -> NDArray[np.bool_]:
        """Tell which vertices [N, 3] look towards their view, [N], and lie in its frame."""
        shown = self.are_faced(vertices, normals, number)
        for view in np.unique(number[shown]):
            rows = np.flatnonzero(shown & (number == view))
            shown[rows] = self.views[view].project_into_frame(vertices[rows])[2]
        return shown
