# SPDX-License-Identifier: GPL-3.0-or-later
"""Charts of suites: names beside their points, curves only through steps of one quantity."""

from __future__ import annotations

import itertools

import matplotlib.pyplot as plt

from benchmarks.charts import _curves
from benchmarks.suites import suite_runs


def rows() -> list[dict]:
    """A row for each variant of the chart; all nearly at one place."""
    runs = suite_runs("pareto", ["house"], commands={"OpenMVS": "x {mesh}"}, only=["preset", "(", "OpenMVS"])
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
