# SPDX-License-Identifier: GPL-3.0-or-later
"""Hulls of buildings: heights of ground and top from sparse points, and prisms of walls and roof."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from mgf_engine.georef.model import Georeference
from mgf_engine.scene.crop import parse_crop_box
from mgf_engine.town.crop import BuildingBoxOptions, crop_box
from mgf_engine.town.hulls import DOUBTFUL, GONE, READY, Hull, ground_of, make_hulls, prism, sample_prism
from mgf_engine.town.place import PlacedFootprints

HOUSE = shapely.box(-5, -4, 5, 4)
COURT = shapely.Polygon(HOUSE.exterior.coords, [shapely.box(-2, -1, 2, 1).exterior.coords])


def site(roof: int, ground_on_it: int = 0, height: float = 7.0) -> np.ndarray:
    """Points of level ground at 100 m around the house, of its roof, and of ground where it should stand."""
    random = np.random.default_rng(0)
    around = np.column_stack([random.uniform(-14, 14, (600, 2)), random.normal(100, 0.02, 600)])
    around = around[~shapely.contains_xy(HOUSE.buffer(0.9), around[:, :2])]
    top = np.column_stack([random.uniform((-5, -4), (5, 4), (roof, 2)), np.full(roof, 100 + height)])
    there = np.column_stack([random.uniform((-5, -4), (5, 4), (ground_on_it, 2)), np.full(ground_on_it, 100.0)])
    return np.concatenate([around, top, there])


def hull_of(points: np.ndarray, metre: float = 1.0) -> Hull:
    polygons = np.empty(1, object)
    polygons[:] = [shapely.affinity.scale(HOUSE, metre, metre, origin=(0, 0))]
    return make_hulls(["house"], polygons, points * metre, metre)[0]


def test_ground_and_top_are_those_of_the_points() -> None:
    found = hull_of(site(roof=60))
    assert (found.state, found.height_known) == (READY, True)
    assert found.low == pytest.approx(100, abs=0.05) and found.high == pytest.approx(107.2, abs=0.05)
    assert found.points == 60


def test_the_unit_of_the_local_frame_does_not_matter() -> None:
    found, small = hull_of(site(roof=60)), hull_of(site(roof=60), 0.1)
    assert (small.low * 10, small.high * 10) == pytest.approx((found.low, found.high))


@pytest.mark.parametrize(("ground", "state"), [(20, GONE), (2, DOUBTFUL)])
def test_a_building_without_points_has_no_known_height(ground: int, state: str) -> None:
    found = hull_of(site(roof=3, ground_on_it=ground))
    assert (found.state, found.height_known, found.points) == (state, False, 3)
    assert found.reason.endswith(".") and found.high - found.low == pytest.approx(2.0)


def test_the_ground_is_what_most_low_points_share() -> None:
    assert ground_of(np.array([5.0, 5.1, 4.9, 5.0, 9.0, 12.0, 1.0, 5.05])) == pytest.approx(5.0, abs=0.06)
    assert ground_of(np.array([3.0])) == 3.0


@pytest.mark.parametrize("polygon", [HOUSE, COURT, shapely.MultiPolygon([HOUSE, shapely.box(7, 0, 9, 2)])])
def test_a_prism_has_the_walls_and_the_roof_of_its_polygon(polygon: shapely.Geometry) -> None:
    vertices, faces = prism(polygon, 1.0, 4.0)
    corner = vertices[faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    area, level = 0.5 * np.linalg.norm(normal, axis=1), np.abs(normal[:, 2]) > 1e-9
    assert area[level].sum() == pytest.approx(polygon.area)
    assert area[~level].sum() == pytest.approx(3 * polygon.length)
    assert set(vertices[:, 2]) == {1.0, 4.0}


@pytest.mark.parametrize("polygon", [HOUSE, COURT])
def test_samples_of_a_prism_lie_on_it_and_look_outwards(polygon: shapely.Polygon) -> None:
    places, normals = sample_prism(polygon, 0.0, 6.0, 1.0)
    roof = normals[:, 2] > 0.5
    assert (places[roof, 2] == 6.0).all() and shapely.contains_xy(polygon, places[roof, :2]).all()
    assert len(places[roof]) == pytest.approx(polygon.area, rel=0.15)
    wall = places[~roof]
    assert shapely.distance(polygon.boundary, shapely.points(wall[:, :2])).max() < 1e-9
    assert len(wall) == pytest.approx(6 * polygon.length, rel=0.05)
    ahead = wall + 0.01 * normals[~roof]
    assert not shapely.contains_xy(polygon, ahead[:, :2]).any()


def test_a_corner_that_the_map_names_twice_makes_no_difference() -> None:
    twice = shapely.Polygon([(-5, -4), (-5, -4), (5, -4), (5, 4), (5, 4), (-5, 4)])
    found, once = sample_prism(twice, 0.0, 6.0, 1.0), sample_prism(HOUSE, 0.0, 6.0, 1.0)
    assert len(found[0]) == len(once[0])
    assert np.linalg.norm(found[1], axis=1) == pytest.approx(1.0)


def box_of(hull: Hull, others: dict[str, shapely.Geometry], options: BuildingBoxOptions) -> tuple[np.ndarray, ...]:
    """Least and greatest corner of the crop box."""
    placed = PlacedFootprints(Georeference(), np.empty(0, object), 1.0, None, "")
    box = parse_crop_box(crop_box(hull, {hull.id: hull.polygon, **others}, placed, options))
    assert box is not None
    cube = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    back = np.linalg.inv(box.to_cube)
    corners = cube @ back[:3, :3].T + back[:3, 3]
    return corners.min(0), corners.max(0)


def test_a_crop_box_ends_at_the_neighbour_and_leaves_room_for_eaves() -> None:
    options = BuildingBoxOptions(eaves=1.5, neighbour=0.25, below=0.5)
    hull = Hull("house", HOUSE, 100.0, 108.0, 50)
    low, high = box_of(hull, {"next": shapely.box(5.1, -4, 12, 4)}, options)
    assert low == pytest.approx([-6.5, -5.5, 99.5]) and high == pytest.approx([5.25, 5.5, 114.0])


def test_a_building_whose_height_no_point_tells_is_not_cut_off() -> None:
    options = BuildingBoxOptions(unknown_height=30.0)
    _, high = box_of(Hull("house", HOUSE, 100.0, 102.0, 0, GONE, "", height_known=False), {}, options)
    assert high[2] == pytest.approx(130.0)
