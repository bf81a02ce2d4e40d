# SPDX-License-Identifier: GPL-3.0-or-later
"""Results that were deleted or damaged are made again where they are needed."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from mgf_engine.errors import BadInput
from mgf_engine.jobs.job import Job
from mgf_engine.jobs.results import load_field, load_mesh, load_scene_of
from mgf_engine.jobs.runs import keep_run
from mgf_engine.stages import STAGE_NAMES, stage_named
from tests.support.jobs import finish_all, leave_results


@pytest.mark.parametrize(
    ("deleted", "options", "lost"),
    [
        ([], {}, set()),
        (["mesh.ply"], {}, {"mesh"}),
        (["report.html"], {}, {"deliver"}),
        (["texture.jpg"], {}, {"deliver"}),
        (["scene/scene.npz", "masks/scores.json", "checkpoints/field.npz"], {}, set()),  # nobody reads them any more
        (["checkpoints/field.npz"], {"level_steps": 3}, {"field"}),
        (["masks/scores.json"], {"render_all": True}, {"masks"}),
        (["mesh.ply", "masks/scores.json"], {}, {"mesh", "masks"}),
    ],
)
def test_results_that_are_gone_are_missed_where_they_are_needed(tmp_path, source, deleted, options, lost) -> None:
    with Job.start(tmp_path / "job", source) as job:
        finish_all(job)
        leave_results(job)
        for name in deleted:
            job.path(name).unlink()
    with Job.start(tmp_path / "job", user_options=options, resume=True) as job:
        assert job.missing_results("deliver") == lost


def test_a_result_whose_run_was_deleted_by_hand_is_made_again(tmp_path: Path, source: Path) -> None:
    with Job.start(tmp_path / "job", source) as job:
        finish_all(job)
        leave_results(job)
        keep_run(job.folder, ["mesh.ply"], {"views": [], "mesh": "mesh.ply", "figures": {}}, {})
        assert job.missing_results("deliver") == set()
        shutil.rmtree(job.path("runs"))
        assert job.missing_results("deliver") == {"deliver"}


@pytest.mark.parametrize("stage", STAGE_NAMES)
def test_the_stage_that_is_asked_for_is_missed_in_any_case(tmp_path: Path, source: Path, stage: str) -> None:
    with Job.start(tmp_path / "job", source) as job:
        finish_all(job)
        leave_results(job)
        job.path(stage_named(stage).required_outputs[0]).unlink()
        assert job.missing_results(stage) == {stage}


@pytest.mark.parametrize(("stage", "load"), [("scene", load_scene_of), ("field", load_field), ("mesh", load_mesh)])
def test_a_result_that_cannot_be_read_is_made_again_alone(tmp_path: Path, source: Path, stage: str, load) -> None:
    with Job.start(tmp_path / "job", source) as job:
        finish_all(job)
        leave_results(job)
        with pytest.raises(BadInput, match="again"):
            load(job)
        assert [name for name in STAGE_NAMES if not job.done(name)] == [stage]
