# SPDX-License-Identifier: GPL-3.0-or-later
"""``deliver.json`` tells how cameras were held, for who imports a job without its photos."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from support.finished_job import finish_job

from mgf_engine.export.stage import _manifest
from mgf_engine.jobs.job import Job
from mgf_engine.jobs.results import load_scene_of


def test_views_say_how_the_camera_was_held(tmp_path: Path) -> None:
    with Job.start(finish_job(tmp_path, photos=6).folder, resume=True) as job:
        scene = load_scene_of(job)
        scene = replace(scene, views=(replace(scene.views[0], held=6), *scene.views[1:]))
        found = _manifest(job, scene, {}, {})
    assert [view["held"] for view in found["views"]] == [6, 1, 1, 1, 1, 1]
