# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs take finished stages from each other, and pay for them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks.stage_cache import keep, lend, saved, shelf_of
from mgf_engine.config import make_config
from mgf_engine.job import Job


@pytest.fixture
def source(tmp_path: Path) -> Path:
    folder = tmp_path / "scene-sfm-poses"
    folder.mkdir()
    (folder / "points.txt").write_text("1 2 3")
    return folder


def finish(job: Job, *stages: str) -> None:
    """Stand in for the engine: each stage writes a file and is recorded."""
    for stage in stages:
        key = job.begin(stage)
        job.path(stage).mkdir(exist_ok=True)
        job.path(stage, "scene.npz").write_text(stage)
        job.finish(stage, key, 10.0, 15.0, 10**9, {}, [])


def start(folder: Path, source: Path, **options: object) -> Job:
    return Job.start(folder, source, given=options, resume=True)


def test_a_run_takes_what_its_options_leave_unchanged_and_its_cost(tmp_path: Path, source: Path) -> None:
    shelf = shelf_of(tmp_path / "shelves", source, "prompts", "sfm", seed=0)
    assert lend(shelf, tmp_path / "nothing") == {} and not (tmp_path / "nothing").exists()
    with start(tmp_path / "first", source, iterations=5) as job:
        finish(job, "scene", "masks", "field", "mesh")
    keep(tmp_path / "first", shelf)

    lent = lend(shelf, tmp_path / "second")
    with start(tmp_path / "second", source, iterations=7) as job:
        assert job.config == make_config({"iterations": 7})
        assert [job.done(name) for name in ("scene", "masks", "field", "mesh")] == [True, True, False, False]
        assert job.path("scene", "scene.npz").read_text() == "scene"
        finish(job, "field", "mesh")
    assert saved(lent, tmp_path / "second") == {"seconds": 20.0, "cpu_seconds": 30.0, "peak_memory": 1e9}


def test_a_shelf_stays_as_it_was_and_serves_other_seeds(tmp_path: Path, source: Path) -> None:
    shelf = shelf_of(tmp_path / "shelves", source, "prompts", "sfm", seed=0)
    with start(tmp_path / "first", source, smoothing=1, seed=0) as job:
        finish(job, "scene", "masks")
    keep(tmp_path / "first", shelf)
    before = (shelf / "job.json").read_bytes()
    assert json.loads(before)["given"] == {}
    keep(tmp_path / "first", shelf)
    other = shelf_of(tmp_path / "shelves", source, "prompts", "sfm", seed=3)
    assert set(lend(other, tmp_path / "third")) == {"scene", "masks"}
    assert (shelf / "job.json").read_bytes() == before


def test_other_cameras_or_masks_have_a_shelf_of_their_own(tmp_path: Path, source: Path) -> None:
    shelves = {
        shelf_of(tmp_path, source, masks, poses, 0).parent for masks in ("prompts", "true") for poses in ("sfm", "true")
    }
    assert len(shelves) == 4
