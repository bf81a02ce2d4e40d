# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs take finished stages from each other, and pay for them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks.stage_cache import cache_entry, restore_stages, saved_cost, store_stages
from mgf_engine.jobs.job import Job
from mgf_engine.options.config import make_config


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
    return Job.start(folder, source, user_options=options, resume=True)


def test_a_run_takes_what_its_options_leave_unchanged_and_its_cost(tmp_path: Path, source: Path) -> None:
    entry = cache_entry(tmp_path / "stage_cache", source, "prompts", "sfm", seed=0)
    assert restore_stages(entry, tmp_path / "nothing") == {} and not (tmp_path / "nothing").exists()
    with start(tmp_path / "first", source, iterations=5) as job:
        finish(job, "scene", "masks", "field", "mesh")
    store_stages(tmp_path / "first", entry)

    restored = restore_stages(entry, tmp_path / "second")
    with start(tmp_path / "second", source, iterations=7) as job:
        assert job.config == make_config({"iterations": 7})
        assert [job.done(name) for name in ("scene", "masks", "field", "mesh")] == [True, True, False, False]
        assert job.path("scene", "scene.npz").read_text() == "scene"
        finish(job, "field", "mesh")
    assert saved_cost(restored, tmp_path / "second") == {"seconds": 20.0, "cpu_seconds": 30.0, "peak_memory": 1e9}


def test_an_entry_stays_as_it_was_and_serves_other_seeds(tmp_path: Path, source: Path) -> None:
    entry = cache_entry(tmp_path / "stage_cache", source, "prompts", "sfm", seed=0)
    with start(tmp_path / "first", source, smoothing=1, seed=0) as job:
        finish(job, "scene", "masks")
    store_stages(tmp_path / "first", entry)
    before = (entry / "job.json").read_bytes()
    assert json.loads(before)["given"] == {}
    store_stages(tmp_path / "first", entry)
    other = cache_entry(tmp_path / "stage_cache", source, "prompts", "sfm", seed=3)
    assert set(restore_stages(other, tmp_path / "third")) == {"scene", "masks"}
    assert (entry / "job.json").read_bytes() == before


def test_other_cameras_or_masks_have_an_entry_of_their_own(tmp_path: Path, source: Path) -> None:
    cache = {
        cache_entry(tmp_path, source, masks, poses, 0).parent
        for masks in ("prompts", "true")
        for poses in ("sfm", "true")
    }
    assert len(cache) == 4
