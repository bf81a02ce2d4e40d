# SPDX-License-Identifier: GPL-3.0-or-later
"""CityJSON of a known block: coordinates to the millimetre, and what is said of each surface."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from mgf_engine.georef.model import METRE, SCENE_UNITS, Georeference
from mgf_engine.models.cityjson import make_cityjson, reference_system
from mgf_engine.models.lod import Deviation
from mgf_engine.models.solid.model import GROUND, ROOF, WALL, WINDOW, Solid, SolidFace

OFFSET = np.array([691_234.0, 5_334_876.0, 519.25])
CORNERS = np.array([(0, 0, 0), (8, 0, 0), (8, 6, 0), (0, 6, 0), (0, 0, 3), (8, 0, 3), (8, 6, 3), (0, 6, 3)], float)
FACES = [
    SolidFace(GROUND, ((3, 2, 1, 0),)), SolidFace(ROOF, ((4, 5, 6, 7),), 0), SolidFace(WALL, ((0, 1, 5, 4),)),
    SolidFace(WALL, ((1, 2, 6, 5),)), SolidFace(WALL, ((2, 3, 7, 6),)), SolidFace(WALL, ((3, 0, 4, 7),)),
]  # fmt: skip
BLOCK = Solid(CORNERS, FACES, volume=144.0, detail=0.25, unseen={ROOF: 0.0, WALL: 0.1})


def survey(crs: str | None = "EPSG:25832", unit: str = METRE) -> SimpleNamespace:
    georeference = Georeference(np.eye(4), tuple(OFFSET.tolist()), crs, unit, True, True, "control")
    return SimpleNamespace(georeference=georeference, world=georeference.world)


def vertices_of(data: dict) -> np.ndarray:
    return np.array(data["vertices"]) * data["transform"]["scale"] + data["transform"]["translate"]


def test_coordinates_are_those_of_the_world_to_half_a_millimetre() -> None:
    block = replace(BLOCK, vertices=CORNERS + 0.12345)
    data = make_cityjson(block, survey(), "house")  # type: ignore[arg-type]
    assert np.abs(vertices_of(data) - (block.vertices + OFFSET)).max() <= 0.5e-3 + 1e-9
    assert data["metadata"]["referenceSystem"].endswith("/EPSG/0/25832")
    low, high = np.array(data["metadata"]["geographicalExtent"]).reshape(2, 3)
    assert high - low == pytest.approx([8, 6, 3], abs=2e-3)
    assert all(isinstance(v, int) and v >= 0 for vertex in data["vertices"] for v in vertex)


def test_a_scene_without_a_scale_has_a_millionth_of_its_size_as_its_step() -> None:
    data = make_cityjson(BLOCK, survey(None, SCENE_UNITS), "house")  # type: ignore[arg-type]
    assert data["transform"]["scale"] == [pytest.approx(8e-6)] * 3 and "referenceSystem" not in data["metadata"]


def test_surfaces_say_what_they_are_and_where_they_look() -> None:
    data = make_cityjson(replace(BLOCK, deviation=Deviation(0.01, 0.02, 0.03, 0.1)), survey(), "house")  # type: ignore[arg-type]
    building = data["CityObjects"]["house"]
    (geometry,) = building["geometry"]
    assert geometry["lod"] == "2" and geometry["boundaries"][0][0] == [[3, 2, 1, 0]]
    surfaces = geometry["semantics"]["surfaces"]
    assert geometry["semantics"]["values"] == [[0, 1, 2, 3, 4, 5]]
    assert [s["type"] for s in surfaces] == ["GroundSurface", "RoofSurface"] + 4 * ["WallSurface"]
    assert [s.get("azimuth") for s in surfaces] == [None, None, 180.0, 90.0, 0.0, 270.0]
    assert [s["area"] for s in surfaces] == [48.0, 48.0, 24.0, 18.0, 24.0, 18.0] and surfaces[1]["slope"] == 0.0
    said = building["attributes"]
    assert (said["measuredHeight"], said["volume"], said["deviationRMS"], said["deviation90"]) == (
        3.0,
        144.0,
        0.01,
        0.02,
    )


def test_a_window_belongs_to_its_wall() -> None:
    more = np.array([(2, 0, 1), (3, 0, 1), (3, 0, 2), (2, 0, 2)], float)
    wall = replace(FACES[2], rings=((0, 1, 5, 4), (11, 10, 9, 8)))
    window = SolidFace(WINDOW, ((8, 9, 10, 11),), wall=2)
    detailed = replace(BLOCK, vertices=np.concatenate([CORNERS, more]), level=3,
                       faces=[*FACES[:2], wall, *FACES[3:], window])  # fmt: skip
    plain, fine = make_cityjson(BLOCK, survey(), "house", detailed)["CityObjects"]["house"]["geometry"]  # type: ignore[arg-type]
    assert (plain["lod"], fine["lod"]) == ("2", "3")
    surfaces = fine["semantics"]["surfaces"]
    assert surfaces[2]["children"] == [6] and surfaces[6]["parent"] == 2 and surfaces[6]["type"] == "Window"
    assert surfaces[2]["area"] == 23.0 and surfaces[6]["area"] == 1.0


@pytest.mark.parametrize(("crs", "end"), [("EPSG:25832", "/25832"), ("epsg:2056", "/2056")])
def test_systems_are_uris_of_ogc(crs: str, end: str) -> None:
    assert str(reference_system(crs)).endswith(end)


def test_what_is_no_code_is_no_uri() -> None:
    assert reference_system(None) is None and reference_system("EPSG:25832+7837") is None
