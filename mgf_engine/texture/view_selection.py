# SPDX-License-Identifier: GPL-3.0-or-later
"""View selection: choose a photo for each face, few photos with few seams, each at nearly its best resolution."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mgf_engine.geometry.components import label_components
from mgf_engine.options.algorithms import parameter
from mgf_engine.texture.model import NO_VIEW
from mgf_engine.texture.visibility import FaceViews, ShownFaces, VisibilityOptions


@dataclass(frozen=True)
class ViewSelectionOptions:
    """Options of which photo paints which face."""

    nearly_best: float = parameter(
        0.5, "Size of a face in a photo, as a share of the largest, from which the photo may be chosen first", high=1
    )
    rounds: int = parameter(12, "Number of rounds that smooth the borders between photos")
    small: float = parameter(40.0, "Area below which a patch is given to its neighbours", "px²")


def choose_views(
    face_views: FaceViews,
    neighbours: NDArray[np.int64],
    area: NDArray[np.float64],
    options: ViewSelectionOptions = ViewSelectionOptions(),
    least_size: float = VisibilityOptions.least_size,
) -> NDArray[np.int32]:
    """Choose the view that paints each face, :data:`NO_VIEW` where none shows it, int32 [F].

    Args:
        face_views: which views show each face, and how large.
        neighbours: pairs of faces that share an edge, [E, 2].
        area: of each face, [F].
        options: of the cover and the smoothing.
        least_size: share of the largest size of a face from which a photo may take it over from its neighbours.
    """
    best = np.zeros(face_views.faces, np.float32)
    np.maximum.at(best, face_views.face, face_views.size)
    share = face_views.size / best[face_views.face]
    label = _cover(face_views, share >= options.nearly_best, area)
    fair = share >= least_size
    shows = ShownFaces(face_views.face[fair], face_views.view[fair])
    for step in range(options.rounds):
        label = _smooth_labels(label, neighbours, shows, step % 2)
    return _without_small(label, neighbours, shows, best, options)


def _cover(face_views: FaceViews, good: NDArray[np.bool_], area: NDArray[np.float64]) -> NDArray[np.int32]:
    """Cover the faces greedily: repeatedly take the view that shows the largest area not covered yet, int32 [F]."""
    label = np.full(face_views.faces, NO_VIEW, np.int32)
    face, view = face_views.face[good], face_views.view[good]
    while len(face):
        chosen = int(np.bincount(view, area[face] + 1e-30).argmax())
        label[face[view == chosen]] = chosen
        left = label[face] == NO_VIEW
        face, view = face[left], view[left]
    return label


def _smooth_labels(
    label: NDArray[np.int32], neighbours: NDArray[np.int64], shows: ShownFaces, parity: int
) -> NDArray[np.int32]:
    """Give the faces of one parity the view that two of their neighbours have, where it shows them, int32 [F]."""
    first, second = np.concatenate([neighbours, neighbours[:, ::-1]]).T
    asked = (first % 2 == parity) & (label[second] != label[first]) & (label[second] >= 0)
    first, wanted = first[asked], label[second[asked]]
    key = first * (int(label.max(initial=0)) + 1) + wanted
    twice, count = np.unique(key, return_counts=True)
    twice = twice[count >= 2]
    face, view = np.divmod(twice, int(label.max(initial=0)) + 1)
    fits = shows(face, view)
    result = label.copy()
    result[face[fits]] = view[fits]
    return result


def patches(label: NDArray[np.int32], neighbours: NDArray[np.int64]) -> NDArray[np.int32]:
    """Label the patches: faces of one view that are connected by edges, int32 [F]."""
    same = neighbours[label[neighbours[:, 0]] == label[neighbours[:, 1]]]
    return label_components(len(label), *same.T)


def _without_small(
    label: NDArray[np.int32],
    neighbours: NDArray[np.int64],
    shows: ShownFaces,
    size: NDArray[np.float32],
    options: ViewSelectionOptions,
) -> NDArray[np.int32]:
    """Give faces of small patches to a neighbouring view that shows them, from the rim inwards."""
    both = np.concatenate([neighbours, neighbours[:, ::-1]])
    for _ in range(options.rounds):
        patch = patches(label, neighbours)
        small = np.bincount(patch, size)[patch] < options.small
        first, second = both[small[both[:, 0]] & ~small[both[:, 1]]].T
        fits = shows(first, label[second])
        if not fits.any():
            break
        label = label.copy()
        label[first[fits]] = label[second[fits]]
    return label
