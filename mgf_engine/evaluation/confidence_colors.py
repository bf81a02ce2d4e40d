# SPDX-License-Identifier: GPL-3.0-or-later
"""Colours that show where the confidence of a mesh is how high."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from mgf_engine.model.mesh import Mesh


def colored_by_confidence(mesh: Mesh) -> Mesh:
    """Return the mesh coloured from violet (confidence 0) to yellow (1), as the add-on shows it."""
    grey = (255 * np.clip(mesh.values["confidence"], 0, 1)).round().astype(np.uint8)
    colors = cv2.applyColorMap(grey[:, None], cv2.COLORMAP_VIRIDIS)[:, 0, ::-1]
    return replace(mesh, colors=np.ascontiguousarray(colors))
