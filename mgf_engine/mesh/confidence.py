# SPDX-License-Identifier: GPL-3.0-or-later
"""Measure how far photos confirm a mesh, by area: vertices are many where the surface is rough."""

from __future__ import annotations

from dataclasses import dataclass

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


@dataclass(frozen=True)
class MeshConfidence:
    """How far photos confirm a mesh.

    Attributes:
        mean: mean confidence, 0..1.
        low: share of the area with low confidence, 0..1.
        shares: the whole area by its confidence.
    """

    mean: float
    low: float
    shares: ConfidenceShares


def measure_confidence(mesh: Mesh, low: float = _THREE_PHOTOS) -> MeshConfidence | None:
    """Measure ``confidence`` and ``views`` of a mesh; None without them, or without an area.

    Args:
        mesh: in any frame.
        low: confidence below which it is low.
    """
    areas = vertex_areas(mesh)
    total = areas.sum()
    if not {"confidence", "views"} <= set(mesh.values) or not total > 0:
        return None
    confidence, unseen = mesh.values["confidence"], mesh.values["views"] == 0
    agreed, three = ~unseen & (confidence >= _AGREED), ~unseen & (confidence >= _THREE_PHOTOS)

    def share(of: NDArray[np.bool_]) -> float:
        return float(areas[of].sum() / total)

    shares = ConfidenceShares(share(agreed), share(three & ~agreed), share(~unseen & ~three), share(unseen))
    return MeshConfidence(float(np.average(confidence, weights=areas)), share(confidence < low), shares)
