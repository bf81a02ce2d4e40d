# SPDX-License-Identifier: GPL-3.0-or-later
"""Coordinates and marks that cannot be right are refused with the probable cause."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.analytic import camera
from support.small_scene import make_scene

from mgf_engine.errors import BadInput
from mgf_engine.georef.control_points import ControlPoint, ControlPoints, Mark
from mgf_engine.georef.crs import ProjectedCrs
from mgf_engine.georef.validation import check_marks, check_points

MUNICH = np.array([48.137, 11.575, 519.0])
UTM = ProjectedCrs("EPSG:32632")
#: Latitude, longitude and height of photos around the site.
PHOTOS = MUNICH + np.array([[1e-4, 0, 50], [-1e-4, 1e-4, 55], [0, -1e-4, 45]])


def points(crs: ProjectedCrs = UTM, scale: float = 1.0, order: tuple[int, int, int] = (0, 1, 2)) -> list[ControlPoint]:
    """Four points around the site in the coordinates of a CRS, times a factor, their columns exchanged."""
    places = MUNICH + np.array([[0, 0, 0], [2e-4, 0, 3], [2e-4, 3e-4, 1], [0, 3e-4, 5.0]])
    at = (crs.project(places) * scale)[:, order]
    return [ControlPoint(f"P{k}", tuple(row.tolist())) for k, row in enumerate(at)]


def test_points_by_their_photos_are_fine() -> None:
    check_points(points(), UTM, PHOTOS)
    check_points(points(), UTM, None)
    check_points(points(scale=3.0), None, PHOTOS)  # of a system that nobody named
    check_points([], UTM, PHOTOS)


@pytest.mark.parametrize(
    ("order", "said"),
    [
        ((1, 0, 2), "East and north of the control points seem swapped"),
        ((0, 2, 1), "North and height of the control points seem swapped"),
        ((2, 1, 0), "East and height of the control points seem swapped"),
    ],
)
def test_exchanged_columns_are_guessed(order: tuple[int, int, int], said: str) -> None:
    for photos in (PHOTOS, None):
        with pytest.raises(BadInput, match=said):
            check_points(points(order=order), UTM, photos)


def test_feet_and_degrees_are_guessed() -> None:
    with pytest.raises(BadInput, match="seem to be feet"):
        check_points(points(scale=1 / 0.3048), UTM, PHOTOS)
    degrees = [ControlPoint(f"P{k}", (11.575 + 1e-4 * k, 48.137 + 2e-4 * k, 519.0)) for k in range(4)]
    for crs in (UTM, None):
        with pytest.raises(BadInput, match="seem to be degrees"):
            check_points(degrees, crs, PHOTOS)


@pytest.mark.parametrize(
    ("written", "named", "said"),
    [
        ("EPSG:32633", "EPSG:32632", "The zone of EPSG:32632 seems wrong: in EPSG:32633"),
        ("EPSG:25833", "EPSG:25832", "The zone of EPSG:25832 seems wrong: in EPSG:25833"),
        ("EPSG:32632", "EPSG:32732", "The hemisphere of EPSG:32732 seems wrong: in EPSG:32632"),
        ("EPSG:32633", "EPSG:32732", r"The zone \(and the hemisphere\) of EPSG:32732 seems wrong: in EPSG:32633"),
    ],
)
def test_another_zone_or_hemisphere_is_guessed(written: str, named: str, said: str) -> None:
    with pytest.raises(BadInput, match=said):
        check_points(points(ProjectedCrs(written)), ProjectedCrs(named), PHOTOS)


@pytest.mark.parametrize(("north", "refused"), [(1500.0, False), (2400.0, True), (90_000.0, True)])
def test_points_far_from_the_photos_are_refused(north: float, refused: bool) -> None:
    moved = [replace(p, position=(p.position[0], p.position[1] + north, p.position[2])) for p in points()]
    if not refused:
        check_points(moved, UTM, PHOTOS)
        return
    with pytest.raises(BadInput, match=f"lie {north / 1000:,.0f} km from where the photos' GPS says"):
        check_points(moved, UTM, PHOTOS)


def test_heights_in_millimetres_are_no_heights() -> None:
    high = [replace(p, position=(*p.position[:2], 1000 * p.position[2])) for p in points()]
    with pytest.raises(BadInput, match="lies 524 km high; check that"):
        check_points(high, UTM, None)


def test_points_of_another_continent_are_outside_of_the_system() -> None:
    with pytest.raises(BadInput, match="lie outside of what EPSG:2193 is made for"):
        check_points(points(), ProjectedCrs("EPSG:2193"), None)


def test_marks_whose_columns_are_exchanged_are_guessed() -> None:
    wide = replace(camera((6.0, 0.0, 1.0), name="a.jpg"), original_width=400, original_height=300)
    scene = make_scene([wide], np.zeros((0, 3)), [])

    def marks(*pixels: tuple[float, float]) -> ControlPoints:
        return ControlPoints(marks=tuple(Mark("P", 0, pixel) for pixel in pixels))

    check_marks(scene, marks((390.0, 290.0), (10.0, 20.0)))
    check_marks(scene, marks((390.0, 350.0), (10.0, 20.0)))  # outside either way: somebody else says so
    check_marks(scene, ControlPoints())
    with pytest.raises(BadInput, match="x and y of the marks seem swapped"):
        check_marks(scene, marks((290.0, 390.0), (10.0, 20.0)))
