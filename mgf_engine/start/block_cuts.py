# SPDX-License-Identifier: GPL-3.0-or-later
"""Compute the starting surface block by block, since tetrahedra and graph of a large building take much memory.

The labels of a block depend on distant evidence, too: on rays that pass through it and on the volume of the whole. So
each minimum cut is of the whole building, with the points beyond a margin around the block merged in coarse cubes, and
the surface is clipped to the block. The parts need not form one closed surface: it is only rendered and sampled.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mgf_engine.geometry.block_grid import make_grid
from mgf_engine.geometry.block_store import BlockStore
from mgf_engine.geometry.clip import clip
from mgf_engine.model.mesh import Mesh
from mgf_engine.start.cut import cut_surface
from mgf_engine.start.evidence import Evidence, merge_points
from mgf_engine.start.options import MinimumCutOptions
from mgf_engine.start.views import StartViews

Array = NDArray[np.float64]
Cut = tuple[Mesh, NDArray[np.float32]]


def cut_in_blocks(
    views: StartViews,
    evidence: Evidence,
    options: MinimumCutOptions,
    check: Callable[[], None],
    began: Callable[[str], None],
) -> Cut:
    """Compute the starting surface by minimum cuts of ``options.blocks`` blocks.

    Args:
        views: cameras and masks.
        evidence: points, their rays and their planes.
        options: number of blocks, margin and weights.
        check: called between the steps; may raise to cancel.
        began: called with "2 of 4" and the like when a block begins, where there are several.

    Returns:
        The surface, open along the blocks' borders where there are several, and the strength of the plane that each
        of its faces lies on, 0 on none, float32 [F].

    Raises:
        Cancelled: the user asked to stop.
    """
    if options.blocks == 1:
        return cut_surface(views, evidence, options, check)
    found, grid = list[Cut](), make_grid(evidence.points, options.blocks)
    store = BlockStore("start", evidence.points, evidence.weight, *grid.cuts)
    for number, (low, high) in enumerate(grid.boxes(), 1):
        began(f"{number} of {len(grid)}")
        done = store.load(number)
        if done is None:
            part = thin_evidence(evidence, low, high, views.pixel, options)
            mesh, strength = clip_to_block(*cut_surface(views, part, options, check), low, high)
            store.save(number, vertices=mesh.vertices, faces=mesh.faces, strength=strength)
        else:
            mesh, strength = Mesh(done["vertices"], done["faces"], _black(done["vertices"])), done["strength"]
        found.append((mesh, strength))
    offset = np.cumsum([0, *(len(mesh.vertices) for mesh, _ in found[:-1])])
    faces = [mesh.faces + np.int32(first) for (mesh, _), first in zip(found, offset, strict=True)]
    vertices = np.concatenate([mesh.vertices for mesh, _ in found])
    return Mesh(vertices, np.concatenate(faces), _black(vertices)), np.concatenate([strength for _, strength in found])


def thin_evidence(evidence: Evidence, low: Array, high: Array, pixel: float, options: MinimumCutOptions) -> Evidence:
    """Merge the points that lie farther than the margin from a block in cubes of ``options.coarse``.

    Args:
        evidence: of the whole building.
        low: lowest corner of the block, [3].
        high: highest corner, [3].
        pixel: size of a pixel at the building.
        options: margin and size of the cubes.
    """
    margin = options.margin * pixel
    near = ((evidence.points > low - margin) & (evidence.points < high + margin)).all(1)
    if near.all():
        return evidence
    far = merge_points(evidence.select(np.flatnonzero(~near)), options.coarse * pixel)
    inside = evidence.select(np.flatnonzero(near))
    return Evidence(
        np.concatenate([inside.points, far.points]),
        [*inside.seen, *far.seen],
        np.concatenate([inside.weight, far.weight]),
        np.concatenate([inside.on_planes, far.on_planes]),
        evidence.strength,
    )


def clip_to_block(mesh: Mesh, strength: NDArray[np.float32], low: Array, high: Array) -> Cut:
    """Clip a mesh to a block; each face keeps its strength [F].

    Args:
        mesh: of the whole building.
        strength: of its faces, [F].
        low: lowest corner of the block, [3]; infinite where it has no end.
        high: highest corner, [3].
    """
    planes = [np.r_[side * unit, -side * at[axis]] for side, at in ((1, low), (-1, high))
              for axis, unit in enumerate(np.eye(3)) if np.isfinite(at[axis])]  # fmt: skip
    corners = mesh.vertices[mesh.faces].reshape(-1, 3)  # of each face apart: they carry its number
    face = np.repeat(np.arange(len(mesh.faces)), 3)
    apart = Mesh(corners, np.arange(len(corners), dtype=np.int32).reshape(-1, 3), _black(corners), {"face": face})
    cut = clip(apart, np.array(planes))
    kept, index = np.unique(cut.vertices, axis=0, return_inverse=True)
    faces = index.reshape(-1)[cut.faces].astype(np.int32)
    return Mesh(kept, faces, _black(kept)), strength[cut.values["face"][cut.faces[:, 0]]]


def _black(vertices: Array) -> NDArray[np.uint8]:
    return np.zeros((len(vertices), 3), np.uint8)
