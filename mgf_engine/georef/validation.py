# SPDX-License-Identifier: GPL-3.0-or-later
"""Find coordinates and marks that cannot be right, with a probable cause.

Causes are degrees, feet, swapped columns, another zone or hemisphere, the wrong photo.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from mgf_engine.errors import BadInput
from mgf_engine.georef.control_points import ControlPoint, ControlPoints, Mark
from mgf_engine.georef.crs import ProjectedCrs, to_enu
from mgf_engine.georef.options import MarkOptions
from mgf_engine.georef.triangulate import TriangulatedPoint, outlier_limits, project_point
from mgf_engine.model.scene import Scene

Array = NDArray[np.float64]
_FAR = 2000.0  # m between control points and photos: only a wrong CRS puts them there
_DEGREES = 0.05  # extent of the largest site, degrees: what tells degrees from metres
_NAMED = 4  # wrong marks that get a sentence each
_EXCHANGED = {
    "East and north": [1, 0, 2], "North and height": [0, 2, 1], "East and height": [2, 1, 0],
}  # fmt: skip
_FEET = 0.3048
_HIGHEST = 9000.0  # m, of a height on land


def check_points(points: Sequence[ControlPoint], projection: ProjectedCrs | None, photos: Array | None) -> None:
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
    high = float(np.abs(at[:, 2]).max())
    if high > _HIGHEST:
        mistake = _mistake(at, projection.covers)
        if mistake is not None:
            raise BadInput(mistake)
        raise BadInput(
            f"A control point lies {high / 1000:,.0f} km high; check that east, north and height stand in their "
            "columns, in metres."
        )
    if photos is not None:
        away = _distance(at, projection, photos)
        if away > _FAR:
            raise BadInput(_far_text(at, projection, photos, away))


def _outside_text(at: Array, projection: ProjectedCrs) -> str:
    mistake = _mistake(at, projection.covers)
    if mistake is not None:
        return mistake
    return (
        f"The control points lie outside of what {projection.name} is made for ({projection.area}); check --crs and "
        "the coordinates."
    )


def _mistake(at: Array, fits: Callable[[Array], bool]) -> str | None:
    """Return a sentence on the mistake without which coordinates [N, 3] would fit: exchanged columns, or feet."""

    def possible(places: Array) -> bool:
        return fits(places) and bool(np.abs(places[:, 2]).max() < _HIGHEST)

    for names, columns in _EXCHANGED.items():
        if possible(at[:, columns]):
            return f"{names} of the control points seem swapped; exchange the two columns."
    if possible(at * _FEET):
        return "The coordinates of the control points seem to be feet; convert them to metres."
    return None


def _far_text(at: Array, projection: ProjectedCrs, photos: Array, away: float) -> str:
    """Return a sentence on points ``away`` metres from the photos: swapped columns, another zone, or the CRS."""
    mistake = _mistake(at, lambda places: _distance(places, projection, photos) <= _FAR)
    if mistake is not None:
        return mistake
    for what, name in _siblings(projection.name):
        if _distance(at, ProjectedCrs(name), photos) <= _FAR:
            return f"The {what} of {projection.name} seems wrong: in {name} the control points lie by the photos."
    return (
        f"In {projection.name} the control points lie {away / 1000:,.0f} km from where the photos' GPS says; check "
        "--crs and the coordinates, or give --gps off."
    )


def _siblings(name: str) -> list[tuple[str, str]]:
    """List the UTM zones that one is easily confused with, each with what is wrong: hemisphere, zone, or both."""
    code = name.removeprefix("EPSG:")
    if not code.isdecimal():
        return []
    number, zones = int(code), list[tuple[str, int]]()
    beside = [("zone", number - 1), ("zone", number + 1)]
    if 32600 < number <= 32660 or 32700 < number <= 32760:
        other = number + 100 if number < 32700 else number - 100
        zones = [("hemisphere", other), *beside, *(("zone (and the hemisphere)", n) for n in (other - 1, other + 1))]
        zones = [(what, n) for what, n in zones if 1 <= n % 100 <= 60]
    elif 25828 <= number <= 25838:
        zones = [(what, n) for what, n in beside if 25828 <= n <= 25838]
    return [(what, f"EPSG:{n}") for what, n in zones]


def _distance(at: Array, projection: ProjectedCrs, photos: Array) -> float:
    """Compute metres on the ground between the middles of points and photos; inf where the CRS has no such place."""
    middle = projection.places(np.median(at, axis=0)[None])[0]
    if not np.isfinite(middle).all():
        return float("inf")
    seen = np.median(photos, axis=0) * (1, 1, 0)
    return float(np.linalg.norm(to_enu((middle * (1, 1, 0))[None], seen)[0]))


def check_marks(scene: Scene, control: ControlPoints) -> None:
    """Refuse marks whose x and y are exchanged: most lie beside their photos, and all would lie in them.

    Raises:
        BadInput: with the guess.
    """
    if not control.marks:
        return
    size = np.array([(v.original_width, v.original_height) for v in (scene.views[m.view] for m in control.marks)])
    at = np.array([mark.pixel for mark in control.marks])
    beside, exchanged = ((pixel > size).any(1) for pixel in (at, at[:, ::-1]))
    if beside.any() and not exchanged.any():
        raise BadInput("x and y of the marks seem swapped, for many lie beside their photos; exchange the two columns.")


def wrong_marks(
    scene: Scene, control: ControlPoints, placed: dict[str, TriangulatedPoint], options: MarkOptions = MarkOptions()
) -> list[str]:
    """Describe the marks that the other marks of their points contradict, each with a guess of the mistake; many in
    one sentence.

    Args:
        scene: cameras of the photos.
        control: points and marks.
        placed: marked points in the normalised frame, by name.
        options: limit of outliers.
    """
    wrong = [
        (name, mark, float(np.linalg.norm(residual)))
        for name, found in placed.items()
        for mark, residual, good in zip(found.marks, found.residuals, found.good, strict=True)
        if not good
    ]
    if len(wrong) <= _NAMED:
        return [_wrong_mark_text(scene, name, mark, away, placed, options) for name, mark, away in wrong]
    points, photos = {name for name, _, _ in wrong}, {mark.view for _, mark, _ in wrong}
    middle = float(np.median([away for _, _, away in wrong]))
    return [
        f"{len(wrong)} of {len(control.marks)} marks, of {len(points)} points in {len(photos)} photos, do not fit the "
        f"others (half of them by more than {middle:,.0f} pixels) and were left out; check that the file of marks is "
        "of these photos, names them rightly, and counts y from their upper edge."
    ]


def _wrong_mark_text(
    scene: Scene, name: str, mark: Mark, away: float, placed: dict[str, TriangulatedPoint], options: MarkOptions
) -> str:
    """Return a sentence on a mark that the others contradict, with the point that it fits, if there is one.

    Args:
        scene: cameras of the photos.
        name: of the marked point.
        mark: the mark.
        away: distance from where the other marks put it, px of the photo as taken.
        placed: marked points, by name.
        options: limit of outliers.
    """
    view = scene.views[mark.view]
    other = _point_at(scene, mark, placed, options)
    guess = f"; it fits '{other}'" if other is not None else ""
    off = f"{away:,.0f} pixels" if away < 1e6 else "far"
    return (
        f"The mark of '{name}' in '{view.name}' is {off} from where the other photos put it and was left out{guess}: "
        "check the photo and the name."
    )


def _point_at(scene: Scene, mark: Mark, placed: dict[str, TriangulatedPoint], options: MarkOptions) -> str | None:
    """Return the point that appears where a mark is."""
    view = scene.views[mark.view]
    best, nearest = None, float(outlier_limits([view], options)[0])
    for name, found in placed.items():
        at = project_point(view, found.position)
        if at is not None and (away := float(np.hypot(at[0] - mark.pixel[0], at[1] - mark.pixel[1]))) < nearest:
            best, nearest = name, away
    return best if best != mark.point else None
