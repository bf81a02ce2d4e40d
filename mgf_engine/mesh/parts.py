# SPDX-License-Identifier: GPL-3.0-or-later
"""Assign each face of the mesh to a part that the user named (window, door, roof, ...), by the elements of the masks.

Only parts that the user named count; what was found automatically has no name worth a material. Photos that show a
named part vote on the vertices they see; a vertex is what more than half of them say, a face what most of its corners
are. ``mesh_parts.npz`` holds ``names`` (the first is "building": everything else) and ``face`` (uint8 [F], an index
into the names).
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mgf_engine.files.atomic import atomic_path
from mgf_engine.geometry.rasterize import corners, render_mesh
from mgf_engine.model.masks import MaskSet, building
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.scene import Scene
from mgf_engine.options.algorithms import parameter

REST = "building"
FILE = "mesh_parts.npz"
MAX_PARTS = 254  # that fit into a byte beside the rest

#: View index -> its labels that are the part.
Elements = dict[int, list[int]]


@dataclass(frozen=True)
class FacePartOptions:
    """Options of the vote of the photos on the parts of faces."""

    hidden: float = parameter(
        0.01, "Distance behind the visible surface from which a vertex is hidden, as a share of its depth"
    )


def named_parts(masks_folder: Path, scene: Scene) -> dict[str, Elements]:
    """Read the parts in ``parts.json`` that the user named; empty where there are none or the file is gone."""
    try:
        listed = json.loads((masks_folder / "parts.json").read_text(encoding="utf-8"))["parts"]
        entries = [(str(p["name"]), [(str(n), int(label)) for n, label in p["elements"]]) for p in listed]
    except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError):
        return {}
    index = {view.name: i for i, view in enumerate(scene.views)}
    result: dict[str, Elements] = {}
    for name, elements in entries:
        if name.startswith("element-") or name == REST or (name not in result and len(result) == MAX_PARTS):
            continue
        for view, label in elements:
            if view in index:
                result.setdefault(name, {}).setdefault(index[view], []).append(label)
    return result


def face_parts(
    mesh: Mesh,
    scene: Scene,
    masks: MaskSet,
    parts: Sequence[Elements],
    options: FacePartOptions = FacePartOptions(),
) -> NDArray[np.uint8]:
    """Find the part of each face by the photos' labels, uint8 [F]: 0 for none, k + 1 for ``parts[k]``.

    Args:
        mesh: normalised frame.
        scene: cameras of the photos.
        masks: their label maps.
        parts: of each part, its element in each photo.
        options: which vertices a photo shows.
    """
    votes = np.zeros((len(mesh.vertices), len(parts) + 1), np.uint16)
    for index in sorted({view for elements in parts for view in elements}):
        if not masks.used[index]:
            continue
        seen, row, column = _seen(mesh, scene, index, options)
        labels = masks.labels[index]
        table = np.zeros(256, np.int64)
        for k, elements in enumerate(parts):
            table[elements.get(index, [])] = k + 1
        on = building(labels)[row, column]
        votes[seen[on], table[labels[row[on], column[on]]]] += 1
    total = votes.sum(1)
    best = votes[:, 1:].argmax(1) + 1 if len(parts) else np.zeros(len(votes), np.int64)
    vertex = np.where(2 * votes[np.arange(len(votes)), best] > total, best, 0)
    a, b, c = vertex[mesh.faces].T
    return np.where((a == b) | (a == c), a, np.where(b == c, b, 0)).astype(np.uint8)


def write_parts(names: Sequence[str], face: NDArray[np.uint8], path: Path) -> None:
    """Write ``mesh_parts.npz``; ``names`` are those of the parts, without the rest."""
    with atomic_path(path) as temporary, open(temporary, "wb") as file:
        np.savez_compressed(file, names=np.array([REST, *names]), face=face)


def _seen(
    mesh: Mesh, scene: Scene, index: int, options: FacePartOptions
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return vertices that a view shows, and the pixel (row, column) of each."""
    view = scene.views[index]
    at = corners(mesh.vertices, view)
    surface = render_mesh(mesh, view, at).depth
    column, row = np.floor(np.clip(at[:, :2], -1, 1 << 20)).astype(np.int64).T
    inside = (at[:, 2] > 0) & (row >= 0) & (row < view.height) & (column >= 0) & (column < view.width)
    seen = np.flatnonzero(inside)
    shown = surface[row[seen], column[seen]]
    seen = seen[(shown > 0) & (shown * (1 + options.hidden) * at[seen, 2] >= 1)]
    return seen, row[seen], column[seen]
