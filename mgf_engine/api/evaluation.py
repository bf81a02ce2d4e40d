# SPDX-License-Identifier: GPL-3.0-or-later
"""Comparison of a mesh with the true one: ``mgf.evaluate``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mgf_engine.api.arguments import PathLike
from mgf_engine.evaluation.geometry import ComparisonOptions, score_surface
from mgf_engine.evaluation.model_cameras import colmap_cameras
from mgf_engine.evaluation.scores import GeometryScores
from mgf_engine.evaluation.surfaces import Surface, read_surface
from mgf_engine.model.mesh import Mesh


def evaluate(
    mesh: Mesh | PathLike,
    truth: Mesh | PathLike,
    *,
    thresholds: Sequence[float] = (0.05,),
    samples: int = 1_000_000,
    scene: PathLike | None = None,
    align: str = "none",
) -> GeometryScores:
    """Compare a mesh with the true one: accuracy, completeness, F1, angles of normals.

    >>> import mgf_engine as mgf
    >>> scores = mgf.evaluate("truth.ply", "truth.ply", thresholds=[0.01, 0.1], samples=1000)
    >>> scores.f1
    (100.0, 100.0)

    Args:
        mesh: the mesh, or its file (PLY, OBJ, GLB).
        truth: the true mesh in the same coordinates, or its file.
        thresholds: distances within which a point counts as right, in the units of the meshes.
        samples: points sampled on each mesh.
        scene: COLMAP project; true points that none of its cameras sees do not count.
        align: move the mesh onto the truth first: ``none``, ``rigid`` or ``similarity``.

    Returns:
        Percentages per threshold, distances in the units of the meshes.

    Raises:
        BadInput: a mesh or the scene cannot be read, or impossible numbers.
    """
    cameras = None if scene is None else colmap_cameras(Path(scene))
    options = ComparisonOptions(samples, cameras, align=align)
    return score_surface(_surface(mesh), _surface(truth), tuple(thresholds), options)


def _surface(mesh: Mesh | PathLike) -> Surface:
    return Surface(mesh.vertices, mesh.faces.astype(np.int64)) if isinstance(mesh, Mesh) else read_surface(Path(mesh))
