# SPDX-License-Identifier: GPL-3.0-or-later
"""Rays through the pixels of a view, for tests that look at what the engine draws."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mgf_engine.model.scene import View


def pixel_rays(view: View, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> NDArray[np.float64]:
    """Unit directions [N, 3] in the normalised frame of the rays through the centres of pixels."""
    u, v = columns + 0.5, rows + 0.5
    local = np.column_stack([(u - view.cx) / view.fx, (v - view.cy) / view.fy, np.ones(len(u))])
    local /= np.linalg.norm(local, axis=1, keepdims=True)
    rays: NDArray[np.float64] = local @ view.rotation
    return rays
