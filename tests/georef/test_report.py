# SPDX-License-Identifier: GPL-3.0-or-later
"""The plot of residuals in the report."""

from __future__ import annotations

from matplotlib.figure import Figure

from mgf_engine.georef.report import draw_bars


def test_photos_of_one_name_in_two_folders_have_a_bar_each() -> None:
    axes = Figure().subplots()
    draw_bars(axes, [("0001.jpg", 0.5, "red"), ("0001.jpg", -0.2, "red"), ("0002.jpg", 0.1, "blue")])
    assert [round(bar.get_width(), 3) for bar in axes.patches] == [0.5, -0.2, 0.1]
    assert len({bar.get_y() for bar in axes.patches}) == 3
    assert [label.get_text() for label in axes.get_yticklabels()] == ["0001.jpg", "0001.jpg", "0002.jpg"]
    assert axes.yaxis_inverted()
