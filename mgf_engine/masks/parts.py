# SPDX-License-Identifier: GPL-3.0-or-later
"""Match the elements of all photos (second level: windows, doors, ...) into parts of the scene, by sparse points."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mgf_engine.masks.part_options import PartOptions
from mgf_engine.masks.points import pixel_at
from mgf_engine.model.masks import FIRST_ELEMENT, IGNORE
from mgf_engine.model.scene import Scene


@dataclass
class Part:
    """A part of the building, as seen in several photos.

    Attributes:
        name: given by the user, or ``element-N``.
        elements: (view, label) of each of its elements.
        points: rows of the scene's sparse points on it.
    """

    name: str
    elements: list[tuple[int, int]]
    points: list[int] = field(default_factory=list)


def tie_parts(
    scene: Scene, labels: list[NDArray[np.uint8]], names: list[dict[int, str]], options: PartOptions = PartOptions()
) -> list[Part]:
    """Join elements of different photos that contain the same sparse points, or have the same name, into parts.

    Args:
        scene: its points, and the views that observed each.
        labels: label maps of all views.
        names: per view, label -> the user's name.
        options: how many points two elements must share.
    """
    element = np.zeros(len(scene.track_view), np.int64)  # label under each observation
    for index, labels_here in enumerate(labels):
        here = scene.observations(index)
        y, x = pixel_at(labels_here.shape, scene.track_uv[here])
        element[here] = labels_here[y, x]
    element[(element < FIRST_ELEMENT) | (element == IGNORE)] = 0
    node = np.where(element > 0, scene.track_view.astype(np.int64) * 256 + element, -1)
    parent = {int(n): int(n) for n in np.unique(node[node >= 0])}
    parent |= {v * 256 + label: v * 256 + label for v, named in enumerate(names) for label in named}
    for first, second in _links(scene, node, options):
        parent[_root(parent, first)] = _root(parent, second)
    for members in _same_name(names):
        for other in members[1:]:
            parent[_root(parent, other)] = _root(parent, members[0])
    return _collect(scene, node, parent, names)


def _links(scene: Scene, node: NDArray[np.int64], options: PartOptions) -> list[tuple[int, int]]:
    """Return the pairs of elements of two photos that share enough points.

    ``shared`` counts the points two elements both hold, ``seen`` those of an element that another photo sees at all.
    """
    known = np.flatnonzero(node >= 0)
    ids, column = np.unique(node[known], return_inverse=True)
    point, view = scene.track_point, scene.track_view
    ones = np.ones(len(node), np.int64)
    holds = sparse.csr_matrix((ones[known], (point[known], column)), (len(scene.points), len(ids)))
    sees = sparse.csr_matrix((ones, (point, view)), (len(scene.points), len(scene.views)))
    shared, seen = (holds.T @ holds).tocoo(), (holds.T @ sees).tocsr()
    enough = (ids[shared.row] // 256 < ids[shared.col] // 256) & (shared.data >= options.shared)
    if not enough.any():
        return []
    a, b, count = shared.row[enough], shared.col[enough], shared.data[enough]
    common = np.maximum(np.asarray(seen[a, ids[b] // 256]), np.asarray(seen[b, ids[a] // 256]))
    good = count >= options.common * common.ravel()
    return list(zip(ids[a[good]].tolist(), ids[b[good]].tolist(), strict=True))


def _same_name(names: list[dict[int, str]]) -> list[list[int]]:
    """Return elements the user gave the same name, which are one part."""
    groups: dict[str, list[int]] = {}
    for view, named in enumerate(names):
        for label, name in named.items():
            groups.setdefault(name, []).append(view * 256 + label)
    return list(groups.values())


def _collect(scene: Scene, node: NDArray[np.int64], parent: dict[int, int], names: list[dict[int, str]]) -> list[Part]:
    owner = scene.track_point
    groups: dict[int, list[int]] = {}
    for member in sorted(parent):
        groups.setdefault(_root(parent, member), []).append(member)
    votes: dict[int, Counter[int]] = {}
    for point, member in zip(owner[node >= 0], node[node >= 0], strict=True):
        votes.setdefault(int(point), Counter())[_root(parent, int(member))] += 1
    points: dict[int, list[int]] = {}
    for point, counter in sorted(votes.items()):
        points.setdefault(counter.most_common(1)[0][0], []).append(point)
    parts: list[Part] = []
    for root, members in groups.items():
        given = [names[m // 256][m % 256] for m in members if m % 256 in names[m // 256]]
        if len(members) == 1 and not given:
            continue  # seen in one photo only: an element, not a part
        name = given[0] if given else f"element-{len(parts) + 1}"
        parts.append(Part(name, [(m // 256, m % 256) for m in members], points.get(root, [])))
    return parts


def _root(parent: dict[int, int], node: int) -> int:
    while parent[node] != node:
        parent[node] = parent[parent[node]]
        node = parent[node]
    return node
