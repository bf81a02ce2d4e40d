# SPDX-License-Identifier: GPL-3.0-or-later
import json
import time

import pytest

from mgf_engine.console.terminal import format_duration, make_sink
from mgf_engine.errors import Cancelled
from mgf_engine.messages import STAGE_SHARE, Reporter, encode
from mgf_engine.stages import STAGE_NAMES


def test_every_message_is_one_line_of_json_with_its_schema() -> None:
    seen: list[dict] = []
    reporter = Reporter(seen.append)
    reporter.stage("scene")
    reporter.progress(0.5, 3.0, photos=3)
    reporter.warning("línea\nrota")
    reporter.preview("a.jpg", "A")
    for message in seen:
        line = encode(message)
        assert "\n" not in line
        assert json.loads(line) == message
        assert {"v", "type", "time"} <= set(message)


def test_overall_grows_over_the_stages() -> None:
    seen: list[dict] = []
    reporter = Reporter(seen.append, min_interval=0)
    for name in STAGE_NAMES:
        reporter.stage(name)
        reporter.progress(0.0)
        reporter.progress(1.0)
    overall = [m["overall"] for m in seen if m["type"] == "progress"]
    assert overall == sorted(overall)
    assert overall[0] == 0
    assert overall[-1] == 1
    assert sum(STAGE_SHARE.values()) == pytest.approx(1)


def test_progress_is_not_sent_more_often_than_asked_but_ends_always_pass() -> None:
    seen: list[dict] = []
    reporter = Reporter(seen.append, min_interval=60)
    reporter.stage("field")
    for step in range(101):
        reporter.progress(step / 100)
    fractions = [m["fraction"] for m in seen if m["type"] == "progress"]
    assert fractions[0] == 0
    assert fractions[-1] == 1
    assert len(fractions) <= 4


def test_cancel_raises_at_the_next_report() -> None:
    reporter = Reporter()
    reporter.cancel()
    assert reporter.cancelled
    with pytest.raises(Cancelled):
        reporter.progress(0.1)


@pytest.mark.parametrize("style", ["plain", "bar", "json", "none"])
def test_every_style_shows_every_message(style: str, capsys) -> None:
    reporter = Reporter(make_sink(style), min_interval=0)
    reporter.stages = STAGE_NAMES
    reporter.send("started", job="j", pid=1, version="0", stages=list(STAGE_NAMES))
    reporter.stage("scene", cached=True)
    reporter.stage("masks")
    reporter.progress(0.5, None, photos=1)
    reporter.warning("Something [odd] happened")
    reporter.send("result", path="j", files={"mesh": "m"}, figures={"psnr": None, "faces": 8})
    reporter.send("failed", code=2, text="Why", log=None)
    out = capsys.readouterr()
    if style == "json":
        assert all(json.loads(line) for line in out.out.splitlines())
    elif style == "none":
        assert (out.out, out.err) == ("", "Error: Why\n")
    else:
        assert "Something [odd] happened" in out.err
        assert "Done. faces 8\n" in out.out + out.err and "None" not in out.out + out.err
        assert "? left" not in out.out + out.err


@pytest.mark.parametrize("style", ["plain", "bar"])
def test_the_time_left_is_that_of_the_whole_job_where_it_was_estimated(style: str, capsys) -> None:
    reporter = Reporter(make_sink(style), min_interval=0)
    reporter.stages = STAGE_NAMES
    reporter.stage("scene")
    reporter.progress(0.5, 7.0, start="planes", gaussians=28819, start_gaussians=1000)
    reporter.expect({"masks": 60.0, "field": 30.0})
    reporter.progress(0.8, 5.0)
    reporter.send("result", path="j", files={}, figures={"faces": 251606, "psnr": 24.5})
    said = " ".join("".join(capsys.readouterr()).split())
    assert "7 s left in this stage" in said or style == "bar"  # the bar shows only its last state
    assert "1 min 35 s left in all" in said
    assert "start: planes gaussians 28,819 start gaussians 1,000" in said or style == "bar"
    assert "Done. faces 251,606, psnr 24.5" in said


def test_a_result_tells_how_long_it_took(capsys, monkeypatch) -> None:
    reporter = Reporter(make_sink("plain"))
    now = time.monotonic()
    monkeypatch.setattr(time, "monotonic", lambda: now + 200.0)
    reporter.send("result", path="j", files={}, figures={})
    assert capsys.readouterr().err == "Done in 3 min 20 s.\n"


def test_a_result_without_files_leaves_no_empty_line(capsys) -> None:
    Reporter(make_sink("plain")).send("result", path="j", files={}, figures={"photos": 3}, suggested=["a.jpg"])
    assert capsys.readouterr().err == "Done. photos 3\nClick the building in some of these photos: a.jpg\n"


@pytest.mark.parametrize("style", ["plain", "bar"])
def test_figures_of_parts_are_left_to_the_report(style: str, capsys) -> None:
    figures = {"faces": 1234, "seconds_per_part": {"planes": 0.5}}
    Reporter(make_sink(style)).send("result", path="j", files={}, figures=figures)
    assert "".join(capsys.readouterr()).strip() == "Done. faces 1,234"


@pytest.mark.parametrize("style", ["plain", "bar", "none"])
def test_who_cancels_is_not_told_of_an_error(style: str, capsys) -> None:
    Reporter(make_sink(style)).send("failed", code=3, text="Cancelled; run again.", log=None)
    assert capsys.readouterr().err.strip() == "Cancelled; run again."


@pytest.mark.parametrize(("seconds", "text"), [(None, "?"), (3.2, "3 s"), (75, "1 min 15 s"), (3900, "1 h 5 min")])
def test_durations_read_well(seconds: float | None, text: str) -> None:
    assert format_duration(seconds) == text
