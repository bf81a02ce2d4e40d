# SPDX-License-Identifier: GPL-3.0-or-later
"""Merge vertices in flat parts of the level set (vertex clustering), to speed up all later steps.

The tetrahedra are as small as the Gaussians, even on plain walls. Vertices in one plane and one grid cell are merged;
edges, bars and whatever is thinner than a cell keep every vertex (``native/csrc/mesh/merge_flat.c``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mgf_engine.geometry.clean import weld
from mgf_engine.geometry.morton import BITS, arrange, morton
from mgf_engine.mesh.ground_pixels import nearest_pixels
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.scene import View
from mgf_engine.model.topology import Adjacency
from mgf_engine.native.library import call
from mgf_engine.options.algorithms import parameter


@dataclass(frozen=True)
class PlanarClusteringOptions:
    """Options of merging vertices in flat areas; px are pixels of the nearest photo."""

    cells: tuple[float, float] = parameter((1.5, 3.0), "Sides of the cells, one round after the other", "px", low=0.01)
    tolerance: float = parameter(0.1, "Maximum root mean square distance from the plane", "px")
    even: float = parameter(
        0.98, "Minimum length of the mean normal in and around a cell; 0.98 is an edge of 23 degrees", high=1
    )
    tries: int = parameter(3, "Number of rounds that undo what would pinch the surface")


def merge_flat(
    mesh: Mesh,
    views: Sequence[View],
    options: PlanarClusteringOptions = PlanarClusteringOptions(),
    kept: Callable[[NDArray[np.float64]], NDArray[np.bool_]] | None = None,
) -> Mesh:
    """Merge the vertices that lie in one plane and one cell.

    Args:
        mesh: vertices with colours, and faces.
        views: at least one, in the mesh's frame, for the size of a ground pixel.
        options: size of the cells, and the flatness that is required.
        kept: vertices [N, 3] -> bool [N], vertices that are not merged; None for none.

    Raises:
        MemoryError: about 100 bytes per vertex are not available.
    """
    for side in options.cells:
        pixel = nearest_pixels(mesh.vertices, views)
        cell = _cells(mesh.vertices, side * pixel)
        if kept is not None:
            alone = np.flatnonzero(kept(mesh.vertices))
            cell[alone] = len(cell) + np.arange(len(alone))
        mesh = merge_cells(mesh, cell, options.tolerance * pixel, options)
    return mesh


def merge_cells(
    mesh: Mesh,
    cell: NDArray[np.integer],
    tolerance: NDArray[np.floating],
    options: PlanarClusteringOptions = PlanarClusteringOptions(),
) -> Mesh:
    """Merge once, see :func:`merge_flat`.

    Args:
        mesh: vertices with colours, and faces.
        cell: number of each vertex's cell, [N].
        tolerance: root mean square distance from the plane, [N]; the first vertex of a group counts.
        options: how plane a cell must be.

    Raises:
        MemoryError: the work needs more than is free.
    """
    at, into = np.array(mesh.vertices, np.float64, order="C"), np.empty(len(mesh.vertices), np.int32)
    given = np.ascontiguousarray(mesh.faces), np.asarray(cell, np.int32), np.asarray(tolerance, np.float32)
    if call("mgf_merge_flat", len(at), len(mesh.faces), at, *given, options.even, into):
        raise MemoryError("Not enough memory to merge flat parts of the mesh; lower max_gaussians or the resolution.")
    for _ in range(options.tries):
        apart = _find_pinched(into, mesh.faces)
        if not apart.any():
            break
        into[apart], at[apart] = np.flatnonzero(apart), mesh.vertices[apart]
    return weld(Mesh(at, into[mesh.faces], mesh.colors, mesh.values))


def _find_pinched(into: NDArray[np.int32], faces: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Find merged vertices [N] at which the surface touches itself: two discs whose rims share two edges."""
    merged = np.bincount(into, minlength=len(into)) > 1
    faces = into[faces]
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(1)]
    several = Adjacency.of(faces, len(into)).fans()[1] > 1
    near = np.zeros(len(into), bool)
    near[faces[several[faces].any(1)]] = True
    return np.asarray((near & merged)[into], bool)


def _cells(points: NDArray[np.float64], side: NDArray[np.float64]) -> NDArray[np.int32]:
    """Return the number of the cell that each point [N, 3] lies in; sides [N] are rounded to powers of two."""
    if not len(points):
        return np.zeros(0, np.int32)
    local = points - points.min(0)
    least = max(float(local.max()) / 2 ** (BITS - 1), 1e-300)
    level = np.rint(np.log2(np.maximum(side, least)))
    order, new = arrange(morton(np.floor(local / np.exp2(level)[:, None]).astype(np.int64)), level)
    cell = np.empty(len(points), np.int32)
    cell[order] = np.cumsum(new) - 1
    return cell
