# SPDX-License-Identifier: GPL-3.0-or-later
"""``mgf models`` says how far it is, and asks whether to stop, before each of its steps."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest
from support.finished_job import FinishedJob

from mgf_engine.messages import Reporter
from mgf_engine.models import levels, make
from mgf_engine.models.work import ModelOptions

STEPS = (
    (make, "read_survey"), (levels, "reduce_chain"), (levels, "transfer_texture"), (levels, "_write_level"),
    (levels, "write_usd"), (make, "build_solid"), (make, "add_openings"), (make, "write_ifc"),
    (make, "surface_points"), (make, "write_laz"),
)  # fmt: skip


def test_it_asks_between_any_two_steps(job: FinishedJob, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done, shares = [], []

    def recorded(name: str, work):
        return lambda *given, **more: (work(*given, **more), done.append(name))[0]

    for module, name in STEPS:
        monkeypatch.setattr(module, name, recorded(name, getattr(module, name)))
    monkeypatch.setattr(Reporter, "check", recorded("check", Reporter.check))
    reporter = Reporter(lambda message: shares.append(message.get("fraction", 0.0)), min_interval=0.0)
    make.make_models(job.folder, tmp_path / "models", ModelOptions(), reporter)
    assert {name for _, name in STEPS} <= set(done)
    together = [pair for pair in itertools.pairwise(done) if "check" not in pair]
    assert not together, together
    told = [share for share in shares if share]
    assert told == sorted(told) and told[-1] > 0.9
