# SPDX-License-Identifier: GPL-3.0-or-later
"""The tetrahedra of the mesh, block after block: those of a large building need more memory than anything else.

Points on the borders are shared by the blocks at both sides, see :mod:`mgf_engine.geometry.blocks`, so that the level
set goes on across a border without a seam: the same edges cross it in the same places.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mgf_engine.geometry.blocks import make_grid, with_borders
from mgf_engine.geometry.delaunay import begun, spans_volume
from mgf_engine.mesh.tetrahedra import TetraPoints

Made = Callable[[Callable[[], None]], Iterator[NDArray[np.int32]]]


@dataclass(frozen=True)
class TetraBlocks:
    """Points of the tetrahedra, and the blocks that they are joined in.

    Attributes:
        spanned: all points, those of the borders included.
        members: numbers of the points of each block, [B] arrays; one block has all.
    """

    spanned: TetraPoints
    members: Sequence[NDArray[np.int64]]


def divide(spanned: TetraPoints, count: int) -> TetraBlocks:
    """Divide points into at most ``count`` blocks; those without tetrahedra are left out.

    Args:
        spanned: the points.
        count: number of blocks, 1 or more.
    """
    if count == 1:
        return TetraBlocks(spanned, [np.arange(len(spanned.points))])
    grid = make_grid(spanned.points, count)
    points, extent = with_borders(spanned.points, spanned.extent, grid)
    members = [rows for rows in grid.members(points) if spans_volume(points[rows])]
    return TetraBlocks(TetraPoints(points, extent), members)


@contextlib.contextmanager
def tetrahedra_begun(blocks: TetraBlocks) -> Iterator[Made]:
    """Begin the tetrahedra of the first block beside what is done inside; gives a function that makes all.

    That function takes a check that is called while it waits, and may raise to cancel; it yields the corners of each
    block's tetrahedra, [T, 4].

    Raises:
        BadInput: as :func:`mgf_engine.geometry.delaunay.begun`, here or from the function.
    """
    points = blocks.spanned.points
    if len(blocks.members) < 2:
        with begun(points) as whole:
            yield lambda check: iter([whole(check)])
        return
    with contextlib.ExitStack() as ending:
        early = ending.enter_context(begun(points[blocks.members[0]], points))

        def all_of_them(check: Callable[[], None]) -> Iterator[NDArray[np.int32]]:
            for number, rows in enumerate(blocks.members):
                made = ending.enter_context(begun(points[rows], points)) if number else early
                yield rows.astype(np.int32)[made(check)]
                ending.close()

        yield all_of_them
