# SPDX-License-Identifier: GPL-3.0-or-later
"""What a job does again after a change of options, and what it keeps of stages begun before."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from mgf_engine.geometry.block_store import BlockStore
from mgf_engine.jobs.job import Job
from mgf_engine.stages import STAGE_NAMES
from mgf_engine.system import memory
from tests.support.jobs import finish_all


def test_a_finished_job_is_done_after_reopening(tmp_path: Path, source: Path) -> None:
    with Job.start(tmp_path / "job", source) as job:
        assert not any(job.done(stage) for stage in STAGE_NAMES)
        finish_all(job)
    with Job.start(tmp_path / "job", resume=True) as job:
        assert all(job.done(stage) for stage in STAGE_NAMES)


@pytest.mark.parametrize(
    ("options", "first_redone"),
    [({"resolution": 100}, "scene"), ({"vote_dilation": 1}, "masks"), ({"boundary_loss": True}, "masks"),
     ({"seed": 5}, "field"), ({"holdout_every": 0}, "field"), ({"level_steps": 3}, "mesh"),
     ({"render_all": True}, "deliver")],
)  # fmt: skip
def test_a_changed_option_redoes_its_stage_and_the_later_ones(tmp_path, source, options, first_redone) -> None:
    with Job.start(tmp_path / "job", source) as job:
        finish_all(job)
    with Job.start(tmp_path / "job", source, user_options=options, resume=True) as job:
        assert [s for s in STAGE_NAMES if not job.done(s)] == list(STAGE_NAMES[STAGE_NAMES.index(first_redone) :])


def test_options_given_once_stay_for_the_resumed_job(tmp_path: Path, source: Path) -> None:
    Job.start(tmp_path / "job", source, user_options={"iterations": 11}).close()
    with Job.start(tmp_path / "job", source, user_options={"seed": 2}, resume=True) as job:
        assert (job.config.iterations, job.config.seed) == (11, 2)


def test_a_limit_that_leaves_no_photo_out_changes_nothing(tmp_path: Path, source: Path) -> None:
    with Job.start(tmp_path / "job", source, user_options={"preset": "standard"}) as job:
        keys = job.keys
    with Job.start(tmp_path / "job", user_options={"preset": "draft"}, resume=True) as job:
        assert [stage for stage in STAGE_NAMES if job.keys[stage] == keys[stage]] == ["scene", "masks"]


@pytest.mark.parametrize(("adjust", "first"), [(False, "deliver"), (True, "scene")])
def test_numbers_of_georeferencing_redo_the_scene_only_where_control_points_move_cameras(
    tmp_path: Path, source: Path, adjust: bool, first: str
) -> None:
    (tmp_path / "points.csv").write_text("P1,1,2,3")
    given = {"control": str(tmp_path / "points.csv"), "control_adjust": adjust}
    with Job.start(tmp_path / "job", source, user_options=given) as job:
        finish_all(job)
    with Job.start(tmp_path / "job", user_options={"control_points.accuracy": 0.02}, resume=True) as job:
        undone = [stage for stage in STAGE_NAMES if not job.done(stage)]
    assert undone == list(STAGE_NAMES[STAGE_NAMES.index(first) :])


def test_beginning_a_stage_removes_results_of_other_options_only(tmp_path: Path, source: Path) -> None:
    with Job.start(tmp_path / "job", source) as job:
        job.begin("field")
        checkpoint = job.path("checkpoints", "training.npz")
        checkpoint.parent.mkdir()
        checkpoint.write_bytes(b"1")
        job.begin("field")
        assert checkpoint.exists()
    with Job.start(tmp_path / "job", user_options={"seed": 3}, resume=True) as job:
        job.begin("field")
        assert not checkpoint.exists()


@pytest.mark.parametrize(
    ("stage", "kind", "options"), [("field", "start", {"start_cut.area": 0.5}), ("mesh", "mesh", {"level_steps": 3})]
)
def test_finished_blocks_of_an_interrupted_stage_are_for_the_same_options_only(
    tmp_path: Path, source: Path, monkeypatch, stage: str, kind: str, options: dict
) -> None:
    monkeypatch.setattr(memory, "_scratch", tmp_path / "job")
    points = np.zeros((1, 3))  # the same with both options
    with Job.start(tmp_path / "job", source) as job:
        job.begin(stage)
        BlockStore(kind, points).save(1, vertices=points)
        job.begin(stage)
        assert BlockStore(kind, points).load(1) is not None
    with Job.start(tmp_path / "job", user_options=options, resume=True) as job:
        job.begin(stage)
        assert BlockStore(kind, points).load(1) is None


def test_a_stage_done_again_with_the_same_options_keeps_the_later_ones(tmp_path: Path, source: Path) -> None:
    with Job.start(tmp_path / "job", source) as job:
        finish_all(job)
        job.finish("masks", job.begin("masks"), 1.0, 2.0, 1, {}, [])
        assert all(job.done(stage) for stage in STAGE_NAMES)
        job.forget("masks")
        assert [stage for stage in STAGE_NAMES if not job.done(stage)] == ["masks"]


def test_marks_of_begun_stages_may_hold_anything(tmp_path: Path, source: Path) -> None:
    with Job.start(tmp_path / "job", source) as job:
        job.path(".started-mesh").write_bytes(b"\xff\xfe")
        job.path("mesh.ply").write_bytes(b"of other options")
        job.begin("mesh")
        assert not job.path("mesh.ply").exists()


def test_job_file_holds_inputs_and_options(tmp_path: Path, source: Path) -> None:
    Job.start(tmp_path / "job", source, user_options={"seed": 4}).close()
    data = json.loads((tmp_path / "job" / "job.json").read_text())
    assert data["given"] == {"seed": 4}
    assert data["config"]["seed"] == 4
    assert data["source"] == str(source.resolve())
