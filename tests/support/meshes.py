# SPDX-License-Identifier: GPL-3.0-or-later
"""A mesh of nothing."""

from __future__ import annotations

import numpy as np

from mgf_engine.model.mesh import Mesh


def empty() -> Mesh:
    return Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32), np.zeros((0, 3), np.uint8))
