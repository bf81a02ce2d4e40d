# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras side by side before the plane z = 0, for the tests of the matching kernels."""

from __future__ import annotations

import cv2
import numpy as np

from mgf_engine.model.scene import View


def view_beside(
    x: float, turn: float, size: tuple[int, int], focal: tuple[float, float], principal: tuple[float, float],
    distance: float,
) -> View:  # fmt: skip
    """A camera ``x`` to the side and ``distance`` before the plane, turned about the vertical by ``turn`` radians."""
    rotation = cv2.Rodrigues(np.array([0.0, turn, 0.02]))[0]
    centre = np.array([x, 0.1 * x, -distance])
    width, height = size
    return View(
        name=f"{x}", file="", original_width=width, original_height=height, width=width, height=height,
        fx=focal[0], fy=focal[1], cx=principal[0], cy=principal[1], rotation=rotation,
        translation=-rotation @ centre,
    )  # fmt: skip
