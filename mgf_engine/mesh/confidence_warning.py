# SPDX-License-Identifier: GPL-3.0-or-later
"""Measure how far photos confirm a mesh, and warn where they hardly do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mgf_engine.geometry.clean import vertex_areas
from mgf_engine.model.mesh import Mesh
from mgf_engine.options.algorithms import parameter


@dataclass(frozen=True)
class ConfidenceWarningOptions:
    """Options of the warning of meshes with low confidence."""

    mean: float = parameter(0.5, "Mean confidence below which a mesh is warned of", high=1)
    low: float = parameter(
        0.55, "Confidence of a place that three photos show and whose patches hardly correlate", high=1
    )
    share: float = parameter(0.65, "Share of the area with less than that from which a mesh is warned of", high=1)


@dataclass(frozen=True)
class MeshConfidence:
    """How far photos confirm a mesh; by area, since vertices are many where the surface is rough.

    Attributes:
        mean: mean confidence, 0..1.
        low: share of the area with low confidence, 0..1.
        unseen: share of the area that no photo shows, 0..1.
    """

    mean: float
    low: float
    unseen: float


def mesh_confidence(mesh: Mesh, options: ConfidenceWarningOptions = ConfidenceWarningOptions()) -> MeshConfidence:
    """Summarise ``confidence`` and ``views`` of the vertices of a mesh, which must have both."""
    confidence, areas = mesh.values["confidence"], vertex_areas(mesh)

    def average(values: np.ndarray) -> float:
        return float(np.average(values, weights=areas))

    return MeshConfidence(
        average(confidence), average(confidence < options.low), average(mesh.values["views"] == 0)
    )  # fmt: skip


def low_confidence_warning(
    found: MeshConfidence, options: ConfidenceWarningOptions = ConfidenceWarningOptions()
) -> str | None:
    """Return what to say of a mesh that the photos hardly confirm; None of others."""
    if found.mean >= options.mean and found.low < options.share:
        return None
    return (
        f"The mesh has low confidence (mean {found.mean:.2f} of 1, {found.unseen:.0%} of it seen by no photo): do not "
        "measure on it. More, sharper and denser photos or better cameras would help."
    )
