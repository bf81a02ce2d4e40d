# SPDX-License-Identifier: GPL-3.0-or-later
"""Match the elements of all photos (second level: windows, doors, ...) into parts of the scene, by sparse points."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mgf_engine.geometry.components import label_components
from mgf_engine.masks.part_options import PartOptions
from mgf_engine.model.masks import FIRST_ELEMENT, IGNORE
from mgf_engine.model.pixels import pixel_at
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


def match_elements(
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
    named = np.array([v * 256 + label for v, given in enumerate(names) for label in given], np.int64)
    elements = np.union1d(node[node >= 0], named)
    links = np.array([*_links(scene, node, options), *_same_name(names)], np.int64).reshape(-1, 2)
    group = label_components(len(elements), *np.searchsorted(elements, links).T)
    return _collect(scene, node, elements, group, names)


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


def _same_name(names: list[dict[int, str]]) -> list[tuple[int, int]]:
    """Return the pairs of elements that the user gave the same name: the first of a name with each other one."""
    first: dict[str, int] = {}
    named = [(view * 256 + label, name) for view, given in enumerate(names) for label, name in given.items()]
    return [(first.setdefault(name, element), element) for element, name in named]


def _collect(
    scene: Scene,
    node: NDArray[np.int64],
    elements: NDArray[np.int64],
    group: NDArray[np.int32],
    names: list[dict[int, str]],
) -> list[Part]:
    """Make the parts, with the points that most of their observations lie on.

    Args:
        scene: with its tracks.
        node: element under each observation, view * 256 + label; -1 for none.
        elements: all elements, sorted, [N].
        group: number of each element's part, [N].
        names: per view, label -> the user's name.
    """
    known = np.flatnonzero(node >= 0)
    votes: dict[int, Counter[int]] = {}
    for point, voted in zip(scene.track_point[known], group[np.searchsorted(elements, node[known])], strict=True):
        votes.setdefault(int(point), Counter())[int(voted)] += 1
    points: dict[int, list[int]] = {}
    for point, counter in sorted(votes.items()):
        points.setdefault(counter.most_common(1)[0][0], []).append(point)
    parts: list[Part] = []
    for number in range(int(group.max(initial=-1)) + 1):
        members = elements[group == number].tolist()
        given = [names[m // 256][m % 256] for m in members if m % 256 in names[m // 256]]
        if len(members) == 1 and not given:
            continue  # seen in one photo only: an element, not a part
        name = given[0] if given else f"element-{len(parts) + 1}"
        parts.append(Part(name, [(m // 256, m % 256) for m in members], points.get(number, [])))
    return parts
