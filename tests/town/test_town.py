# SPDX-License-Identifier: GPL-3.0-or-later
"""``mgf town`` on two small houses: killed in the middle, taken up again, and put together."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import igl
import numpy as np
import pyogrio
import pytest
import trimesh
from filelock import FileLock

from benchmarks.synthetic.street import PLACES, Street, build_street
from mgf_engine.cli import main
from mgf_engine.geometry.mesh_files import read_ply
from mgf_engine.town.worker import options_of, worth_retrying

OPTIONS = [
    "--footprints-crs",
    "scene",
    "--preset",
    "quick",
    "--no-texture",
    "--photos-per-building",
    "12",
    "--tiles",
    "--cores",
    "1",
]


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Street:
    return build_street(tmp_path_factory.mktemp("street"), 16)


def arguments(street: Street, town: Path) -> list[str]:
    map_ = str(street.folder / "footprints.geojson")
    return ["town", str(street.folder), "--footprints", map_, "--out", str(town), *OPTIONS]


@pytest.fixture(scope="module")
def killed(street: Street, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Path]]:
    """A town that was killed after its first building, and what was done by then."""
    town = tmp_path_factory.mktemp("out") / "town"
    command = [sys.executable, "-m", "mgf_engine", *arguments(street, town)]
    run = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, env={**os.environ})
    deadline = time.monotonic() + 300
    done: list[Path] = []
    while not done and run.poll() is None and time.monotonic() < deadline:
        time.sleep(0.1)
        done = list(town.glob("buildings/*/done.json"))
    run.kill()
    run.wait()
    assert len(done) == 1
    return town, done


def test_a_town_goes_on_after_a_kill_and_comes_back_whole(
    street: Street, killed: tuple[Path, list[Path]], capsys: pytest.CaptureFixture[str]
) -> None:
    town, done = killed
    record = done[0].parent / "job" / "job.json"  # which every start of the job writes
    before = record.stat().st_mtime_ns
    assert main(arguments(street, town)) == 0
    assert "2 of 2 buildings are done" in capsys.readouterr().out
    assert record.stat().st_mtime_ns == before  # not made again
    for name, truth in street.meshes.items():
        mesh = read_ply(town / "buildings" / name / "job" / "mesh.ply")
        off = np.sqrt(igl.point_mesh_squared_distance(mesh.vertices, truth.vertices, truth.faces.astype(np.int64))[0])
        assert np.median(off) < 0.05 and np.percentile(off, 90) < 0.2, name
        pictures = list((town / "buildings" / name / "job" / "scene" / "images").iterdir())
        shared = {path.stat().st_ino for path in (town / "scene" / "scene" / "images").iterdir()}
        assert pictures and {path.stat().st_ino for path in pictures} <= shared  # made once for the whole town
    page = (town / "town.html").read_text()
    assert all(f'id="{name}"' in page for name in (*PLACES, "gone")) and page.count("data:image/jpeg") == 2
    scene = trimesh.load(town / "town.glb")
    assert set(scene.geometry) == set(PLACES)
    assert abs(scene.extents[1] - 3.2) < 0.3  # y is up
    tileset = json.loads((town / "tiles" / "tileset.json").read_text())
    assert len(tileset["root"]["children"]) == 2
    for tile in tileset["root"]["children"]:
        assert tile["geometricError"] > tile["children"][0]["geometricError"] == 0
        assert all((town / "tiles" / t["content"]["uri"]).is_file() for t in (tile, tile["children"][0]))
    meta, _, shapes, columns = pyogrio.raw.read(town / "town.gpkg", layer="buildings")
    table = dict(zip(meta["fields"], columns, strict=True))
    assert list(table["job"]) == ["done", "done", ""] and len(shapes) == 3
    assert np.isfinite(table["volume"][:2].astype(float)).all() and np.isnan(float(table["volume"][2]))


def test_a_town_that_is_done_is_not_made_again(street: Street, killed: tuple[Path, list[Path]]) -> None:
    town, _ = killed
    files = [town / "buildings" / name / "job" / "job.json" for name in PLACES]
    before = [file.stat().st_mtime_ns for file in files]
    assert main(arguments(street, town)) == 0
    assert [file.stat().st_mtime_ns for file in files] == before


def test_one_building_that_fails_leaves_the_others(
    street: Street, killed: tuple[Path, list[Path]], capsys: pytest.CaptureFixture[str]
) -> None:
    town, _ = killed
    clicks = town / "buildings" / "left" / "prompts.json"
    clicks.write_text(json.dumps({"photo_00.png": {"positive": [[5000, 5000]]}}))  # by hand, and wrong
    assert main(arguments(street, town)) == 2
    said = capsys.readouterr()
    assert "1 of 2 buildings are done" in said.out and "first: left" in said.err
    page = (town / "town.html").read_text()
    assert "outside the photo" in page


def test_two_towns_in_one_folder_are_refused(
    street: Street, killed: tuple[Path, list[Path]], capsys: pytest.CaptureFixture[str]
) -> None:
    with FileLock(str(killed[0].resolve() / ".lock")):
        assert main(arguments(street, killed[0])) == 2
    assert "Another mgf town works in" in capsys.readouterr().err


def test_a_second_attempt_is_smaller_and_only_made_where_it_may_help() -> None:
    row = {"options": {"preset": "quick", "resolution": 500}}
    assert options_of(row, 1, 2)["resolution"] == 500 and options_of(row, 2, 2)["resolution"] == 350
    assert options_of(row, 2, 1)["texture_size"] == 2048 and options_of(row, 1, 1)["texture_size"] == 4096
    assert worth_retrying({})  # killed before it could say anything
    assert worth_retrying({"state": "running", "code": None}) and worth_retrying({"code": 1, "text": "Fault"})
    assert worth_retrying({"code": 2, "text": "Out of memory; lower --resolution."})
    assert not worth_retrying({"code": 2, "text": "No photo got a usable mask."})
    assert not worth_retrying({"code": 3, "text": "Cancelled"})
