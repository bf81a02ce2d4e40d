# SPDX-License-Identifier: GPL-3.0-or-later
"""What comes back of a town: rows from its records, heights and volumes from meshes, and the table as a GeoPackage."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyogrio
import pytest
import shapely

from mgf_engine.georef.model import Georeference
from mgf_engine.model.mesh import Mesh
from mgf_engine.town.result import measure, read_rows, write_table
from mgf_engine.town.worker import FAILED, FINISHED, RUNNING, STOPPED, WAITING, read_record


def town(folder: Path, **records: dict[str, Any]) -> Path:
    """A planned town whose buildings have a status and done records."""
    rows = [{"id": name, "state": "ready", "reason": "", "photos": ["a.jpg"], "area": 20.0} for name in records]
    (folder / "buildings.json").write_text(json.dumps({"format": 1, "buildings": rows, "metre": 1.0}))
    features = []
    for k, name in enumerate(records):
        (folder / "buildings" / name).mkdir(parents=True)
        for file, content in records[name].items():
            (folder / "buildings" / name / f"{file}.json").write_text(json.dumps(content))
        geometry = json.loads(shapely.to_geojson(shapely.box(8 * k, 0, 8 * k + 5, 4)))
        features.append({"type": "Feature", "properties": {"id": name}, "geometry": geometry})
    (folder / "buildings.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    return folder


def test_a_row_says_what_became_of_a_job(tmp_path: Path) -> None:
    place = town(
        tmp_path, new={}, killed={"status": {"state": RUNNING}}, stopped={"status": {"state": STOPPED}},
        old={"status": {"state": FINISHED}}, whole={"status": {"state": FINISHED}, "done": {"confidence": 0.5}},
    )  # fmt: skip
    jobs = {row["id"]: row["job"] for row in read_rows(place, running=False)}
    assert jobs == {"new": WAITING, "killed": FAILED, "stopped": STOPPED, "old": WAITING, "whole": FINISHED}
    assert {row["id"]: row["job"] for row in read_rows(place, running=True)}["killed"] == RUNNING


@pytest.mark.parametrize("content", ["5", "[1, 2]", "null", "{", '"text"', "[" * 100_000])
def test_a_damaged_record_is_none(content: str, tmp_path: Path) -> None:
    (tmp_path / "done.json").write_text(content)
    assert read_record(tmp_path / "done.json") == {}


def test_height_and_volume_are_those_over_the_ground() -> None:
    x, y = np.meshgrid(np.arange(0, 5.01, 0.1), np.arange(0, 4.01, 0.1))
    roof = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 106.0)])
    ground = roof * (1, 1, 0) + (0, 0, 100)
    mesh = Mesh(np.concatenate([ground, roof]), np.zeros((0, 3), np.int32), np.zeros((2 * x.size, 3), np.uint8))
    assert measure(mesh, {"ground": 100.0, "area": 20.0}, 1.0) == {"height": 6.0, "volume": 120.0}
    roof[:, 2] += np.where(roof[:, 0] < 2.5, 2.0, 0.0)  # half of it is higher
    higher = Mesh(np.concatenate([ground, roof]), mesh.faces, mesh.colors)
    found = measure(higher, {"ground": 100.0, "area": 20.0}, 1.0)
    assert found["height"] == 8.0 and found["volume"] == pytest.approx(20 * 7, rel=0.03)
    half = Mesh(mesh.vertices * 0.5, mesh.faces, mesh.colors)
    assert measure(half, {"ground": 50.0, "area": 20.0}, 0.5) == {"height": 6.0, "volume": 120.0}


def test_a_confidence_of_none_at_all_is_no_missing_one(tmp_path: Path) -> None:
    place = town(tmp_path, doubtful={"done": {"confidence": 0.0}}, unknown={"done": {"confidence": None}}, new={})
    write_table(tmp_path / "town.gpkg", place, read_rows(place, running=False), Georeference(crs="EPSG:25832"))
    meta, _, shapes, columns = pyogrio.raw.read(tmp_path / "town.gpkg")
    found = dict(zip(meta["fields"], columns, strict=True))
    assert found["confidence"][0] == 0.0 and np.isnan(found["confidence"][1:]).all()
    assert list(found["id"]) == ["doubtful", "unknown", "new"] and meta["crs"] == "EPSG:25832"
    assert shapely.area(shapely.from_wkb(shapes)) == pytest.approx(20.0)
