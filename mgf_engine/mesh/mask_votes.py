# SPDX-License-Identifier: GPL-3.0-or-later
"""Remove the faces that most masks show as background, pixel by pixel.

Gaussians are screened with dilated masks (eq. 21-22), so that a mask that is a few pixels too tight does not remove a
chimney. This leaves a rim of the surroundings around the building, most visibly a skirt of ground at its foot. On the
extracted surface visibility is known, so the vote is exact to a pixel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mgf_engine.geometry.clean import with_faces
from mgf_engine.mesh.face_visibility import PixelCounts, count_pixels, count_uncovered
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.scene import View
from mgf_engine.options.algorithms import parameter


@dataclass(frozen=True)
class MaskVoteOptions:
    """Options of the vote of the masks on faces."""

    rounds: int = parameter(3, "Number of rounds; a later round tests faces that were hidden by removed ones", low=1)
    majority: float = parameter(0.5, "Minimum share of a face's pixels that masks show as building", high=1)
    spread: int = parameter(2, "Number of times that the vote of a face is averaged with those of its neighbours")


def cut_background(
    mesh: Mesh,
    views: Sequence[View],
    labels: Sequence[NDArray[np.uint8]],
    counts: PixelCounts | None = None,
    left: NDArray[np.bool_] | None = None,
    options: MaskVoteOptions = MaskVoteOptions(),
) -> Mesh:
    """Remove the faces for which most of the pixels that show them are background.

    Args:
        mesh: normalised frame.
        views: photos that vote, normalised frame.
        labels: label map of each view, uint8 [H, W]; ignored pixels do not vote. Faces that no view sees stay.
        counts: those of the mesh, where they are known already.
        left: faces of whole parts that are left from the beginning, bool [F]; None for all.
        options: which share of background removes a face, and how far votes are averaged.
    """
    counts = counts or count_pixels(mesh, views, labels)
    left = np.ones(len(mesh.faces), bool) if left is None else left.copy()
    for number in range(options.rounds):
        if number > 0:
            counts = count_uncovered(mesh, left, counts, views, labels)
        part = replace(mesh, faces=mesh.faces[left])
        keep = _average_votes(part, counts.inside[left], options) >= options.majority * _average_votes(
            part, counts.known[left], options
        )
        left[left] = keep
        if keep.all() or not keep.any():
            break
    return with_faces(mesh, mesh.faces[left])


def _average_votes(mesh: Mesh, count: NDArray[np.int32], options: MaskVoteOptions) -> NDArray[np.float64]:
    """Average votes [F] over neighbouring faces."""
    around = np.maximum(np.bincount(mesh.faces.ravel(), minlength=len(mesh.vertices)), 1)
    votes = count.astype(np.float64)
    for _ in range(options.spread):
        of_vertex = np.bincount(mesh.faces.ravel(), np.repeat(votes, 3), len(mesh.vertices)) / around
        votes = of_vertex[mesh.faces].mean(1)
    return votes
