# SPDX-License-Identifier: GPL-3.0-or-later
"""Result of the masks stage: a label map and a score for each photo, and the masked points P'."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mgf_engine.model.up_direction import UpDirection

BACKGROUND = 0
BUILDING = 1
FIRST_ELEMENT = 2  # 2..254: second-level elements, ids local to the image
IGNORE = 255  # an occluder in front of the building, or uncertain: neither building nor empty space; no loss, no vote


@dataclass(frozen=True)
class MaskSet:
    """Masks of all views of a scene.

    Attributes:
        labels: per view uint8 [height, width] at working resolution: ``M_ms`` of the paper, with IGNORE.
        used: bool [V]; false for masks too weak to train on.
        scores: float32 [V]; agreement with the sparse points, 0..1.
        point_mask: bool [P]; true for the masked points P' (eq. 3).
        clicks: per view float32 [K, 2], working pixels where the building was clicked; () for masks of another origin.
        up: direction up by which clicks became masks; None for masks of another origin.
    """

    labels: tuple[NDArray[np.uint8], ...]
    used: NDArray[np.bool_]
    scores: NDArray[np.float32]
    point_mask: NDArray[np.bool_]
    clicks: tuple[NDArray[np.float32], ...] = ()
    up: UpDirection | None = None

    @property
    def clicked(self) -> list[int]:
        """The photos on which the building was clicked: the root images of the paper; none for other masks."""
        return [view for view, clicks in enumerate(self.clicks) if len(clicks)]


def building(labels: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Return pixels of the building at level one, whatever element they belong to."""
    return (labels != BACKGROUND) & (labels != IGNORE)
