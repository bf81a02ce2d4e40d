# SPDX-License-Identifier: GPL-3.0-or-later
"""Warn of a mesh that photos hardly confirm."""

from __future__ import annotations

from dataclasses import dataclass

from mgf_engine.mesh.confidence import MeshConfidence
from mgf_engine.options.algorithms import parameter


@dataclass(frozen=True)
class ConfidenceWarningOptions:
    """Options of the warning of meshes with low confidence."""

    mean: float = parameter(0.5, "Mean confidence below which a mesh is warned of", high=1)
    low: float = parameter(
        0.55, "Confidence of a place that three photos show and whose patches hardly correlate", high=1
    )
    share: float = parameter(0.65, "Share of the area with less than that from which a mesh is warned of", high=1)


def low_confidence_warning(
    found: MeshConfidence, options: ConfidenceWarningOptions = ConfidenceWarningOptions()
) -> str | None:
    """Return what to say of a mesh by its confidence, whose ``low`` is below ``options.low``; None of good ones."""
    if found.mean >= options.mean and found.low < options.share:
        return None
    return (
        f"The mesh has low confidence (mean {found.mean:.2f} of 1, {found.shares.unseen:.0%} of it seen by no photo): "
        "do not measure on it. More, sharper and denser photos or better cameras would help."
    )
