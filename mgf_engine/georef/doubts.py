# SPDX-License-Identifier: GPL-3.0-or-later
"""Coordinates that cannot be right, and the guess what happened: degrees, swapped axes, another zone or hemisphere."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mgf_engine.errors import BadInput
from mgf_engine.georef.control import Control, Mark, Point
from mgf_engine.georef.crs import Projection, enu
from mgf_engine.georef.options import MarkOptions
from mgf_engine.georef.triangulate import Placed, outlier_limits, project_point
from mgf_engine.model.scene import Scene

Array = NDArray[np.float64]
_FAR = 2000.0  # m between control points and photos: only a wrong CRS puts them there
_DEGREES = 0.05  # extent of the largest site, degrees: what tells degrees from metres


def check_points(points: Sequence[Point], projection: Projection | None, photos: Array | None) -> None:
    """Refuse coordinates that are no eastings and northings of the CRS, or are far from the photos.

    Args:
        photos: latitude, longitude and height of the photos' GPS [N, 3]; None without.

    Raises:
        BadInput: with the guess.
    """
    at = np.array([p.position for p in points], np.float64).reshape(-1, 3)
    if len(at) and (np.abs(at[:, :2]) <= 180).all() and 0 < np.ptp(at[:, :2], axis=0).max() < _DEGREES:
        raise BadInput(
            "East and north of the control points seem to be degrees; convert them to a projected system in metres, "
            "such as UTM, and name it with --crs."
        )
    if projection is None or not len(at):
        return
    if not projection.covers(at):
        raise BadInput(_outside_text(at, projection))
    if photos is not None:
        away = _distance(at, projection, photos)
        if away > _FAR:
            raise BadInput(_far_text(at, projection, photos, away))


def _outside_text(at: Array, projection: Projection) -> str:
    if projection.covers(at[:, [1, 0, 2]]):
        return "East and north of the control points seem swapped; exchange the two columns."
    return (
        f"The control points lie outside of what {projection.name} is made for ({projection.area}); check --crs and "
        "the coordinates."
    )


def _far_text(at: Array, projection: Projection, photos: Array, away: float) -> str:
    if _distance(at[:, [1, 0, 2]], projection, photos) <= _FAR:
        return "East and north of the control points seem swapped; exchange the two columns."
    for name in _siblings(projection.name):
        if _distance(at, Projection(name), photos) <= _FAR:
            what = "hemisphere" if name[-2:] == projection.name[-2:] else "zone"
            return f"The {what} of {projection.name} seems wrong: in {name} the control points lie by the photos."
    return (
        f"In {projection.name} the control points lie {away / 1000:,.0f} km from where the photos' GPS says; check "
        "--crs and the coordinates, or give --gps off."
    )


def _siblings(name: str) -> list[str]:
    """Return the same UTM zone of the other hemisphere, and the zones beside it."""
    code = name.removeprefix("EPSG:")
    if not code.isdecimal():
        return []
    number, near = int(code), []
    if 32600 < number <= 32660 or 32700 < number <= 32760:
        near = [number + 100 if number < 32700 else number - 100, number - 1, number + 1]
        near = [n for n in near if 1 <= n % 100 <= 60]
    elif 25828 <= number <= 25838:
        near = [n for n in (number - 1, number + 1) if 25828 <= n <= 25838]
    return [f"EPSG:{n}" for n in near]


def _distance(at: Array, projection: Projection, photos: Array) -> float:
    """Compute metres on the ground between the middles of points and photos; inf where the CRS has no such place."""
    middle = projection.places(np.median(at, axis=0)[None])[0]
    if not np.isfinite(middle).all():
        return float("inf")
    seen = np.median(photos, axis=0) * (1, 1, 0)
    return float(np.linalg.norm(enu((middle * (1, 1, 0))[None], seen)[0]))


def wrong_marks(
    scene: Scene, control: Control, placed: dict[str, Placed], options: MarkOptions = MarkOptions()
) -> list[str]:
    """Describe each mark that the other marks of its point contradict, with a guess of the mistake.

    Args:
        scene: cameras of the photos.
        control: points and marks.
        placed: marked points in the normalised frame, by name.
        options: limit of outliers.
    """
    texts = []
    for name, found in placed.items():
        for mark, residual, good in zip(found.marks, found.residuals, found.good, strict=True):
            if not good:
                texts.append(_wrong_mark_text(scene, name, mark, float(np.linalg.norm(residual)), placed, options))
    return texts


def _wrong_mark_text(
    scene: Scene, name: str, mark: Mark, away: float, placed: dict[str, Placed], options: MarkOptions
) -> str:
    view = scene.views[mark.view]
    other = _point_at(scene, mark, placed, options)
    guess = f"; it fits '{other}'" if other is not None else ""
    off = f"{away:,.0f} pixels" if away < 1e6 else "far"
    return (
        f"The mark of '{name}' in '{view.name}' is {off} from where the other photos put it and was left out{guess}: "
        "check the photo and the name."
    )


def _point_at(scene: Scene, mark: Mark, placed: dict[str, Placed], options: MarkOptions) -> str | None:
    """Return the point that appears where a mark is."""
    view = scene.views[mark.view]
    best, nearest = None, float(outlier_limits([view], options)[0])
    for name, found in placed.items():
        at = project_point(view, found.position)
        if at is not None and (away := float(np.hypot(at[0] - mark.pixel[0], at[1] - mark.pixel[1]))) < nearest:
            best, nearest = name, away
    return best if best != mark.point else None
