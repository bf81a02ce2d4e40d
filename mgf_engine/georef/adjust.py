# SPDX-License-Identifier: GPL-3.0-or-later
"""Lets control points shape the scene while it is made, before any photo is undistorted."""

from __future__ import annotations

import logging
from pathlib import Path

from mgf_engine.config import Config
from mgf_engine.georef.bundle import adjusted_to_control
from mgf_engine.georef.control import read_control
from mgf_engine.georef.doubts import check_points
from mgf_engine.georef.fit_control import fit_control
from mgf_engine.georef.triangulate import place_points
from mgf_engine.masks.geometry.point_features import up_direction
from mgf_engine.model.scene import Scene
from mgf_engine.scene.sparse import SparseModel

log = logging.getLogger("mgf")


def fit_to_control(model: SparseModel, scene: Scene, config: Config) -> SparseModel:
    """The model adjusted to the user's control points, in its own frame.

    What is wrong with points and marks is said where the georeference is found, from the scene that this leads to.

    Args:
        scene: made of the model, with all its images as views.

    Raises:
        BadInput: the points cannot be used, or do not fit at all.
    """
    marks = Path(config.marks) if config.marks else None
    control = read_control(Path(config.control), marks, [view.name for view in scene.views])
    check_points(control.points, None, None)
    placed, failed = place_points(scene, control.marks)
    fit = fit_control(scene, control.points, placed, failed, up_direction(scene))
    return adjusted_to_control(model, scene, control, placed, fit, config.resolution)
