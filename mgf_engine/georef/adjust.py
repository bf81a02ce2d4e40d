# SPDX-License-Identifier: GPL-3.0-or-later
"""Adjust the scene to control points while it is made, before the photos are undistorted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from mgf_engine.georef.bundle import PlacedControl, adjust_to_control
from mgf_engine.georef.control_points import read_control
from mgf_engine.georef.fit_control import fit_control
from mgf_engine.georef.options import GeoreferenceOptions
from mgf_engine.georef.triangulate import place_points
from mgf_engine.georef.validation import check_marks, check_points
from mgf_engine.messages import Reporter
from mgf_engine.model.scene import Scene
from mgf_engine.options.config import Config
from mgf_engine.scene.gravity import up_from_cameras
from mgf_engine.scene.sparse import SparseModel


def fit_to_control(
    model: SparseModel, scene: Scene, rebuilt: Callable[[SparseModel], Scene], config: Config, reporter: Reporter
) -> SparseModel:
    """Adjust a model to the user's control points; it stays in its own frame.

    A bent scene fits even points that are right badly, so all that are not far off take part at first, and points that
    are wrong count less; those that do not fit the straightened scene are left out the second time. What is wrong with
    points and marks is said where the georeference is found, from the scene that this leads to.

    Args:
        model: cameras, poses, points and tracks.
        scene: made of the model, with all its images as views.
        rebuilt: makes such a scene of a model.
        config: files of the points, and options.
        reporter: for a warning where the adjustment fails, and the request to cancel.

    Raises:
        BadInput: the points cannot be used, or do not fit at all.
    """
    options = config.algorithm(GeoreferenceOptions)
    marks = Path(options.marks) if options.marks else None
    names = [view.name for view in scene.views]
    control = read_control(Path(options.control), marks, names, options.point.accuracy)
    check_points(control.points, None, None)
    check_marks(scene, control)
    bent = replace(options.point, tolerated=options.point.tolerated_bent)
    for limits, robust in ((bent, True), (options.point, False)):
        placed, failed = place_points(scene, control.marks, options.mark)
        fit = fit_control(scene, control.points, placed, failed, up_from_cameras(scene.views), limits)
        points = PlacedControl(control, placed, fit)
        found = adjust_to_control(model, scene, points, config.resolution, reporter, options, robust=robust)
        if found is model:
            break
        model, scene = found, rebuilt(found)
    return model
