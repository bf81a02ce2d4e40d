# SPDX-License-Identifier: GPL-3.0-or-later
"""Footprints out of every kind of map, and where they lie in a scene."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyogrio
import pytest
import shapely
from support.survey_site import CRS, ORIGIN, Site, make_site, write_gps

from benchmarks.synthetic.street import write_footprints
from mgf_engine.cli.main import main
from mgf_engine.errors import BadInput
from mgf_engine.georef.crs import ProjectedCrs
from mgf_engine.options.config import make_config
from mgf_engine.town import plan
from mgf_engine.town.footprints import plain_id, read_footprints
from mgf_engine.town.place import place_footprints, transformed

SQUARE = shapely.box(*(ORIGIN[:2] - (5, 4)), *(ORIGIN[:2] + np.array([5, 4])))
PAIR = np.array([SQUARE, shapely.MultiPolygon([shapely.box(0, 0, 3, 3), shapely.box(5, 0, 7, 3)])], object)


@pytest.mark.parametrize(
    ("name", "folder"),
    [
        ("A 12/3 ä", "A_12_3"), ("..hidden.", "hidden"), ("ä", ""), ("con", "_con"), ("Lpt1.old", "_Lpt1.old"),
        ("COM10", "COM10"), ("x" * 59 + ". y", "x" * 59),
    ],
)  # fmt: skip
def test_names_are_those_of_folders_on_every_system(name: str, folder: str) -> None:
    assert plain_id(name) == folder


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Site:
    made = make_site(tmp_path_factory.mktemp("site"))
    write_gps(made)
    return made


def write(path: Path, polygons: np.ndarray, names: list[str], crs: str | None = CRS) -> Path:
    pyogrio.raw.write(
        path, shapely.to_wkb(polygons), [np.array(names, object)], ["id"], crs=crs, geometry_type="MultiPolygon"
        if path.suffix == ".shp" else "Unknown", promote_to_multi=path.suffix == ".shp",
    )  # fmt: skip
    return path


@pytest.mark.parametrize("kind", ["gpkg", "shp", "geojson"])
def test_maps_of_every_kind_say_the_same(kind: str, tmp_path: Path) -> None:
    polygons = PAIR if kind != "geojson" else transformed(PAIR[:1], CRS, "EPSG:4326")
    crs = CRS if kind != "geojson" else "EPSG:4326"
    names = ["Rathaus/2", "b"][: len(polygons)]
    found = read_footprints(write(tmp_path / f"map.{kind}", polygons, names, crs))
    assert found.ids == ("Rathaus_2", "b")[: len(polygons)]
    assert found.crs == crs
    assert [p.area for p in found.polygons] == pytest.approx([p.area for p in polygons], rel=1e-6)


def test_names_that_differ_in_case_alone_get_folders_of_their_own(tmp_path: Path) -> None:
    found = read_footprints(write(tmp_path / "map.gpkg", np.concatenate([PAIR, PAIR[:1]]), ["House", "house", "HOUSE"]))
    assert found.ids == ("House", "house_2", "HOUSE_3")


@pytest.mark.parametrize("column", [np.array([np.nan, 12.0]), np.array([None, "12 "], object)])
def test_a_building_without_a_name_has_the_number_of_its_entry(column: np.ndarray, tmp_path: Path) -> None:
    pyogrio.raw.write(
        tmp_path / "map.gpkg", shapely.to_wkb(PAIR), [column], ["id"], crs=CRS, geometry_type="Unknown"
    )  # fmt: skip
    assert read_footprints(tmp_path / "map.gpkg").ids == ("1", "12")


def test_geojson_that_names_no_system_has_none(tmp_path: Path) -> None:
    write_footprints(tmp_path / "map.geojson", {"a": (0.0, 0.0)})
    assert read_footprints(tmp_path / "map.geojson").crs is None


def test_cityjson_gives_the_ground_of_buildings(tmp_path: Path) -> None:
    ground = [[0, 0, 0], [100, 0, 0], [100, 80, 0], [0, 80, 0]]
    roof = [[-5, -5, 30], [105, -5, 30], [105, 85, 30], [-5, 85, 30]]  # with eaves
    wall = [[0, 0, 0], [100, 0, 0], [100, 0, 30], [0, 0, 30]]
    surfaces = {"surfaces": [{"type": "GroundSurface"}, {"type": "RoofSurface"}, {"type": "WallSurface"}]}
    solid = {"type": "Solid", "lod": "2", "boundaries": [[[[3, 2, 1, 0]], [[4, 5, 6, 7]], [[8, 9, 10, 11]]]],
             "semantics": {**surfaces, "values": [[0, 1, 2]]}}  # fmt: skip
    data = {
        "type": "CityJSON", "version": "2.0", "vertices": ground + roof + wall,
        "transform": {"scale": [0.1, 0.1, 0.1], "translate": ORIGIN.tolist()},
        "metadata": {"referenceSystem": "https://www.opengis.net/def/crs/EPSG/0/25832"},
        "CityObjects": {
            "house": {"type": "Building", "children": ["part"]},
            "part": {"type": "BuildingPart", "parents": ["house"], "geometry": [solid]},
            "oak": {"type": "SolitaryVegetationObject", "geometry": [solid]},
        },
    }  # fmt: skip
    path = tmp_path / "town.city.json"
    path.write_text(json.dumps(data))
    found = read_footprints(path)
    assert (found.ids, found.crs) == (("house",), CRS)
    assert found.polygons[0].equals(shapely.box(*ORIGIN[:2], *(ORIGIN[:2] + np.array([10, 8]))))
    solid["semantics"] = None  # nothing tells which is the ground
    path.write_text(json.dumps(data))
    eaves = 0.5
    assert (
        read_footprints(path)
        .polygons[0]
        .equals(shapely.box(*(ORIGIN[:2] - eaves), *(ORIGIN[:2] + np.array([10, 8]) + eaves)))
    )
    data["CityObjects"]["part"]["geometry"][0]["boundaries"][0][0] = [[99, 1, 2]]
    path.write_text(json.dumps(data))
    with pytest.raises(BadInput, match="damaged CityJSON"):
        read_footprints(path)


def test_files_that_are_no_map_are_refused(tmp_path: Path) -> None:
    for name, content, match in (("a.geojson", "{", "cannot be read"), ("a.json", "[1]", "neither GeoJSON"),
                                 ("a.gpkg", "nothing", "cannot be read"), ("a.shp", "", "cannot be read")):  # fmt: skip
        (tmp_path / name).write_text(content)
        with pytest.raises(BadInput, match=match):
            read_footprints(tmp_path / name)
    with pytest.raises(BadInput, match=r"has no layer 'roofs' \(it has map\)"):
        read_footprints(write(tmp_path / "map.gpkg", PAIR[:1], ["a"]), "roofs")
    assert read_footprints(tmp_path / "map.gpkg", "map").ids == ("a",)
    with pytest.raises(BadInput, match="There are no footprints"):
        read_footprints(tmp_path / "none.gpkg")
    with pytest.raises(BadInput, match="no areas"):
        read_footprints(write(tmp_path / "line.gpkg", np.array([shapely.LineString([(0, 0), (1, 1)])]), ["a"]))


@pytest.mark.parametrize("crs", [CRS, "EPSG:2056", "EPSG:4326", "EPSG:3857"])
def test_footprints_lie_on_the_house_whatever_their_system(crs: str, site: Site, tmp_path: Path) -> None:
    polygons = PAIR[:1] if crs == CRS else transformed(PAIR[:1], CRS, crs)
    found = read_footprints(write(tmp_path / "map.gpkg", polygons, ["house"], crs))
    placed = place_footprints(found, site.scene, make_config())
    if crs == "EPSG:2056":  # an oblique Mercator projection, true to length
        assert placed.georeference.crs == crs
        return
    corner = np.array([*shapely.get_coordinates(placed.polygons[0]).min(0) + placed.georeference.offset[:2], 519.0])
    true = np.array([*(ORIGIN[:2] - (5, 4)), 519.0])
    if crs == CRS:
        assert placed.georeference.crs == CRS and np.abs(corner - true).max() < 0.05
    else:  # in the UTM zone of the photos
        assert placed.georeference.crs == "EPSG:32632"
        there = ProjectedCrs("EPSG:32632").project(ProjectedCrs(CRS).places(true[None]))[0]
        assert np.abs(corner - there)[:2].max() < 0.05


@pytest.mark.parametrize(("said", "match"), [("EPSG:25833", "read as EPSG:25832"), ("EPSG:4326", "read as EPSG:32632")])
def test_a_wrong_system_is_refused_with_the_right_one(said: str, match: str, site: Site, tmp_path: Path) -> None:
    found = read_footprints(write(tmp_path / "map.gpkg", PAIR[:1], ["house"], said))
    with pytest.raises(BadInput, match=match):
        place_footprints(found, site.scene, make_config())


def test_point_pairs_place_footprints_without_gps(site: Site, tmp_path: Path) -> None:
    found = read_footprints(write(tmp_path / "map.gpkg", PAIR[:1], ["house"]))
    with pytest.raises(BadInput, match="--pairs FILE"):
        place_footprints(found, site.scene, make_config({"gps": "off"}))
    world = ORIGIN + np.array([(-5, -4, 0.0), (5, -4, 0.5), (5, 4, 3.0), (-5, 4, 6.0)])
    scene = site.scene.to_normalised.invert(site.normalised(world))
    pairs = tmp_path / "pairs.csv"
    rows = [",".join(f"{v:.6f}" for v in (*w, *s)) for w, s in zip(world, scene, strict=True)]
    pairs.write_text("east,north,height,x,y,z\n" + "\n".join(rows))
    placed = place_footprints(found, site.scene, make_config({"gps": "off"}), pairs=pairs)
    corner = shapely.get_coordinates(placed.polygons[0]).min(0) + placed.georeference.offset[:2]
    assert np.abs(corner - (ORIGIN[:2] - (5, 4))).max() < 1e-3
    assert np.abs(placed.georeference.world(scene) - world).max() < 1e-4
    pairs.write_text("east,north,height,x,y,z\n" + "\n".join(rows[:2]))
    with pytest.raises(BadInput, match="do not lie on a line"):
        place_footprints(found, site.scene, make_config({"gps": "off"}), pairs=pairs)


def test_a_map_in_the_wrong_system_is_refused_before_anything_is_written(
    site: Site, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(plan, "shared_scene", lambda *_: (None, site.scene))
    map_ = write(tmp_path / "map.gpkg", PAIR[:1], ["house"], "EPSG:25833")
    out = tmp_path / "town"
    assert main(["buildings", str(site.folder), "--footprints", str(map_), "--out", str(out), "--preset", "quick"]) == 2
    said = capsys.readouterr().err.splitlines()[-1]
    assert "None of the 1 footprints lies near the photos" in said and "read as EPSG:25832" in said
    assert not out.exists()
