# SPDX-License-Identifier: GPL-3.0-or-later
"""Elevation of the rays of a photo's pixels over the horizon."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mgf_engine.model.scene import View


def over_horizon(view: View, up: NDArray[np.float64], degrees: float) -> NDArray[np.bool_]:
    """Return pixels whose rays rise by more than so much, [H, W]: no level ground is seen there."""
    rise, length = _rays(view, up)
    return np.asarray(rise > np.sin(np.radians(degrees)) * length, bool)


def elevation(view: View, up: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return degrees over the horizon of each pixel's ray, [H, W]."""
    rise, length = _rays(view, up)
    return np.asarray(np.degrees(np.arcsin(np.clip(rise / length, -1, 1))), np.float64)


def _rays(view: View, up: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Compute the rise of each pixel's ray at depth 1, and its length there, [H, W] each."""
    x, y = view.pixel_rays()
    normal = view.rotation @ up
    rise = normal[0] * x[None, :] + normal[1] * y[:, None] + normal[2]
    return rise, np.sqrt(1 + x[None, :] ** 2 + y[:, None] ** 2)
