# SPDX-License-Identifier: GPL-3.0-or-later
"""Data classes that the steps of the texture exchange."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

#: In place of a view: no photo shows the face, and it is painted with the colours of its vertices.
NO_VIEW = -1


def painting_views(label: NDArray[np.int32]) -> list[int]:
    """Return the views among the labels of faces, ascending, :data:`NO_VIEW` left out."""
    return [int(view) for view in np.unique(label) if view != NO_VIEW]


@dataclass(frozen=True)
class Source:
    """A photo to paint with.

    Attributes:
        image: RGB uint8 [h, w, 3].
        original: the user's photo as its camera saw it; otherwise the working photo.
    """

    image: NDArray[np.uint8]
    original: bool


@dataclass(frozen=True)
class Layout:
    """Where each corner of each face lies in the picture.

    Attributes:
        width, height: of the picture, pixels.
        at: float64 [F, 3, 2], pixels from the top-left corner, x to the right, y down.
        scale: pixels of the picture per pixel of a working photo.
    """

    width: int
    height: int
    at: NDArray[np.float64]
    scale: float
