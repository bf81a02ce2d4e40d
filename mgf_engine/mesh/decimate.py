# SPDX-License-Identifier: GPL-3.0-or-later
"""Simplify a mesh by edge collapses within bounds on its geometric and colour error.

The kernel (``native/csrc/mesh/collapse.c``) tests every vertex of the full mesh against the simplified one, so the
bound holds for all of them; topology is preserved. Tolerances are in ground pixels: the size on the surface of
a pixel of the nearest photo that shows it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mgf_engine.mesh.colors import vertex_normals
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.scene import View
from mgf_engine.native.library import call, parallel

NEAREST = 64  # number of nearest views among which one is sought that shows a vertex
VERTICES_AT_ONCE = 65536  # number of vertices for which these are sought together
WORTH = 0.002  # share of the faces that a sweep must remove to be repeated with the same slabs
MOST_LOOSE = 1e6  # factor on the tolerances at which loosening them ends
MOST_SLABS, SLAB = 32, 16384  # maximum number of slabs, and minimum number of faces in each
AT_ONCE = 8  # number of slabs between two progress reports
NO_MEMORY = "Not enough memory to reduce the mesh; lower max_gaussians or the resolution."


def ground_pixels(mesh: Mesh, views: Sequence[View]) -> NDArray[np.float32]:
    """Compute the size of a ground pixel at each vertex, in the mesh's units, float32 [N].

    It is the size of a pixel of the nearest view that shows the vertex: the vertex faces it and lies in its frame. In a
    court, the nearest cameras look away. Where no view shows the vertex, it is that of the nearest view that it faces,
    then of the nearest view; zero without views. Occlusion is ignored: it makes the value too small at worst.
    """
    if not views or not len(mesh.vertices):
        return np.zeros(len(mesh.vertices), np.float32)
    centres = np.array([view.centre for view in views])
    tree = cKDTree(centres)
    pixels = np.array([1.0 / max(view.fx, view.fy) for view in views])
    normals = vertex_normals(mesh)
    distance, nearest = tree.query(mesh.vertices, workers=-1)
    size = (distance * pixels[nearest]).astype(np.float32)
    hidden = np.flatnonzero(~_shown(mesh.vertices, normals, centres, views, nearest))
    for rows in np.array_split(hidden, -(-len(hidden) // VERTICES_AT_ONCE) or 1):  # for these more views are sought
        vertices, directions = mesh.vertices[rows], normals[rows]
        distance, nearest = tree.query(vertices, k=list(range(1, min(NEAREST, len(views)) + 1)), workers=-1)
        found = np.zeros(len(rows), bool)
        for shows in (_shown, _faced):
            for k in range(nearest.shape[1]):
                left = np.flatnonzero(~found)
                good = left[shows(vertices[left], directions[left], centres, views, nearest[left, k])]
                size[rows[good]] = distance[good, k] * pixels[nearest[good, k]]
                found[good] = True
    return size


def _faced(
    vertices: NDArray[np.float64],
    normals: NDArray[np.float64],
    centres: NDArray[np.float64],
    views: Sequence[View],
    number: NDArray[np.integer],
) -> NDArray[np.bool_]:
    """Tell which vertices [N, 3] look towards their view, of which the number is given, [N]."""
    towards: NDArray[np.bool_] = ((centres[number] - vertices) * normals).sum(1) > 0
    return towards


def _shown(
    vertices: NDArray[np.float64],
    normals: NDArray[np.float64],
    centres: NDArray[np.float64],
    views: Sequence[View],
    number: NDArray[np.integer],
) -> NDArray[np.bool_]:
    """Tell which vertices [N, 3] look towards their view, [N], and lie in its frame."""
    shown = _faced(vertices, normals, centres, views, number)
    for view in np.unique(number[shown]):
        rows = np.flatnonzero(shown & (number == view))
        shown[rows] = views[view].project_into_frame(vertices[rows])[2]
    return shown


def reduce_faces(
    mesh: Mesh,
    most: int = 0,
    tolerance: NDArray[np.float32] | float = 0.0,
    color_tolerance: float = -1.0,
    progress: Callable[[float], None] = lambda share: None,
) -> Mesh:
    """Simplify a mesh to as few faces as the tolerances allow, and at most ``most``.

    Manifoldness, the number of holes and of components, and open borders are preserved. If ``most`` cannot be met
    within the tolerances, these are loosened, the colour tolerance first.

    Args:
        mesh: with or without colours.
        most: maximum number of faces; 0 for no limit. Topology may require a few more.
        tolerance: maximum distance of each vertex of ``mesh`` from the result, [N] or a scalar; 0 simplifies only as
            far as ``most`` requires.
        color_tolerance: maximum root mean square difference of colours around a collapsed edge, grey levels per
            channel; negative ignores colours.
        progress: called with the share of the faces that have been removed.

    Raises:
        MemoryError: about 350 bytes per vertex are not available.
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
    given = (at.astype(np.float32), np.ascontiguousarray(allowed), np.ascontiguousarray(mesh.colors))
    handle = call("mgf_collapse_begin", len(at), count, at, faces, *given, float(color_tolerance))
    if not handle:
        raise MemoryError(NO_MEMORY)
    try:
        order = np.argsort(at[:, np.argmax(np.ptp(at, axis=0))], kind="stable").astype(np.int32)
        left = _shrink(handle, order, count, progress) if lean else count
        if not lean or left > most:
            _force(handle, order, left, most, float(color_tolerance))
    finally:
        call("mgf_collapse_end", handle, colors)
    used, index = np.unique(faces[faces[:, 0] >= 0], return_inverse=True)
    vertices = at[used] + centre
    return Mesh(vertices, index.reshape(-1, 3).astype(np.int32), colors[used], _nearest_values(mesh, vertices))


