# SPDX-License-Identifier: GPL-3.0-or-later
"""``mgf town`` on a full disk, and photos that go away in the middle: one sentence, nothing half written, no retry."""

from __future__ import annotations

import errno
import json
import os
import shutil
import tempfile
from pathlib import Path

import pytest

from benchmarks.full_disk import FullDisk
from benchmarks.synthetic.street import PLACES, Street
from mgf_engine.cli.main import main
from mgf_engine.errors import EXIT_BAD_INPUT, explain
from mgf_engine.files.atomic import write_json
from mgf_engine.geometry.mesh_files import write_ply
from mgf_engine.jobs.job import Job
from mgf_engine.town.result import read_rows
from mgf_engine.town.run import finish
from mgf_engine.town.share import take_scene
from mgf_engine.town.worker import DONE, STATUS, run_building, worth_retrying
from mgf_engine.town.workflow import OptionalProducts


def plan(source: Path, town: Path) -> int:
    map_ = ["--footprints", str(source / "footprints.geojson"), "--footprints-crs", "scene"]
    options = ["--preset", "quick", "--resolution", "120", "--photos-per-building", "6"]
    return main(["town", str(source), "--out", str(town), *map_, *options, "--plan-only"])


@pytest.fixture(scope="module")
def planned(short_street: Street, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Photos that may be deleted, and their town before its jobs."""
    source, town = (tmp_path_factory.mktemp("faults") / name for name in ("street", "town"))
    shutil.copytree(short_street.folder, source)
    assert plan(source, town) == 0
    return source, town


def test_a_disk_full_at_every_file_of_a_plan(
    planned: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source, town = planned[0], tmp_path / "town"
    shutil.copytree(planned[1] / "scene", town / "scene")
    disk, before = FullDisk(town), -1
    while len(disk.failed) > before:
        before = len(disk.failed)
        disk.attempt.clear()
        with disk():
            code = plan(source, town)
        said = capsys.readouterr().err
        assert code == (EXIT_BAD_INPUT if len(disk.failed) > before else 0), said
        assert code == 0 or ("disk" in said.splitlines()[-1] and "Traceback" not in said), said
        assert not list(town.rglob(".part-*"))
    assert before > 12
    for name in ("buildings.json", "buildings.geojson", "buildings/left/prompts.json", "buildings/left/building.json"):
        assert json.loads((town / name).read_text()) == json.loads((planned[1] / name).read_text()), name


def test_a_job_on_a_full_disk_says_so_and_is_not_tried_smaller(
    planned: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    town, make = tmp_path / "town", tempfile.mkstemp
    shutil.copytree(planned[1], town, symlinks=True)
    folder = town / "buildings" / "left"

    def full(*args: object, **more: object) -> object:
        if not (folder / STATUS).exists():
            return make(*args, **more)  # type: ignore[call-overload]
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as context:
        context.setattr(tempfile, "mkstemp", full)
        assert run_building(folder, 1, 1) == EXIT_BAD_INPUT
    status = json.loads((folder / STATUS).read_text())
    assert (
        status["state"] == "failed"
        and status["text"] == f"The disk of '{folder}' is full; free some space and run again."
    )
    assert not worth_retrying(status) and not (folder / DONE).exists()


def test_a_disk_full_at_every_file_that_comes_back(
    planned: tuple[Path, Path], short_street: Street, tmp_path: Path
) -> None:
    town = tmp_path / "town"
    shutil.copytree(planned[1], town, symlinks=True)
    for name in PLACES:
        (town / "buildings" / name / "job").mkdir()
        write_ply(short_street.meshes[name], town / "buildings" / name / "job" / "mesh.ply")
        write_json(town / "buildings" / name / DONE, {"seconds": 1.0, "attempt": 1})
    disk, before = FullDisk(town), -1
    while len(disk.failed) > before:
        before = len(disk.failed)
        disk.attempt.clear()
        try:
            with disk():
                assert finish(town, 0, 1000, True, OptionalProducts(False, False)) == 0
        except OSError as error:
            code, said = explain(error, resumable=False)
            assert code == 2 and said.startswith(f"The disk of '{town}")
            assert said.endswith("' is full; free some space and run again.")
        assert not list(town.rglob(".part-*"))
    assert {"town.gpkg", "town.glb", "town.html", "tiles/left_lod0.glb"} <= {
        path.relative_to(town).as_posix() for path in town.rglob("*") if path.is_file()
    }
    assert any(".part.gpkg" in name for name in disk.failed)


def test_photos_deleted_in_the_middle_are_named(
    planned: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """All but two: fewer than a scene can be made of."""
    source, town = planned
    photos = sorted((source / "images").iterdir())
    for photo in photos[2:]:
        shutil.move(photo, tmp_path)
    folder = town / "buildings" / "right"
    assert run_building(folder, 1, 1) == EXIT_BAD_INPUT
    status = json.loads((folder / STATUS).read_text())
    gone = [name for name in next(row for row in read_rows(town, running=False) if row["id"] == "right")["photos"]
            if not (source / "images" / name).exists()]  # fmt: skip
    assert any(name in status["text"] for name in gone), status
    assert status["state"] == "failed" and not worth_retrying(status)
    assert run_building(folder, 2, 1) == EXIT_BAD_INPUT  # Snakemake's second attempt
    assert json.loads((folder / STATUS).read_text())["attempt"] == 1
    capsys.readouterr()
    assert plan(source, town) == EXIT_BAD_INPUT
    assert photos[2].name in capsys.readouterr().err.splitlines()[-1]
    for photo in photos[2:]:
        shutil.move(tmp_path / photo.name, photo)
    assert plan(source, town) == 0


def test_a_building_does_not_take_the_towns_copy_of_a_photo_that_is_gone(planned: tuple[Path, Path]) -> None:
    """Its own scene stage leaves the photo out and says so."""
    source, town = planned
    photo = source / "images" / next(row for row in read_rows(town, running=False) if row["id"] == "left")["photos"][0]
    folder, kept = town / "buildings" / "left", photo.read_bytes()
    photo.unlink()
    with Job.start(folder / "taken", folder / "scene", None, user_options={"resolution": 120}) as job:
        assert not take_scene(job, town / "scene" / "scene")
    photo.write_bytes(kept)
    with Job.start(folder / "taken", folder / "scene", None, user_options={"resolution": 120}) as job:
        assert take_scene(job, town / "scene" / "scene")
