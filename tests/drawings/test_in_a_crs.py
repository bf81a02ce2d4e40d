# SPDX-License-Identifier: GPL-3.0-or-later
"""Drawings of a job with true coordinates: north, metres and the place in the world, read by rasterio and ezdxf."""

from __future__ import annotations

import csv
import json
import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as Xml

import ezdxf
import numpy as np
import pytest
import rasterio
from support.finished_job import WINDOWS, FinishedJob

from benchmarks.synthetic.house import OFFSET
from mgf_engine.drawings.make import make_drawings
from mgf_engine.drawings.work import DrawingOptions
from mgf_engine.georef.model import METRE, Georeference, write_georeference
from mgf_engine.messages import Reporter

ORIGIN, SCALE, TURN = np.array([691_234.0, 5_334_876.0, 519.0]), 2.5, 30.0  # degrees anticlockwise


def true_matrix() -> np.ndarray:
    """The house's model frame -> local frame, [4, 4]: turned, grown, its middle at the local origin."""
    angle, matrix = np.radians(TURN), np.eye(4)
    matrix[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    matrix[:3, :3] *= SCALE
    matrix[:3, 3] = -matrix[:3, :3] @ OFFSET
    return matrix


def world(points: np.ndarray) -> np.ndarray:
    """Metres of the house's own frame, in which it stands at the origin -> easting, northing, height."""
    matrix = true_matrix()
    return (points + OFFSET) @ matrix[:3, :3].T + matrix[:3, 3] + ORIGIN


@pytest.fixture(scope="module")
def placed(finished: FinishedJob, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The drawings of the same job with a georeference."""
    georeference = Georeference(
        true_matrix(), tuple(ORIGIN.tolist()), "EPSG:25832", METRE, True, True, "control"
    )  # fmt: skip
    write_georeference(georeference, finished.folder)
    try:
        kinds = frozenset({"orthophotos", "elevations", "sections", "quantities"})
        out = tmp_path_factory.mktemp("placed") / "drawings"
        return make_drawings(finished.folder, out, replace(DrawingOptions(), kinds=kinds), Reporter())
    finally:
        (finished.folder / "georef.json").unlink()


def test_facades_have_the_names_of_the_compass(placed: Path) -> None:
    """The house's sides face south, east, north and west turned by 30 degrees anticlockwise."""
    index = json.loads((placed / "drawings.json").read_text(encoding="utf-8"))
    directions = {f["name"]: f["direction"] for f in index["facades"]}
    assert index["unit"] == "metre" and index["crs"] == "EPSG:25832"
    assert directions == pytest.approx(
        {"north-west": 330, "north-east": 60, "south-east": 150, "south-west": 240}, abs=0.1
    )
    assert {f["name"]: f["width"] for f in index["facades"]}["south-east"] == pytest.approx(4 * SCALE, abs=0.01)


def test_the_plan_lies_in_the_crs_with_north_up(placed: Path) -> None:
    for name in ("orthophoto-plan.tif", "heights-plan.tif"):
        with rasterio.open(placed / name) as file:
            assert file.crs.to_epsg() == 25832
            assert (file.transform.b, file.transform.d) == (0, 0) and file.transform.e < 0 < file.transform.a
            low, high = np.array(file.bounds[:2]), np.array(file.bounds[2:])
            shown = file.dataset_mask() > 0 if name[0] == "o" else np.isfinite(file.read(1))
            rows, columns = np.nonzero(shown)
            east, north = file.transform @ (columns + 0.5, rows + 0.5)
            pixel = file.transform.a
        corners = world(np.array([[x, y, 0.0] for x in (-2, 2) for y in (-1.5, 1.5)]))[:, :2]
        assert (low <= corners.min(0)).all() and (high >= corners.max(0)).all()
        assert (np.abs(low - corners.min(0)) < 20 * pixel).all() and (np.abs(high - corners.max(0)) < 20 * pixel).all()
        own = np.stack([east, north, np.full(len(east), ORIGIN[2])], 1) - ORIGIN
        own = own @ np.linalg.inv(true_matrix()[:3, :3]).T
        slack = 1.5 * pixel / SCALE
        assert (np.abs(own[:, 0]) < 2 + slack).all() and (np.abs(own[:, 1]) < 1.5 + slack).all()
        assert len(rows) * pixel**2 == pytest.approx(4 * 3 * SCALE**2, rel=0.03)


def test_browsers_can_show_the_roof(placed: Path) -> None:
    """They keep float32, and the description of the file leads to the CRS."""
    root = Xml.parse(placed / "roof.svg").getroot()
    numbers = [t for p in root.iterfind(".//{*}path") for t in p.get("d").split() if t not in "MLZ"]
    at = np.array(numbers, np.float64).reshape(-1, 2)
    assert np.abs(at.astype(np.float32) - at).max() < 1e-5
    east, north = re.search(r"east = x \+ ([\d.]+), north = ([\d.]+) - y", root.find("{*}desc").text).groups()
    points = np.array([float(east), float(north)]) + at * (1, -1)
    for end in world(np.array([[-2, 0, 3.2], [2, 0, 3.2]]))[:, :2]:
        assert np.linalg.norm(points - end, axis=1).min() < 0.1


def test_heights_are_those_of_the_crs(placed: Path) -> None:
    with rasterio.open(placed / "heights-plan.tif") as file:
        heights = file.read(1)
    assert np.nanmax(heights) == pytest.approx(ORIGIN[2] + 3.2 * SCALE, abs=0.1)
    with rasterio.open(placed / "orthophoto-south-east.tif") as file:
        assert file.bounds.bottom == pytest.approx(ORIGIN[2], abs=0.2)
        assert file.bounds.top == pytest.approx(ORIGIN[2] + 3.2 * SCALE, abs=0.2)


def test_the_tags_of_a_facade_say_where_a_window_is_in_the_world(placed: Path) -> None:
    """The middle of a window, found in the picture, through the file's own tags."""
    with rasterio.open(placed / "orthophoto-south-east.tif") as file:
        tags, place, image = file.tags(), file.transform, file.read().astype(float)
        assert file.crs is None or not file.crs.is_epsg_code
    vectors = {name: np.array(tags[name].split(), float) for name in ("ORIGIN", "X_AXIS", "Y_AXIS", "NORMAL")}
    assert tags["CRS"] == "EPSG:25832" and tags["UNIT"] == "metre"
    assert vectors["Y_AXIS"] == pytest.approx([0, 0, 1], abs=1e-6)
    assert vectors["NORMAL"] == pytest.approx([np.sin(np.radians(150)), np.cos(np.radians(150)), 0], abs=2e-3)
    dark = (image[:3].mean(0) < 80) & (image[3] > 0)
    for left, right, bottom, top in WINDOWS:
        middle = world(np.array([(left + right) / 2, -1.5, (bottom + top) / 2])) - vectors["ORIGIN"]
        at = ~place @ (middle @ vectors["X_AXIS"], middle @ vectors["Y_AXIS"])
        reach = 0.6 * SCALE / place.a
        near = np.zeros(dark.shape, bool)
        beside = slice(int(at[1] - reach), int(at[1] + reach)), slice(int(at[0] - reach), int(at[0] + reach))
        near[beside] = dark[beside]
        rows, columns = np.nonzero(near)
        assert (columns.mean() + 0.5, rows.mean() + 0.5) == pytest.approx(at, abs=1.0)


def test_lines_are_metres_in_the_crs(placed: Path) -> None:
    document = ezdxf.readfile(placed / "roof.dxf")
    assert document.header["$INSUNITS"] == 6
    points = np.concatenate([np.array(line.get_points("xy")) for line in document.modelspace().query("LWPOLYLINE")])
    ridge = world(np.array([[-2, 0, 3.2], [2, 0, 3.2]]))[:, :2]
    for end in ridge:
        assert np.linalg.norm(points - end, axis=1).min() < 0.1
    rows = {(r["of"], r["quantity"]): r for r in csv.DictReader((placed / "quantities.csv").open(encoding="utf-8"))}
    area = rows["south-east", "area of all walls facing it"]
    assert float(area["value"]) == pytest.approx(8 * SCALE**2, rel=0.01) and area["unit"] == "m2"
