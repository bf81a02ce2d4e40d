# SPDX-License-Identifier: GPL-3.0-or-later
"""A level camera for the geometry of masks."""

from __future__ import annotations

import numpy as np

from mgf_engine.model.scene import View


def camera(x: float) -> View:
    """At (x, -6, 1.5), looking along +y, z up."""
    rotation = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    return View(f"{x}", "", 300, 200, 250.0, 250.0, 150.0, 100.0, rotation, -rotation @ [x, -6, 1.5], 300, 200)
