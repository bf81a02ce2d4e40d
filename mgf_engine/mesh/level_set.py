# SPDX-License-Identifier: GPL-3.0-or-later
"""Extract the level set of a field by marching tetrahedra."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from dataclasses import field as dataclass_field

import numpy as np
from numpy.typing import NDArray

from mgf_engine.errors import BadInput
from mgf_engine.geometry import clean
from mgf_engine.mesh.isosurface import Crossing, find_level, march
from mgf_engine.mesh.surface_field import SurfaceField
from mgf_engine.mesh.tetra_blocks import TetraBlocks, join_blocks
from mgf_engine.mesh.tetrahedra import TetraPoints
from mgf_engine.model.mesh import Mesh
from mgf_engine.system.timing import PartTimes


@dataclass(frozen=True)
class Reporting:
    """Callbacks of the level set extraction.

    Attributes:
        progress: called with the share that is done, 0..1.
        began: called with the number of each block when it begins.
        times: records the time of tetrahedra and level set.
    """

    progress: Callable[[float], None] = lambda share: None
    began: Callable[[int], None] = lambda number: None
    times: PartTimes = dataclass_field(default_factory=PartTimes)


def extract_level_set(
    blocks: TetraBlocks,
    make_tetrahedra: Callable[[int], NDArray[np.int32]],
    field: SurfaceField,
    steps: int,
    reporting: Reporting = Reporting(),
    merge: Callable[[Mesh], Mesh] = lambda mesh: mesh,
) -> Mesh:
    """Extract the surface O(x) = level between solid and free corners of the tetrahedra.

    Args:
        blocks: points of the tetrahedra.
        make_tetrahedra: number of a block -> its tetrahedra, int32 [T, 4].
        field: classifies points as solid or free.
        steps: maximum number of root-finding steps on each edge.
        reporting: callbacks.
        merge: merges vertices of a block's mesh, except those on its borders; called if there are several blocks.

    Raises:
        BadInput: there is no surface: everything is free, solid or unseen.
    """
    count, crossed, times = len(blocks.members), list[int](), reporting.times
    with times.part("tetrahedra"):
        state = field.classify(blocks.sites.points)

    def mesh_of(number: int) -> Mesh:
        def report(share: float) -> None:
            reporting.progress((number + share) / count)

        with times.part("tetrahedra"):
            crossing = march(make_tetrahedra(number), state, blocks.sites.points)
            crossed.append(len(crossing.faces))
        with times.part("level set"):
            mesh = _place_vertices(blocks.sites, crossing, field, steps, report)
            return mesh if count < 2 else merge(clean.weld(clean.with_faces(mesh, mesh.faces)))

    mesh = mesh_of(0) if count < 2 else join_blocks(blocks, state, mesh_of, reporting.began)
    if len(mesh.faces) == 0 and not any(crossed):
        raise BadInput("The field has no surface inside the masks; train longer, or check the masks and the cameras.")
    return mesh


def _place_vertices(
    sites: TetraPoints,
    crossing: Crossing,
    field: SurfaceField,
    steps: int,
    progress: Callable[[float], None],
) -> Mesh:
    """Place a vertex on each crossing edge; leave out faces with an overlong edge."""
    kept = crossing.faces[~_find_overlong(sites, crossing.edges)[crossing.faces].any(1)]
    solid, free = (sites.points[crossing.edges[:, k]] for k in range(2))

    def signed(points: NDArray[np.float64], share: float) -> NDArray[np.float32]:
        return field.signed(points, lambda step: progress(share + step / max(steps, 1)))

    vertices = find_level(solid, free, signed, steps)
    return Mesh(vertices, kept, np.zeros((len(vertices), 3), np.uint8))


def _find_overlong(sites: TetraPoints, edges: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Find the edges longer than the extents of their two Gaussians together, which span empty space, bool [E]."""
    length = np.linalg.norm(sites.points[edges[:, 0]] - sites.points[edges[:, 1]], axis=1)
    too_long: NDArray[np.bool_] = length > sites.extent[edges].sum(1)
    return too_long
