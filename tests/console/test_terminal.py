# SPDX-License-Identifier: GPL-3.0-or-later
"""What people read on a terminal and in logs, whatever the figures of a stage are."""

from __future__ import annotations

import math
from typing import Any

import pytest

from mgf_engine.console.terminal import format_duration, make_sink
from mgf_engine.messages import Reporter


@pytest.mark.parametrize("unknown", [None, math.nan, math.inf])
def test_an_unknown_duration_is_a_question_mark(unknown: float | None) -> None:
    assert format_duration(unknown) == "?"


#: Figure -> how it is read; nothing where there is nothing to read.
FIGURES: list[tuple[Any, str]] = [
    (None, ""), (math.nan, ""), (math.inf, ""), ([1, 2], ""), ({"points": 0.5}, ""), (True, "number: yes"),
    (False, "number: no"), (0, "number 0"), (12345, "number 12,345"), (0.5, "number 0.5"), (0.0, "number 0"),
    (0.1 + 0.2, "number 0.3"), (12345.678, "number 12,345.678"), ("2 of 3", "number: 2 of 3"),
]  # fmt: skip


@pytest.mark.parametrize("style", ["plain", "bar"])
@pytest.mark.parametrize(("value", "read"), FIGURES)
def test_figures_of_all_kinds_are_read(style: str, value: Any, read: str, capsys: pytest.CaptureFixture[str]) -> None:
    reporter = Reporter(make_sink(style))
    reporter.stages = ("mesh",)
    reporter.stage("mesh")
    reporter.progress(1.0, number=value)
    reporter.send("result", path="job", files={"mesh": "job/mesh.ply"}, figures={"number": value})
    last = capsys.readouterr().err.splitlines()[-2:]
    assert [line.strip() for line in last] == [f"Done. {read}".strip(), "mesh: job/mesh.ply"]
