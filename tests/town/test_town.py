# SPDX-License-Identifier: GPL-3.0-or-later
"""``mgf town`` on two small houses: killed in the middle, taken up again, and put together."""

from __future__ import annotations

import contextlib
import json
import os
import signal
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

from benchmarks.synthetic.street import PLACES, Street
from mgf_engine.cli.main import main
from mgf_engine.geometry.mesh_files import read_ply
from mgf_engine.georef.model import read_georeference
from mgf_engine.town import run as town_run
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
def street(short_street: Street) -> Street:
    return short_street


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
    assert set(scene.geometry) == {*PLACES, "terrain"}
    houses = np.concatenate([scene.geometry[name].vertices for name in PLACES])
    assert abs(np.ptp(houses[:, 1]) - 3.2) < 0.3  # y is up
    check_terrain(town, street)
    check_solids(town)
    tileset = json.loads((town / "tiles" / "tileset.json").read_text())
    assert len(tileset["root"]["children"]) == 3 and (town / "tiles" / "terrain.glb").is_file()
    for tile in tileset["root"]["children"][:2]:
        assert tile["geometricError"] > tile["children"][0]["geometricError"] == 0
        assert all((town / "tiles" / t["content"]["uri"]).is_file() for t in (tile, tile["children"][0]))
    meta, _, shapes, columns = pyogrio.raw.read(town / "town.gpkg", layer="buildings")
    table = dict(zip(meta["fields"], columns, strict=True))
    assert list(table["job"]) == ["done", "done", ""] and len(shapes) == 3
    assert np.isfinite(table["volume"][:2].astype(float)).all() and np.isnan(float(table["volume"][2]))


def check_terrain(town: Path, street: Street) -> None:
    """Level ground at the height of the street, in the colours of the photos, and coarse houses on it."""
    ground = read_ply(town / "terrain" / "terrain.ply")
    assert len(ground.faces) > 50 and (town / "terrain" / "texture.jpg").is_file()
    bottom = min(mesh.vertices[:, 2].min() for mesh in street.meshes.values())
    local = read_georeference(town).scene(ground.vertices)[:, 2]
    assert np.abs(local - bottom).max() < 0.25
    for name in PLACES:
        light, full = (read_ply(town / "buildings" / name / file) for file in ("light.ply", "job/mesh.ply"))
        assert len(light.faces) < 0.5 * len(full.faces)
        assert np.ptp(light.vertices[:, 2]) == pytest.approx(3.2, abs=0.4)


def check_solids(town: Path) -> None:
    """Each building has a solid or a reason, and the file of all has those that are there."""
    solids = {name: json.loads((town / "buildings" / name / "solid.json").read_text()) for name in PLACES}
    found = {name for name, solid in solids.items() if solid["lod"] is not None}
    assert all(solid["lod"] or solid["reason"] for solid in solids.values())
    assert found and set(json.loads((town / "town.city.json").read_text())["CityObjects"]) == found


def test_a_town_that_is_done_is_not_made_again(street: Street, killed: tuple[Path, list[Path]]) -> None:
    town, _ = killed
    files = [
        town / "buildings" / name / file for name in PLACES for file in ("job/job.json", "solid.json", "light.ply")
    ]
    files.append(town / "terrain" / "terrain.ply")
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


def test_a_worker_that_is_killed_is_tried_again_with_smaller_photos(
    street: Street, killed: tuple[Path, list[Path]]
) -> None:
    folder = killed[0] / "buildings" / "left"
    (folder / "prompts.json").unlink(missing_ok=True)  # automatic clicks again
    run = subprocess.Popen([sys.executable, "-m", "mgf_engine", *arguments(street, killed[0])])
    until = time.monotonic() + 120
    status: dict = {}
    while status.get("stage") not in ("masks", "field") or status["state"] != "running":
        assert run.poll() is None and time.monotonic() < until
        time.sleep(0.05)
        with contextlib.suppress(OSError, ValueError):
            status = json.loads((folder / "status.json").read_text())
    os.kill(status["pid"], signal.SIGKILL)
    assert run.wait(200) == 0
    done = json.loads((folder / "done.json").read_text())
    assert (
        done["attempt"] == 2
        and done["resolution"] < json.loads((folder.parent / "right/done.json").read_text())["resolution"]
    )
    words = (folder / "worker.txt").read_text()
    assert words.index("Attempt 1: ") < words.index("Attempt 2: ")  # what the first one said is not lost


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


def test_ctrl_c_is_answered_before_the_jobs_have_stopped(tmp_path: Path, capsys) -> None:
    """They save what they did first, which takes half a minute on a busy machine."""

    class Snakemake:
        def poll(self) -> None:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        town_run._watch(tmp_path, Snakemake())  # type: ignore[arg-type]
    assert capsys.readouterr().err == "Stopping; the jobs at work save what they did.\n"
