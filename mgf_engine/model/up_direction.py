# SPDX-License-Identifier: GPL-3.0-or-later
"""The direction up (against gravity) in a scene, and how well it is known; :mod:`mgf_engine.scene.gravity` finds it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

#: By vertical edges of walls, by gravity tags of the photos, or by the way cameras are held.
UP_METHODS = ("walls", "tags", "cameras")


@dataclass(frozen=True)
class UpDirection:
    """The direction up.

    Attributes:
        vector: unit [3], normalised frame.
        sd: standard deviation, radians.
        method: that found it, one of :data:`UP_METHODS`.
        edges: number of edges that show it.
    """

    vector: NDArray[np.float64]
    sd: float
    method: str
    edges: int = 0

    @property
    def degrees(self) -> float:
        """Standard deviation in degrees."""
        return float(np.degrees(self.sd))
