# SPDX-License-Identifier: GPL-3.0-or-later
"""How many pixels of all views see each face of a mesh: from which side, and what the masks say there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mgf_engine.masks.model import UNKNOWN
from mgf_engine.mesh.model import Mesh
from mgf_engine.mesh.view import corners, seen_faces
from mgf_engine.raster.library import call, side_by_side
from mgf_engine.scene.model import View

Counts = NDArray[np.int32]


@dataclass(frozen=True)
class PixelCounts:
    """Pixels that see each face, [F] each.

    Attributes:
        front, back: from outside (counter-clockwise corners), and from inside.
        inside: that the masks call building.
        known: about which the masks say anything.
    """

    front: Counts
    back: Counts
    inside: Counts
    known: Counts

    def select(self, keep: NDArray[np.bool_]) -> PixelCounts:
        """Those of the faces that are kept, bool [F]."""
        return PixelCounts(self.front[keep], self.back[keep], self.inside[keep], self.known[keep])


def count_pixels(mesh: Mesh, views: Sequence[View], labels: Sequence[NDArray[np.uint8]] | None = None) -> PixelCounts:
    """Draws the mesh into every view and counts.

    Args:
        views: normalised frame.
        labels: label map of each view, uint8 [H, W]; None: nothing is known.
    """
    counts = np.zeros((len(mesh.faces), 4), np.int32)
    faces = np.ascontiguousarray(mesh.faces, dtype=np.int32)

    def add(number: int) -> None:
        at = corners(mesh.vertices, views[number])
        face = seen_faces(mesh, views[number], at)
        label = None if labels is None else np.ascontiguousarray(labels[number])
        call("count_pixels", face.size, face, at, faces, label, UNKNOWN, counts)

    for _ in side_by_side(add, range(len(views))):
        pass
    return PixelCounts(*(np.ascontiguousarray(column) for column in counts.T))
