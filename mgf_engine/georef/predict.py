# SPDX-License-Identifier: GPL-3.0-or-later
"""Predict where control points appear in the photos, to help with marking them.

Each point by the best that is known of it: its own marks, the other points' marks (three or more), or the georeference
that the job has already, for example by GPS.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mgf_engine.errors import BadInput
from mgf_engine.files.atomic import write_json
from mgf_engine.georef.control_points import CONTROL, ControlPoint, ControlPoints, read_marks, read_points
from mgf_engine.georef.crs import ProjectedCrs, to_enu
from mgf_engine.georef.fit_control import fit_control
from mgf_engine.georef.model import Georeference, read_georeference
from mgf_engine.georef.options import GeoreferenceOptions
from mgf_engine.georef.similarity import transform_points
from mgf_engine.georef.triangulate import TriangulatedPoint, place_points, project_point
from mgf_engine.messages import Reporter
from mgf_engine.model.scene import Scene, View
from mgf_engine.options.config import make_config
from mgf_engine.scene.store import read_saved_scene

Array = NDArray[np.float64]
FORMAT = 1
MARKS, OTHERS, GEOREFERENCE = "marks", "other points", "georeference"  # what a place is known by
_LEAST_RADIUS = 4.0  # px of the photo as taken: as well as people click


def write_places(job: Path, user_options: Mapping[str, Any], out: Path, reporter: Reporter) -> int:
    """Write the points of ``--control`` and where they should appear, as JSON; returns how many points there are.

    Args:
        job: its scene is enough, it need not be finished.
        user_options: ``control``, and where there are some ``marks`` and ``crs``.
        out: the JSON file.
        reporter: for progress and warnings.

    Raises:
        BadInput: the job has no scene yet, or a file cannot be used.
    """
    options = make_config(dict(user_options)).algorithm(GeoreferenceOptions)
    if not options.control:
        raise BadInput("--predict needs control points; give them with --control FILE.")
    scene, georeference = read_saved_scene(job / "scene"), read_georeference(job)
    names = [view.name for view in scene.views]
    control = read_points(Path(options.control), names, options.point.accuracy)
    marks = control.marks
    if options.marks:
        marks = (*marks, *read_marks(Path(options.marks), names)[0])
    placed, failed = place_points(scene, marks, options.mark)
    reporter.progress(0.5)
    known = known_places(scene, control, placed, failed, georeference, options)
    points = [_entry(scene, point, placed.get(point.name), known.get(point.name)) for point in control.points]
    write_json(out, {"format": FORMAT, "crs": control.crs, "points": points})
    reporter.progress(1.0)
    return len(points)


def known_places(
    scene: Scene,
    control: ControlPoints,
    placed: Mapping[str, TriangulatedPoint],
    failed: Mapping[str, str],
    georeference: Georeference,
    options: GeoreferenceOptions,
) -> dict[str, tuple[Array, str, float]]:
    """Find where each point is by the best evidence.

    Args:
        scene: normalised frame.
        control: points and marks of the user.
        placed: points that marks in two photos and more place.
        failed: point -> why its marks do not.
        georeference: of the scene, as far as it is known.
        options: CRS, and what counts as wrong.

    Returns:
        Point -> its position [3], normalised frame, what it is known by, and its error in the same units.

    Raises:
        BadInput: the CRS cannot be used.
    """
    normalised = scene.to_normalised
    found: dict[str, tuple[Array, str, float]] = {}
    at = control.positions()
    world = _by_georeference(at, georeference, options.crs or control.crs)
    if world is not None:
        off = float(np.sqrt(sum(v**2 for k, v in georeference.accuracy.items() if k.startswith(georeference.method))))
        off *= normalised.scale / georeference.scale
        places = normalised.apply(world)
        found = {p.name: (x, GEOREFERENCE, off) for p, x in zip(control.points, places, strict=True)}
    own = [p for p in control.points if p.role == CONTROL and p.name in placed]
    if len(own) >= 3:
        with contextlib.suppress(BadInput):  # what is wrong with them is said where they are used
            fit = fit_control(scene, control.points, placed, failed, None, options.point)
            back = np.asarray(np.linalg.inv(fit.matrix), np.float64)
            away = [row.distance for row in fit.rows if row.used]
            off = max(away) / float(np.cbrt(np.linalg.det(fit.matrix[:3, :3])))
            for point in control.points:
                place = transform_points(back, np.array(point.position) - fit.offset)
                found[point.name] = np.asarray(place), OTHERS, off
    for name, own_marks in placed.items():
        found[name] = own_marks.position, MARKS, 0.0
    return found


def _by_georeference(at: Array, georeference: Georeference, crs: str) -> Array | None:
    """Convert the coordinates of a CRS [N, 3] into the scene frame; None where the job knows nothing of where it is."""
    if not georeference.metric or not georeference.north_known or not len(at):
        return None
    if georeference.crs is not None and crs in ("", georeference.crs):
        return georeference.from_world(at)
    if not crs or crs == "auto":
        return None
    places = ProjectedCrs(crs).places(at)
    if georeference.crs is not None:
        return georeference.from_world(ProjectedCrs(georeference.crs).project(places))
    if georeference.origin is None:
        return None
    return georeference.scene(to_enu(places, np.array(georeference.origin)))


def _entry(
    scene: Scene, point: ControlPoint, placed: TriangulatedPoint | None, known: tuple[Array, str, float] | None
) -> dict[str, Any]:
    """Return a point as the file has it: photos that should show it, with x, y and the radius to look within, in
    pixels."""
    photos = {}
    if known is not None:
        place, _, off = known
        for view in scene.views:
            pixel = project_point(view, place)
            if pixel is not None:
                photos[view.name] = [round(v, 2) for v in (*pixel, _radius(view, place, off))]
    wrong = [] if placed is None else [m.view for m, ok in zip(placed.marks, placed.good, strict=True) if not ok]
    return {
        "name": point.name, "role": point.role, "by": known[1] if known is not None else "",
        "pixels": round(placed.rms, 2) if placed is not None and placed.good.any() else None,
        "wrong": [scene.views[index].name for index in wrong], "photos": photos,
    }  # fmt: skip


def _radius(view: View, place: Array, off: float) -> float:
    """Return the pixels of the photo as taken that ``off`` covers at a place."""
    distance = max(float(np.linalg.norm(place - view.centre)), 1e-12)
    return max(_LEAST_RADIUS, off / distance * view.fx * view.original_width / view.width)
