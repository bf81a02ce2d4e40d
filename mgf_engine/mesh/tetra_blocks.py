# SPDX-License-Identifier: GPL-3.0-or-later
"""Make the tetrahedra in blocks, one after another: those of a large building would need too much memory at once.

Points on the borders belong to the blocks on both sides, see :mod:`mgf_engine.geometry.block_grid`, so that both have
the same edges there and the level set has no seam.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mgf_engine.geometry.block_grid import WHOLE, BlockGrid, make_grid, with_borders
from mgf_engine.geometry.block_store import BlockStore
from mgf_engine.geometry.delaunay import background_delaunay, spans_volume
from mgf_engine.mesh.tetrahedra import TetraPoints
from mgf_engine.model.mesh import Mesh
from mgf_engine.system.machine import release_memory

#: (number of a block, check) -> its tetrahedra, int32 [T, 4]; ``check`` is called while waiting, and may raise.
Made = Callable[[int, Callable[[], None]], NDArray[np.int32]]


@dataclass(frozen=True)
class TetraBlocks:
    """Points of the tetrahedra, and the blocks that they are joined in.

    Attributes:
        sites: all points, those of the borders included.
        members: numbers of the points of each block, [B] arrays; one block has all.
        grid: of the blocks.
    """

    sites: TetraPoints
    members: Sequence[NDArray[np.int64]]
    grid: BlockGrid = WHOLE

    def on_border(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Tell which points [N, 3] lie on a border of two blocks, bool [N]."""
        return np.asarray(self.grid.on_border(points).any(1))

    def near_border(self, points: NDArray[np.float64], reach: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Tell which points [N, 3] lie within their reach [N] of a border, bool [N]."""
        result = np.zeros(len(points), bool)
        for axis, cuts in enumerate(self.grid.cuts):
            for cut in cuts:
                result |= np.abs(points[:, axis] - cut) <= reach
        return result


def divide_into_blocks(sites: TetraPoints, count: int) -> TetraBlocks:
    """Divide points into at most ``count`` blocks; blocks without tetrahedra are left out.

    Args:
        sites: the points.
        count: number of blocks, 1 or more.
    """
    if count == 1:
        return TetraBlocks(sites, [np.arange(len(sites.points))])
    grid = make_grid(sites.points, count)
    points, extent = with_borders(sites.points, sites.extent, grid)
    members = [rows for rows in grid.members(points) if spans_volume(points[rows])]
    return TetraBlocks(TetraPoints(points, extent), members, grid)


@contextlib.contextmanager
def tetrahedra_in_background(blocks: TetraBlocks) -> Iterator[Made]:
    """Make the tetrahedra of the first block in the background; yield a function that makes those of any block.

    Raises:
        BadInput: as :func:`mgf_engine.geometry.delaunay.background_delaunay`, here or from the function.
    """
    points, members = blocks.sites.points, blocks.members
    if len(members) < 2:
        with background_delaunay(points) as whole:
            yield lambda number, check: whole(check)
        return
    with contextlib.ExitStack() as first:
        early = first.enter_context(background_delaunay(points[members[0]], points))

        def made(number: int, check: Callable[[], None]) -> NDArray[np.int32]:
            rows = members[number].astype(np.int32)
            if number == 0:
                return rows[early(check)]
            first.close()
            with background_delaunay(points[rows], points) as block:
                return rows[block(check)]

        yield made


def join_blocks(
    blocks: TetraBlocks, state: NDArray[np.uint8], mesh_of: Callable[[int], Mesh], began: Callable[[int], None]
) -> Mesh:
    """Make and join the meshes of all blocks, one after another, so that only one block's tetrahedra are in memory.

    Blocks that an interrupted run has finished are not repeated. Vertices on borders occur once for each block, at
    exactly the same position.

    Args:
        blocks: points, and which of them each block has.
        state: FREE, SOLID or INVALID for each point, uint8 [M].
        mesh_of: makes the mesh of a block.
        began: called with the number of each block before.
    """
    store, found = BlockStore("mesh", blocks.sites.points, state, *blocks.members), list[Mesh]()
    for number in range(len(blocks.members)):
        began(number)
        done = store.load(number)
        mesh = mesh_of(number) if done is None else mesh_without_colors(**done)
        if done is None:
            store.save(number, vertices=mesh.vertices, faces=mesh.faces)
        found.append(mesh)
        release_memory()
    offset = np.cumsum([0, *(len(mesh.vertices) for mesh in found[:-1])])
    faces = [mesh.faces + np.int32(first) for mesh, first in zip(found, offset, strict=True)]
    return mesh_without_colors(np.concatenate([mesh.vertices for mesh in found]), np.concatenate(faces))


def mesh_without_colors(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> Mesh:
    """Return the mesh of vertices [N, 3] and faces [F, 3], all black."""
    return Mesh(vertices, faces, np.zeros((len(vertices), 3), np.uint8))