def slabs(order: NDArray[np.int32], number: int, shifted: bool = False) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
    """Return the slices of as many vertices each; shifted, their borders lie in the middle of the others'.

    Args:
        order: int32 [N], the vertices along the axis that is cut.

    Returns:
        the slab of each vertex, uint8 [N], and where each slab begins in ``order``, int64 [slabs + 1].
    """
    half = np.arange(len(order)) * 2 * number // len(order)
    along = (half + (shifted and number > 1)) // 2
    slab = np.empty(len(order), np.uint8)
    slab[order] = along
    return slab, np.searchsorted(along, np.arange(along[-1] + 2)).astype(np.int64)


def _shrink(handle: int, order: NDArray[np.int32], count: int, progress: Callable[[float], None]) -> int:
    """Collapse edges within the tolerances; return the number of faces left.

    The slabs grow with the faces, up to the whole mesh: an edge that crosses the border of a slab needs a wider one.
    """
    number, rounds = MOST_SLABS, 0
    while True:
        before, number = count, min(number, max(1, count // SLAB))
        cut = slabs(order, number, shifted=rounds % 2 == 1)
        count = _sweep(handle, order, cut, 0, lambda share, n=rounds: progress(1 - 0.3**n * (1 - 0.7 * share)))  # type: ignore[misc]
        rounds += 1
        if before - count > WORTH * before:
            continue
        if number == 1:
            return count
        number //= 2


def _force(handle: int, order: NDArray[np.int32], count: int, most: int, color_tolerance: float) -> None:
    """Collapse down to ``most`` faces; loosen the tolerances, the colour tolerance first, until that is met."""
    whole, loose = slabs(order, 1), 1.0
    while loose <= MOST_LOOSE:
        before, count = count, _sweep(handle, order, whole, most)
        if count <= most:
            return
        if before - count > WORTH * before:
            continue
        if color_tolerance >= 0:
            color_tolerance = 4 * color_tolerance + 1 if color_tolerance < 64 else -1.0
        else:
            loose *= 2
        call("mgf_collapse_loosen", handle, loose, color_tolerance)


def _sweep(
    handle: int,
    order: NDArray[np.int32],
    cut: tuple[NDArray[np.uint8], NDArray[np.int64]],
    stop: int,
    progress: Callable[[float], None] = lambda share: None,
) -> int:
    """Try all edges whose neighbourhood changed since the last sweep; return the number of faces left."""
    slab, start = cut
    last = len(start) - 1
    for first in range(0, last, AT_ONCE):
        progress(first / last)
        end = min(first + AT_ONCE, last)
        parallel("mgf_collapse", handle, slab, order, start, first, end, stop, pieces=end - first)
    left = call("mgf_collapse_live", handle)
    if left < 0:
        raise MemoryError(NO_MEMORY)
    return left


def _nearest_values(mesh: Mesh, vertices: NDArray[np.float64]) -> dict[str, NDArray[np.generic]]:
    """Return the vertex attributes of the nearest vertices of the full mesh."""
    if not mesh.values:
        return {}
    nearest = cKDTree(mesh.vertices).query(vertices)[1]
    return {name: value[nearest] for name, value in mesh.values.items()}
