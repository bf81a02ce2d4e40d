# SPDX-License-Identifier: GPL-3.0-or-later
"""Bare earth between buildings and under them, and solids of several buildings in one file."""

from __future__ import annotations

import gzip
import json
from pathlib import Path
from types import SimpleNamespace

import jsonschema
import numpy as np
import pytest
import shapely
from support.small_scene import view

from mgf_engine.errors import BadInput, Cancelled
from mgf_engine.geometry.rasterize import face_normals
from mgf_engine.georef.model import Georeference
from mgf_engine.masks.prompts import Clicks
from mgf_engine.masks.propagation.prompt_messages import PromptMessages
from mgf_engine.masks.propagation.prompt_outliers import OutlierPrompt
from mgf_engine.town import solid
from mgf_engine.town.hulls import BY_HAND, READY
from mgf_engine.town.page import _letters, _shown
from mgf_engine.town.result import TERRAIN_LOG
from mgf_engine.town.run import _reason
from mgf_engine.town.solid import ground_of_neighbours, merge_cityjson
from mgf_engine.town.terrain import TerrainOptions, ground_surface

HOUSE = shapely.box(-6, -5, 6, 5)


def slope(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return 500 + 0.08 * x - 0.03 * y


def hillside(seed: int = 0) -> np.ndarray:
    """Points of a hillside of 60 m with a house, a tree and some wrong matches below the ground."""
    random = np.random.default_rng(seed)
    plan = random.uniform(-30, 30, (4000, 2))
    plan = plan[~shapely.contains_xy(HOUSE, plan)]
    ground = np.column_stack([plan, slope(*plan.T) + random.normal(0, 0.05, len(plan))])
    roof = random.uniform((-6, -5, 505), (6, 5, 507), (800, 3))
    tree = random.normal((18, 12, slope(18, 12) + 5), (1.5, 1.5, 1.0), (300, 3))
    sunken = random.uniform((-30, -30, 480), (30, 30, 497), (15, 3))
    return np.concatenate([ground, roof, tree, sunken])


def test_the_ground_goes_on_under_houses_and_trees() -> None:
    mesh = ground_surface(hillside(), [HOUSE], 1.0)
    x, y, z = mesh.vertices.T
    off = np.abs(z - slope(x, y))
    assert np.percentile(off, 95) < 0.15 and off.max() < 0.7  # smoothed at the rim
    assert shapely.contains_xy(HOUSE, mesh.vertices).sum() > 15
    assert (face_normals(mesh)[:, 2] > 0.9).all()
    assert 2.0 * len(mesh.faces) == pytest.approx(60 * 60, rel=0.12)  # half of 2 m x 2 m each


def test_options_of_the_grid() -> None:
    coarse = ground_surface(hillside(), [HOUSE], 1.0, TerrainOptions(cell=4.0))
    assert 8.0 * len(coarse.faces) == pytest.approx(60 * 60, rel=0.2)
    few = ground_surface(hillside(), [HOUSE], 1.0, TerrainOptions(most_cells=10))
    assert np.ptp(few.vertices[:, :2], axis=0).max() <= 70 and len(few.faces) <= 2 * 11 * 11
    with pytest.raises(BadInput, match="and 9999 are needed"):
        ground_surface(hillside(), [HOUSE], 1.0, TerrainOptions(least_points=9999))


def test_the_unit_of_the_scene_does_not_matter() -> None:
    one = ground_surface(hillside(), [HOUSE], 1.0)
    small = shapely.transform(HOUSE, lambda p: 0.01 * p)
    other = ground_surface(0.01 * hillside(), [small], 0.01)
    assert len(one.faces) == len(other.faces)
    assert np.abs(100 * other.vertices - one.vertices).max() < 1e-6


def test_what_nobody_saw_has_no_terrain() -> None:
    points = hillside()
    far = points[np.abs(points[:, 0]) < 10] + (200, 0, 16)  # another quarter, 190 m away
    mesh = ground_surface(np.concatenate([points, far]), [HOUSE], 1.0)
    assert mesh.vertices[:, 0].max() < 40
    with pytest.raises(BadInput, match=r"0 points show the ground.* --no-terrain"):
        ground_surface(points, [shapely.box(-50, -50, 50, 50)], 1.0)


def cube(name: str, corner: tuple[float, float, float]) -> dict:
    low = [0, 0, 0]
    places = [[x, y, z] for z in (0, 3000) for x, y in ((0, 0), (5000, 0), (5000, 5000), (0, 5000))]
    sides = [[0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]]
    shell = [[[3, 2, 1, 0]], [[4, 5, 6, 7]], *([side] for side in sides)]
    surfaces = [{"type": "GroundSurface"}, {"type": "RoofSurface"}, *({"type": "WallSurface"} for _ in sides)]
    solid = {"type": "Solid", "lod": "2", "boundaries": [shell],
             "semantics": {"surfaces": surfaces, "values": [[0, 1, 2, 3, 4, 5]]}}  # fmt: skip
    return {
        "type": "CityJSON", "version": "2.0",
        "transform": {"scale": [0.001] * 3, "translate": [a + b for a, b in zip(low, corner, strict=True)]},
        "metadata": {"title": name, "referenceSystem": "https://www.opengis.net/def/crs/EPSG/0/25832"},
        "CityObjects": {name: {"type": "Building", "attributes": {"measuredHeight": 3.0}, "geometry": [solid]}},
        "vertices": places,
    }  # fmt: skip


def test_solids_are_one_file_that_keeps_to_the_schema() -> None:
    corners = {"a": (691000.0, 5334000.0, 500.0), "b": (691040.0, 5333990.0, 502.0)}
    town = merge_cityjson([cube(name, corner) for name, corner in corners.items()], "town")
    schema = Path(__file__).parents[1] / "models" / "cityjson.schema.json.gz"
    jsonschema.Draft7Validator(json.loads(gzip.decompress(schema.read_bytes()))).validate(town)
    places = np.array(town["vertices"]) * town["transform"]["scale"] + town["transform"]["translate"]
    for name, corner in corners.items():
        (geometry,) = town["CityObjects"][name]["geometry"]
        used = sorted({index for face in geometry["boundaries"][0] for ring in face for index in ring})
        assert len(used) == 8 and places[used].min(0) == pytest.approx(corner, abs=1e-6)
        assert places[used].max(0) == pytest.approx(np.add(corner, (5, 5, 3)), abs=1e-6)
    assert town["metadata"]["geographicalExtent"] == [691000.0, 5333990.0, 500.0, 691045.0, 5334005.0, 505.0]


def test_the_ground_of_neighbours_is_that_of_what_stands_there(tmp_path: Path) -> None:
    places = {"own": ("ready", 0), "next": ("ready", 10), "gone": ("nothing there", 20)}
    features = [
        {"type": "Feature", "properties": {"id": name, "state": state},
         "geometry": json.loads(shapely.to_geojson(shapely.box(500 + x, 900, 510 + x, 910)))}
        for name, (state, x) in places.items()
    ]  # fmt: skip
    (tmp_path / "buildings.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    taken = ground_of_neighbours(tmp_path, "own", Georeference(offset=(500.0, 900.0, 0.0)), 1.0)
    assert shapely.contains_xy(taken, [9.5, 15, 20.5], [5, 5, 5]).all()
    assert not shapely.contains_xy(taken, [5, 22, 15], [5, 5, 12]).any()


def test_names_on_the_page_stay_over_their_buildings() -> None:
    assert _letters("villa", 90.0) == 12.0
    narrow = _letters("terrace_middle", 76.0)
    assert 7.0 < narrow < 12.0 and narrow * 0.6 * len("terrace_middle") <= 77
    assert _letters("a name that nothing makes fit", 20.0) == 7.0


@pytest.mark.parametrize(("state", "told"), [(READY, 1), (BY_HAND, 3)])
def test_who_made_no_clicks_is_not_told_to_look_at_them_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, state: str, told: int
) -> None:
    outlier = OutlierPrompt(0, False, 0, 0.9)
    graph = SimpleNamespace(scene=SimpleNamespace(views=[view("a.jpg", 0)]))
    monkeypatch.setattr("mgf_engine.masks.propagation.prompt_messages.on_points", lambda *_: False)
    clicks = {0: Clicks(np.array([[3.0, 4.0]]), np.array([[3.0, 4.0]]))}
    said = PromptMessages(graph, clicks, [])  # type: ignore[arg-type]
    warnings = [said._used_text(0, [outlier]), said._ignored_text(0, [outlier]), "The photos are noisy."]
    row = {"id": "a", "state": state, "job": "done", "reason": "", "height": 1.0, "area": 1.0, "photos": [],
           "pixel": 0.1, "status": {}, "done": {"warnings": warnings}}  # fmt: skip
    assert len(_shown(row, tmp_path)["warnings"]) == told


def test_a_building_without_a_solid_says_why_and_is_no_failure(tmp_path: Path, monkeypatch, capsys) -> None:
    folder = tmp_path / "buildings" / "house"
    folder.mkdir(parents=True)

    def written() -> dict:
        solid.write_solid(folder, folder / "job")
        return json.loads((folder / "solid.json").read_text())

    assert written()["lod"] is None and "job" in written()["reason"]  # there is none

    def fail(*_: object) -> dict:
        raise ZeroDivisionError("no roof")

    monkeypatch.setattr(solid, "make_solid", fail)
    assert written()["lod"] is None
    assert "ZeroDivisionError: no roof" in capsys.readouterr().err

    def stop(*_: object) -> dict:
        raise Cancelled("enough")

    monkeypatch.setattr(solid, "make_solid", stop)
    with pytest.raises(Cancelled):
        written()


@pytest.mark.parametrize(
    ("log", "said"),
    [
        ("Only 49 points show the ground, and 50 are needed; run again with --no-terrain.\n", ": Only 49 points show"),
        ("Traceback\n  File\nValueError: no\n", "log.txt' says why."),
        (None, "log.txt' says why."),
    ],
)
def test_a_town_without_terrain_says_why(tmp_path: Path, log: str | None, said: str) -> None:
    if log is not None:
        (tmp_path / TERRAIN_LOG).parent.mkdir()
        (tmp_path / TERRAIN_LOG).write_text(log)
    assert said in _reason(tmp_path)
