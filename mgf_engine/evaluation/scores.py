# SPDX-License-Identifier: GPL-3.0-or-later
"""Scores of a mesh against a true mesh (eq. 30-32)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from mgf_engine.errors import BadInput
from mgf_engine.evaluation.surfaces import Hygiene


def check_thresholds(thresholds: Sequence[float]) -> None:
    """Refuse thresholds of which one is no finite distance above 0, and none at all.

    Raises:
        BadInput: so it is.
    """
    if not thresholds:
        raise BadInput("There is no threshold to score by; give at least one distance.")
    for threshold in thresholds:
        if not 0 < threshold < math.inf:
            raise BadInput(f"A threshold must be a finite distance above 0, not {threshold:g}.")


@dataclass(frozen=True)
class MaterialScores:
    """Scores of the parts of one material: as in :class:`GeometryScores`.

    Attributes:
        share: percentage of the seen true points that are of this material.
    """

    share: float
    accuracy: tuple[float, ...]
    completeness: tuple[float, ...]
    f1: tuple[float, ...]
    normal_median: float | None
    normal_90: float | None


@dataclass(frozen=True)
class GeometryScores:
    """Scores of one mesh; percentages per threshold, distances in the units of the meshes.

    Attributes:
        accuracy: share of the mesh's points within the threshold of the truth, eq. 30.
        completeness: share of the seen true points within the threshold of the mesh, eq. 31.
        f1: harmonic mean of both, eq. 32.
        mean_error, median_error: mesh to truth; mean_gap, median_gap: seen truth to mesh.
        truth_seen: percentage of the truth that at least one camera saw.
        outside_crop: percentage of the mesh's points left out because they lie outside the crop box.
        alignment: 4x4 matrix that moved the mesh onto the truth before scoring.
        normal_median, normal_90: angle between the mesh's faces and the true ones nearest to them, degrees, the median
            and what 90 % stay below, over the mesh's points within the largest threshold of the truth; None without
            such points. Which side is out does not matter.
        materials: the same by material, where the truth has materials.
    """

    thresholds: tuple[float, ...]
    accuracy: tuple[float, ...]
    completeness: tuple[float, ...]
    f1: tuple[float, ...]
    mean_error: float
    median_error: float
    mean_gap: float
    median_gap: float
    samples: int
    truth_seen: float
    outside_crop: float
    hygiene: Hygiene
    alignment: tuple[tuple[float, ...], ...]
    normal_median: float | None = None
    normal_90: float | None = None
    materials: dict[str, MaterialScores] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        return asdict(self)
