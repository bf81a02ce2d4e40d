# SPDX-License-Identifier: GPL-3.0-or-later
"""Colours of a mesh by its confidence."""

from __future__ import annotations

import numpy as np

from mgf_engine.evaluation.confidence_colors import colored_by_confidence
from mgf_engine.model.mesh import Mesh


def test_what_is_confirmed_is_yellow_and_what_is_not_violet() -> None:
    confidence = np.array([1, 0.5, 0], np.float32)
    mesh = Mesh(np.eye(3), np.array([[0, 1, 2]], np.int32), np.zeros((3, 3), np.uint8), {"confidence": confidence})
    (red, green, blue), _, (dark_red, dark_green, dark_blue) = colored_by_confidence(mesh).colors.astype(int)
    assert red > 200 and green > 200 and blue < 100
    assert dark_blue > dark_green and dark_red > dark_green
