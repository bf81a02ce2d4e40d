# SPDX-License-Identifier: GPL-3.0-or-later
"""Shares of the area of a mesh by its confidence, and colours that show where it is how high."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.geometry.clean import vertex_areas
from mgf_engine.model.mesh import Mesh

#: Confidence of a place that three photos show and whose patches hardly correlate (see ``TsdfField.observations``).
_THREE_PHOTOS = 0.5
#: Confidence from which their patches correlate well enough to measure on the place.
_AGREED = 0.75


@dataclass(frozen=True)
class ConfidenceShares:
    """Shares of the area of a mesh (0..1, together 1) by how well photos confirm them.

    Attributes:
        agreed: three photos or more show it, and they agree.
        plain: three photos or more show it and hardly correlate: plain, mirroring, blurred or dark.
        few: fewer than three photos show it.
        unseen: no photo shows it.
    """

    agreed: float
    plain: float
    few: float
    unseen: float


def measure_confidence(mesh: Mesh) -> ConfidenceShares | None:
    """Measure the shares; None for a mesh without ``confidence`` and ``views``, or without an area."""
    areas = vertex_areas(mesh)
    if not {"confidence", "views"} <= set(mesh.values) or not areas.sum() > 0:
        return None
    confidence, unseen = mesh.values["confidence"], mesh.values["views"] == 0
    agreed, three = ~unseen & (confidence >= _AGREED), ~unseen & (confidence >= _THREE_PHOTOS)

    def share(of: NDArray[np.bool_]) -> float:
        return float(areas[of].sum() / areas.sum())

    return ConfidenceShares(share(agreed), share(three & ~agreed), share(~unseen & ~three), share(unseen))


def colored_by_confidence(mesh: Mesh) -> Mesh:
    """Return the mesh coloured from violet (confidence 0) to yellow (1), as the add-on shows it."""
    grey = (255 * np.clip(mesh.values["confidence"], 0, 1)).round().astype(np.uint8)
    colors = cv2.applyColorMap(grey[:, None], cv2.COLORMAP_VIRIDIS)[:, 0, ::-1]
    return replace(mesh, colors=np.ascontiguousarray(colors))
