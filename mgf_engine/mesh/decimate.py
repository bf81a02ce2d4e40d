# SPDX-License-Identifier: GPL-3.0-or-later
"""Simplify a mesh by edge collapses within bounds on its geometric and colour error.

The kernel (``native/csrc/mesh/collapse.c``) tests every vertex of the full mesh against the simplified one, so the
bound holds for all of them; topology is preserved.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mgf_engine.model.mesh import Mesh
from mgf_engine.native.library import call, parallel

LEAST_PROGRESS = 0.002  # share of the faces that a sweep must remove to be repeated with the same slabs
MOST_LOOSENING = 1e6  # factor on the tolerances at which loosening them ends
MOST_SLABS, SLAB_FACES = 32, 16384  # maximum number of slabs, and minimum number of faces in each
SLABS_PER_REPORT = 8  # number of slabs between two progress reports
NO_MEMORY = "Not enough memory to reduce the mesh; lower max_gaussians or the resolution."


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
        left = _collapse_within(handle, order, count, progress) if lean else count
        if not lean or left > most:
            _collapse_down_to(handle, order, left, most, float(color_tolerance))
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


def _collapse_within(handle: int, order: NDArray[np.int32], count: int, progress: Callable[[float], None]) -> int:
    """Collapse edges within the tolerances; return the number of faces left.

    The slabs grow with the faces, up to the whole mesh: an edge that crosses the border of a slab needs a wider one.
    """
    number, rounds = MOST_SLABS, 0
    while True:
        before, number = count, min(number, max(1, count // SLAB_FACES))
        cut = slabs(order, number, shifted=rounds % 2 == 1)
        left = 0.3**rounds  # of the bar: each sweep moves it by 0.7 of what the one before left

        def report(share: float, left: float = left) -> None:
            progress(1 - left * (1 - 0.7 * share))

        count = _sweep(handle, order, cut, 0, report)
        rounds += 1
        if before - count > LEAST_PROGRESS * before:
            continue
        if number == 1:
            return count
        number //= 2


def _collapse_down_to(handle: int, order: NDArray[np.int32], count: int, most: int, color_tolerance: float) -> None:
    """Collapse down to ``most`` faces; loosen the tolerances, the colour tolerance first, until that is met."""
    whole, loose = slabs(order, 1), 1.0
    while loose <= MOST_LOOSENING:
        before, count = count, _sweep(handle, order, whole, most)
        if count <= most:
            return
        if before - count > LEAST_PROGRESS * before:
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
    for first in range(0, last, SLABS_PER_REPORT):
        progress(first / last)
        end = min(first + SLABS_PER_REPORT, last)
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
