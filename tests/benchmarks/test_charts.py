# SPDX-License-Identifier: GPL-3.0-or-later
"""Charts of suites: names beside their points, curves only through steps of one quantity."""

from __future__ import annotations

import itertools
from pathlib import Path

import matplotlib.pyplot as plt
import pytest

from benchmarks.charts import _curves, write_chart
from benchmarks.speed_charts import speed_figure
from benchmarks.suites import SuiteSettings, suite_runs
from mgf_engine.errors import BadInput


def rows() -> list[dict]:
    """A row for each variant of the chart; all nearly at one place."""
    runs = suite_runs(
        "pareto", SuiteSettings(["house"], commands={"OpenMVS": "x {mesh}"}, only=["preset", "(", "OpenMVS"])
    )
    return [
        {"variant": run.variant, "group": run.group, "cpu_seconds": 50 + number / 4, "psnr": None,
         "geometry": {"thresholds": [0.05], "f1": [20.0 + 0.1 * number]}}
        for number, run in enumerate(runs)
    ]  # fmt: skip


def test_each_point_has_a_name_and_no_name_covers_another() -> None:
    figure, axes = plt.subplots(figsize=(5.5, 4.6), layout="constrained")
    _curves(axes, rows(), ("cpu_seconds", "CPU seconds"), "f1")
    assert {text.get_text() for text in axes.texts} == {
        "quick", "draft", "standard", "fine", "paper", "(a)", "(b)", "(c)", "(d)", "OpenMVS",
    }  # fmt: skip
    boxes = [text.get_window_extent() for text in axes.texts]
    assert not any(one.overlaps(other) for one, other in itertools.combinations(boxes, 2))
    plt.close(figure)


def test_settings_that_are_no_steps_of_one_quantity_are_not_joined() -> None:
    figure, axes = plt.subplots()
    _curves(axes, rows(), ("cpu_seconds", "CPU seconds"), "f1")
    styles = {str(line.get_label()).split()[0]: line.get_linestyle() for line in axes.get_lines()}
    assert styles == {"presets": "-", "paper's": "None", "ablation": "None", "OpenMVS": "None"}
    plt.close(figure)


def scene_rows() -> list[dict]:
    """The same on two scenes of the catalogue; meshes of whole photos are better in the building's box."""
    scores = {"thresholds": [0.05, 0.1, 0.2]}
    return [
        {**row, "scene": scene, "ground_pixel": 0.05, "photos": 40, "width": 750,
         "geometry": {**scores, "f1": [20.0 + number, 40.0, 60.0]},
         "in_box": {**scores, "f1": [30.0 + number, 50.0, 70.0]}, "whole_picture": row["variant"] == "(a)"}
        for scene in ("smoke", "white_house")
        for number, row in enumerate(rows())
    ]  # fmt: skip


def test_all_scenes_stand_beside_each_other_with_one_legend() -> None:
    figure = speed_figure(scene_rows())
    titles = [axes.get_title().split("\n") for axes in figure.axes if axes.get_title()]
    assert [title[0] for title in titles] == ["smoke", "white_house"]
    assert titles[1][1] == "40 photos of 750 px, a pixel covers 5.0 cm"
    assert len(figure.axes) == 4
    (legend,) = figure.legends
    told = " ".join(text.get_text() for text in legend.get_texts()).replace("\n", " ")
    assert "our presets" in told and "(d) no screening" in told and "OpenMVS" in told
    plt.close(figure)


def test_scenes_with_a_mesh_of_whole_photos_show_f1_in_the_building_s_box() -> None:
    mixed = scene_rows()
    masked = [{**row, "whole_picture": False} for row in mixed]
    mixed[0]["whole_picture"] = True
    for given, first in ((mixed, 30.0), (masked, 20.0)):
        figure = speed_figure(given)
        assert figure.axes[0].get_lines()[0].get_ydata()[0] == first
        plt.close(figure)


def test_chart_is_written_as_png_and_refused_without_results(tmp_path: Path) -> None:
    write_chart("pareto", scene_rows(), tmp_path / "speed.png")
    assert (tmp_path / "speed.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    with pytest.raises(BadInput, match="has a result"):
        write_chart("pareto", [{"variant": "x", "failed": "no luck"}], tmp_path / "none.png")
    assert not (tmp_path / "none.png").exists()
    with pytest.raises(BadInput, match="Cannot write the chart"):
        write_chart("pareto", scene_rows(), tmp_path / "missing" / "speed.png")
