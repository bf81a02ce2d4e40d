# SPDX-License-Identifier: GPL-3.0-or-later
"""Coordinate reference systems: how people write them, which are refused, and coordinates there and back."""

from __future__ import annotations

import numpy as np
import pyproj
import pytest

from mgf_engine.errors import BadInput
from mgf_engine.georef.crs import (
    AUTO,
    ProjectedCrs,
    normalise_crs,
    stretches,
    to_enu,
    utm_zone,
    utm_zone_number,
)

MUNICH = np.array([48.137, 11.575, 519.0])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("EPSG:999999", "There is no coordinate reference system 'EPSG:999999'"),
        ("nonsense", "There is no coordinate reference system"),
        ("WGS84 UTM 99N", "There is no coordinate reference system"),
        ("EPSG:4326", "no eastings and northings in metres"),
        ("EPSG:4978", "no eastings and northings in metres"),
        ("EPSG:5783", "is no projected system"),
        ("EPSG:2263", "counts in US survey foot"),
        ("EPSG:3857", "stretches lengths.*such as EPSG:32632 here"),
        ("EPSG:3395", "stretches lengths"),
    ],
)
def test_systems_without_metres_on_the_ground_are_refused(text: str, said: str) -> None:
    with pytest.raises(BadInput, match=said):
        ProjectedCrs(text, MUNICH)
    with pytest.raises(BadInput):
        ProjectedCrs(text)


def test_auto_needs_a_place() -> None:
    assert ProjectedCrs(AUTO, MUNICH).name == "EPSG:32632"
    with pytest.raises(BadInput, match="cannot be chosen without GPS"):
        ProjectedCrs(AUTO)


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("25832", "EPSG:25832"), (" epsg: 25832 ", "EPSG:25832"), ("WGS84 UTM 32N", "EPSG:32632"),
        ("wgs 84 utm zone 7s", "EPSG:32707"), ("EPSG:25832+7837", "EPSG:25832+7837"), ("WGS84 UTM 61N",) * 2,
    ],
)  # fmt: skip
def test_systems_as_people_write_them(text: str, code: str) -> None:
    assert normalise_crs(text) == code


@pytest.mark.parametrize(("longitude", "zone"), [(-180.0, 1), (-177.0, 1), (11.575, 32), (12.0, 33), (180.0, 60)])
def test_zones_of_utm(longitude: float, zone: int) -> None:
    assert utm_zone_number(longitude) == zone
    assert utm_zone(48.0, longitude) == f"EPSG:{32600 + zone}" and utm_zone(-1.0, longitude) == f"EPSG:{32700 + zone}"


@pytest.mark.parametrize(
    ("code", "world"),
    [(3857, True), (3395, True), (25832, False), (2056, False), (23700, False), (28992, False), (5514, False)],
)
def test_maps_of_the_world_alone_stretch_lengths(code: int, world: bool) -> None:
    """Oblique Mercator projections, as in Switzerland and Hungary, are true to length where they are used."""
    crs = pyproj.CRS.from_epsg(code)
    assert stretches(crs) == world
    area = crs.area_of_use
    middle = (0.5 * (area.west + area.east), 50.0 if world else 0.5 * (area.south + area.north))
    scale = pyproj.Proj(crs).get_factors(*middle).meridional_scale
    assert (abs(scale - 1) > 0.01) == world


@pytest.mark.parametrize("code", ["EPSG:25832", "EPSG:31468", "EPSG:2056", "EPSG:32633"])
def test_places_go_there_and_back(code: str) -> None:
    crs = ProjectedCrs(code)
    places = MUNICH + np.array([[0.0, 0.0, 0.0], [0.01, -0.02, 30.0]])
    points = crs.project(places)
    # Eastings before northings, whatever the order of the system's own axes.
    assert points[1, 0] < points[0, 0] - 1000 and points[1, 1] > points[0, 1] + 900
    assert np.abs(crs.places(points) - places)[:, :2].max() < 1e-8
    assert crs.covers(points) and not crs.covers(points[:, ::-1])


def test_metres_around_a_place() -> None:
    found = to_enu(MUNICH + np.array([[0.0, 0.0, 0.0], [1e-3, 0.0, 0.0], [0.0, 0.0, 7.0]]), MUNICH)
    assert found[0] == pytest.approx([0, 0, 0], abs=1e-6) and found[2] == pytest.approx([0, 0, 7], abs=1e-6)
    assert found[1] == pytest.approx([0, 111.2, 0], abs=0.1)


def test_heights_without_their_grid_are_said_to_be_ellipsoidal() -> None:
    assert ProjectedCrs("EPSG:25832").heights() == ("ellipsoidal", "")
    kind, warning = ProjectedCrs("EPSG:25832+7837").heights()
    grid = kind == "DHHN2016 height" and not warning
    assert grid or (kind == "ellipsoidal" and "DHHN2016 height" in warning)


def test_the_text_for_prj_files_is_read_back() -> None:
    text = ProjectedCrs("EPSG:25832").wkt()
    assert pyproj.CRS.from_wkt(text).to_epsg(min_confidence=20) == 25832
    assert text.startswith("PROJCS[")
