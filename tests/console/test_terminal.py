# SPDX-License-Identifier: GPL-3.0-or-later
"""What people read on a terminal and in logs, whatever the figures of a stage are."""

from __future__ import annotations

import math
import re
from typing import Any

import pytest
from support.live_terminal import live_terminal

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


@pytest.mark.parametrize("columns", [60, 80, 200])
def test_a_bar_keeps_its_share_and_whole_figures(
    columns: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """80 columns showed "mesh   … 10… vertices 12,607  faces 23,849  confidence 0.824  unseen share 0.01…"."""
    live_terminal(monkeypatch)
    monkeypatch.setenv("COLUMNS", str(columns))
    monkeypatch.setenv("NO_COLOR", "1")
    reporter = Reporter(make_sink("bar"))
    reporter.stages = ("mesh",)
    reporter.stage("mesh")
    for share in (0.5, 1.0):
        reporter.progress(share, vertices=12607, faces=23849, confidence=0.824, unseen_share=0.0162)
    reporter.send("result", path="job", files={}, figures={})
    rows = re.findall(r"mesh [^\r\n]*", re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", capsys.readouterr().err))
    assert all(len(row.rstrip()) <= columns for row in rows) and not any("…" in row for row in rows)
    assert re.search(r"━ 100%", rows[-1])
    assert columns < 80 or "vertices 12,607" in rows[-1]
    assert columns < 200 or rows[-1].rstrip().endswith("unseen share 0.0162")


def test_a_bar_that_never_began_leaves_no_empty_lines(capsys: pytest.CaptureFixture[str]) -> None:
    reporter = Reporter(make_sink("bar"))
    reporter.send("failed", code=2, text="--detail takes a length in centimetres above 0, not 'x'.", log=None)
    reporter.close()
    assert capsys.readouterr().err == "Error: --detail takes a length in centimetres above 0, not 'x'.\n"
