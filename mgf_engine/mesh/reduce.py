# SPDX-License-Identifier: GPL-3.0-or-later
"""No more faces than the building needs: edges collapse as long as the surface and its colours stay what they are.

The kernel (``raster/kernels/collapse.c``) keeps every vertex of the full mesh as a sample and checks it against the
reduced one, so the bound holds for every sample, and topology cannot change. How far off a vertex may be is
measured in ground pixels: what one pixel of the nearest photo covers there.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mgf_engine.mesh.colors import vertex_normals
from mgf_engine.mesh.model import Mesh
from mgf_engine.raster.library import call
from mgf_engine.scene.model import View

NEAREST = 8  # views among which one is sought that a vertex faces


def ground_pixels(mesh: Mesh, views: Sequence[View]) -> NDArray[np.float32]:
    """Size of a pixel of the nearest view that each vertex faces, in the mesh's units, float32 [N].

    What may stand between is not looked at: such a pixel is at worst smaller than the ones that show the vertex.
    Where none of the nearest views is faced, the very nearest counts; without views all get zero.
    """
    if not views or not len(mesh.vertices):
        return np.zeros(len(mesh.vertices), np.float32)
    centres = np.array([view.centre for view in views])
    pixels = np.array([1.0 / max(view.fx, view.fy) for view in views])
    distance, nearest = cKDTree(centres).query(
        mesh.vertices, k=list(range(1, min(NEAREST, len(views)) + 1)), workers=-1
    )
    normals = vertex_normals(mesh)
    size = (distance[:, 0] * pixels[nearest[:, 0]]).astype(np.float32)
    missing = np.ones(len(size), bool)
    for k in range(nearest.shape[1]):
        faced = missing & (((centres[nearest[:, k]] - mesh.vertices) * normals).sum(1) > 0)
        size[faced] = distance[faced, k] * pixels[nearest[faced, k]]
        missing &= ~faced
    return size


def reduce_faces(
    mesh: Mesh, most: int = 0, tolerance: NDArray[np.float32] | float = 0.0, color_tolerance: float = -1.0
) -> Mesh:
    """The mesh with fewer faces: as few as the tolerances allow, and at most ``most``.

    Manifold meshes stay manifold, holes and parts stay as many as they are, rims stay where they are. Where ``most``
    cannot be met within the tolerances they are loosened, those of colours first.

    Args:
        most: highest number of faces; 0 for no limit. Topology may not allow it; the result then has a few more.
        tolerance: distance that each given vertex may have from the result, [N] or one for all; 0 keeps every face
            beyond ``most``.
        color_tolerance: root mean square difference of colours around each collapsed edge, in grey levels per
            channel; below zero colours do not matter.

    Raises:
        MemoryError: the work needs about 350 bytes per vertex.
    """
    count = len(mesh.faces)
    allowed = np.broadcast_to(np.asarray(tolerance, np.float32), len(mesh.vertices))
    lean = bool((allowed > 0).any())
    most = most if 0 < most < count else count
    if count == 0 or (most == count and not lean):
        return mesh
    centre = mesh.vertices.mean(0)
    at = np.ascontiguousarray(mesh.vertices - centre)
    if not lean:
        allowed = np.full(len(at), 1e-3 * np.linalg.norm(np.ptp(at, axis=0)), np.float32)
    faces = np.array(mesh.faces, np.int32, order="C")
    colors = np.empty((len(at), 3), np.uint8)
    left = call(
        "collapse_edges", len(at), count, at, faces, at.astype(np.float32), np.ascontiguousarray(allowed),
        np.ascontiguousarray(mesh.colors), float(color_tolerance), most, int(lean), colors,
    )  # fmt: skip
    if left < 0:
        raise MemoryError("Not enough memory to reduce the mesh; lower max_gaussians or the resolution.")
    used, index = np.unique(faces[faces[:, 0] >= 0], return_inverse=True)
    vertices = at[used] + centre
    return Mesh(vertices, index.reshape(-1, 3).astype(np.int32), colors[used], _nearest_values(mesh, vertices))


def _nearest_values(mesh: Mesh, vertices: NDArray[np.float64]) -> dict[str, NDArray[np.generic]]:
    """The values of the given mesh's vertices that lie nearest."""
    if not mesh.values:
        return {}
    nearest = cKDTree(mesh.vertices).query(vertices)[1]
    return {name: value[nearest] for name, value in mesh.values.items()}
