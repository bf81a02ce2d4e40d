# SPDX-License-Identifier: GPL-3.0-or-later
"""Square cells of the ground plan: what is seen of a building from straight above."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_FAR = 1 << 40  # cells: farther points are that far, instead of overflowing


@dataclass(frozen=True)
class PlanGrid:
    """A grid over the ground plan.

    Attributes:
        axes: horizontal unit vectors, [2, 3].
        low: corner of the first cell along them, [2].
        cell: side of a cell.
    """

    axes: NDArray[np.float64]
    low: NDArray[np.float64]
    cell: float

    def cells(self, points: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return the cell of each point [N, 3], whatever its height; [N, 2], negative before the first cell."""
        cells = np.floor((points @ self.axes.T - self.low) / self.cell)
        return np.clip(cells, -_FAR, _FAR).astype(np.int64)


def cells_inside(cells: NDArray[np.int64], shape: tuple[int, ...] | NDArray[np.int64]) -> NDArray[np.bool_]:
    """Tell which cells [N, 2] are of a map of a shape, bool [N]."""
    return np.asarray(((cells >= 0) & (cells < shape)).all(1))
