# SPDX-License-Identifier: GPL-3.0-or-later
"""A job that is asked to stop does so at the next step, and steps are short."""

from __future__ import annotations

import itertools
import json
import shutil
import threading
from pathlib import Path

from support.jobs import run_here

from mgf_engine.export import report, stage
from mgf_engine.messages import Reporter

#: What the deliver stage spends its time on, beside the texture, which has a thread of its own.
STEPS = (
    (stage, "georeference_job"), (stage, "load_field"), (report, "turntable"), (report, "_evenness"),
    (report, "_show_texture"), (report, "write_report"),
)  # fmt: skip


def test_the_deliver_stage_asks_between_any_two_steps(finished, tmp_path: Path, capsys, monkeypatch) -> None:
    job = Path(shutil.copytree(finished[0], tmp_path / "job"))
    record = json.loads((job / "job.json").read_text())
    del record["stages"]["deliver"]
    (job / "job.json").write_text(json.dumps(record))
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
    code, _ = run_here(capsys, "reconstruct", "--resume", "--out", job)
    assert code == 0 and {name for _, name in STEPS} <= set(done)
    together = [pair for pair in itertools.pairwise(done) if "check" not in pair]
    assert not together, together
