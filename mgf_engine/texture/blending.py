# SPDX-License-Identifier: GPL-3.0-or-later
"""Blending at seams: beside a seam the photo of its other side is mixed in, half and half on the seam itself.

Levelled colours still differ along a seam, by noise, highlights and edges that are a pixel off. A ramp between both
photos (feathering: Szeliski, Image Alignment and Stitching, 2006, section 6.2) makes a step of them invisible.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.options.algorithms import parameter
from mgf_engine.texture.model import NO_VIEW, Layout
from mgf_engine.texture.painting import Painting
from mgf_engine.texture.seams import shared_edges

_SPACING = 0.7  # px between the points that a seam is drawn with: no pixel is left out


@dataclass(frozen=True)
class BlendOptions:
    """Options of blending at seams."""

    band: float = parameter(8.0, "Width of the band beside a seam where both photos are mixed; 0 mixes none", "px")


@dataclass(frozen=True)
class Bands:
    """Pixels of the picture that a second photo is mixed into.

    Attributes:
        pixel: int64 [N], y * width + x.
        view: int32 [N], position of the second photo among the views.
        share: float32 [N], of the second photo in the mixture, at most 0.5.
        correction: float32 [N, 3], of the second photo's colours, grey levels.
    """

    pixel: NDArray[np.int64]
    view: NDArray[np.int32]
    share: NDArray[np.float32]
    correction: NDArray[np.float32]


def find_bands(
    layout: Layout,
    painting: Painting,
    faces: NDArray[np.int32],
    drawn: NDArray[np.int32],
    options: BlendOptions = BlendOptions(),
) -> Bands:
    """Find the pixels beside seams whose face the photo on the other side shows as well.

    Args:
        layout: place of each face in the picture.
        painting: which photo paints which face, and which show it.
        faces: of the mesh, [F, 3].
        drawn: face at each pixel of the picture, -1 for none, [H, W].
        options: width of the band.
    """
    label = painting.label
    sides = painting.neighbours[(label[painting.neighbours] != NO_VIEW).all(1)]
    sides = sides[label[sides[:, 0]] != label[sides[:, 1]]]
    if not len(sides) or options.band <= 0:
        return Bands(
            np.zeros(0, np.int64), np.zeros(0, np.int32), np.zeros(0, np.float32), np.zeros((0, 3), np.float32)
        )
    ends = np.tile(shared_edges(faces, sides), (2, 1))
    own, other = np.concatenate([sides, sides[:, ::-1]]).T
    seams, nearest, distance = _draw_seams(layout, faces, own, ends)
    pixel = np.flatnonzero((drawn.ravel() >= 0) & (distance.ravel() < options.band))
    face, seam, distance = drawn.ravel()[pixel], seams[nearest.ravel()[pixel]], distance.ravel()[pixel]
    view = label[other[seam]]
    kept = (painting.patch[face] == painting.patch[own[seam]]) & painting.shows(face, view)
    pixel, seam, view = pixel[kept], seam[kept], view[kept]
    share = 0.5 * (1 - distance[kept] / options.band)
    at = (faces[other][:, None] == ends[:, :, None]).argmax(2)  # which corners of the other side the ends are
    values = painting.corrections.value[painting.corrections.of_corner[other[:, None], at]].mean(1)
    return Bands(pixel, view.astype(np.int32), share.astype(np.float32), values[seam])


def _draw_seams(
    layout: Layout, faces: NDArray[np.int32], own: NDArray[np.int64], ends: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.float32]]:
    """Draw seams in the picture.

    Args:
        layout: place of each face in the picture.
        faces: of the mesh, [F, 3].
        own: the face that a seam bounds, [S].
        ends: vertices at its ends, [S, 2].

    Returns:
        The seam of each point drawn, [P]; the nearest of these points to each pixel and its distance, [H, W].
    """
    first, last = (layout.at[own, (faces[own] == ends[:, [k]]).argmax(1)] for k in range(2))
    count = np.ceil(np.linalg.norm(last - first, axis=1) / _SPACING).astype(np.int64) + 1
    seam = np.repeat(np.arange(len(own)), count)
    rank = np.arange(len(seam)) - np.repeat(np.cumsum(count) - count, count)
    along = (rank / np.maximum(count[seam] - 1, 1))[:, None]
    column, row = (first[seam] * (1 - along) + last[seam] * along).astype(np.int64).T
    column, row = np.clip(column, 0, layout.width - 1), np.clip(row, 0, layout.height - 1)
    clear = np.ones((layout.height, layout.width), np.uint8)
    clear[row, column] = 0
    distance, nearest = cv2.distanceTransformWithLabels(clear, cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL)
    of_point = np.zeros(int(nearest.max()) + 1, np.int64)
    of_point[nearest[row, column]] = seam
    return of_point, np.asarray(nearest, np.int32), np.asarray(distance, np.float32)
