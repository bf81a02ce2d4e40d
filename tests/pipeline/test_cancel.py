# SPDX-License-Identifier: GPL-3.0-or-later
"""A job that is asked to stop does so at the next step, and steps are short."""

from __future__ import annotations

import itertools
import threading
from pathlib import Path

from support.jobs import run_here

from benchmarks.synthetic.house import House
from mgf_engine.export import report, stage
from mgf_engine.masks.propagation import propagate
from mgf_engine.mesh import extract
from mgf_engine.messages import Reporter
from mgf_engine.start import surface

#: What the stages spend their time on; of the deliver stage, beside the texture, which has a thread of its own.
STEPS = (
    (propagate, "densify_points"), (propagate, "find_up"), (propagate, "measure_point_features"),
    (propagate, "LabelGraph"), (propagate, "PromptCrossValidation"),
    (surface, "start_views"), (surface, "find_stereo_points"), (surface, "find_segments"), (surface, "find_lines"),
    (surface, "gather_evidence"), (surface, "cut_in_blocks"),
    (extract, "screen"), (extract, "raw_surface"), (extract, "clean_level_set"), (extract, "refine_mesh"),
    (extract, "flatten_planes"), (extract, "extend_planes"), (extract, "edge_photos"),
    (extract, "find_wall_openings"), (extract, "trim_mesh"), (extract, "color_mesh"), (extract, "simplify_mesh"),
    (stage, "georeference_job"), (stage, "load_field"), (report, "turntable"), (report, "_evenness"),
    (report, "_show_texture"), (report, "write_report"),
)  # fmt: skip


def test_a_job_asks_between_any_two_steps(house: House, tmp_path: Path, capsys, monkeypatch) -> None:
    done = []

    def recorded(name: str, work):
        def record_and_do(*given, **more):
            if threading.current_thread() is threading.main_thread():
                done.append(name)
            return work(*given, **more)

        return record_and_do

    for module, name in STEPS:
        monkeypatch.setattr(module, name, recorded(name, getattr(module, name)))
    monkeypatch.setattr(Reporter, "check", recorded("check", Reporter.check))
    code, _ = run_here(
        capsys, "reconstruct", house.folder, "--prompts", house.prompts, "--out", tmp_path / "job", "--preset", "quick"
    )
    assert code == 0 and {name for _, name in STEPS} <= set(done)
    together = [pair for pair in itertools.pairwise(done) if "check" not in pair]
    assert not together, together
