# SPDX-License-Identifier: GPL-3.0-or-later
"""Scale bars: what is read of a file, and the scale that they give."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mgf_engine.errors import BadInput
from mgf_engine.georef.control_points import CHECK, CONTROL
from mgf_engine.georef.scale_bars import ScaleBar, measure_bars, read_bars
from mgf_engine.georef.triangulate import TriangulatedPoint


def placed(**points: tuple[float, float, float]) -> dict[str, TriangulatedPoint]:
    none = np.zeros((0, 2)), np.zeros(0, bool)
    return {name: TriangulatedPoint(name, np.array(at, float), (), *none) for name, at in points.items()}


#: A unit of the normalised frame is 2.5 m here.
POINTS = placed(a=(0, 0, 0), b=(4, 0, 0), c=(0, 2, 0), d=(0, 0, 8))
BARS = (ScaleBar("a", "b", 10.0), ScaleBar("a", "c", 5.0), ScaleBar("a", "d", 20.0))


def read(folder: Path, text: str) -> tuple[ScaleBar, ...]:
    (folder / "bars.csv").write_text(text)
    return read_bars(folder / "bars.csv")


@pytest.mark.parametrize(
    ("text", "said"),
    [("from;to\na;b\n", "no column 'length'"), ("from,length\na,2\n", "no column 'to'"),
     ("from,to,length\na,b,0\n", "Line 2 .* a length of 0"), ("from,to,length\na,b,-3\n", "a length of -3")],
)  # fmt: skip
def test_files_that_cannot_be_used_are_refused(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(BadInput, match=said):
        read(tmp_path, text)


@pytest.mark.parametrize("bars", [(ScaleBar("a", "z", 3.0),), (ScaleBar("a", "a", 3.0),)])
def test_bars_that_cannot_be_measured_are_refused(bars: tuple[ScaleBar, ...]) -> None:
    with pytest.raises(BadInput, match=f"{bars[0].name} cannot be measured"):
        measure_bars(bars, POINTS, None)


def test_columns_by_name_and_by_place(tmp_path: Path) -> None:
    assert read(tmp_path, "Point1;Distance;Point2;Use\na;1,25;b;check\n") == (ScaleBar("a", "b", 1.25, 0.002, CHECK),)
    assert read(tmp_path, "a b 1.25 0.01\nb c 2 0.02\n") == (
        ScaleBar("a", "b", 1.25, 0.01),
        ScaleBar("b", "c", 2.0, 0.02),
    )


def test_the_scale_is_the_bars_own() -> None:
    scale, rows = measure_bars(BARS, POINTS, None)
    assert scale == pytest.approx(2.5) and [row.error for row in rows] == pytest.approx([0, 0, 0])
    assert all(row.used for row in rows)


def test_long_and_accurate_bars_weigh_more() -> None:
    """Weights are squared lengths over accuracies: 10 m at 2 mm against 5 m at 1 mm count alike."""
    bars = (ScaleBar("a", "b", 10.2), ScaleBar("a", "c", 5.0, 0.001))
    assert measure_bars(bars, POINTS, None)[0] == pytest.approx((10.2**2 * 2.55 + 10.0**2 * 2.5) / (10.2**2 + 10.0**2))


def test_an_outlier_among_three_is_left_out_and_measured() -> None:
    scale, rows = measure_bars((*BARS[:2], ScaleBar("a", "d", 22.0)), POINTS, None)
    assert scale == pytest.approx(2.5) and [row.used for row in rows] == [True, True, False]
    assert rows[2].found == pytest.approx(20.0) and rows[2].error == pytest.approx(-2.0)


def test_check_bars_are_measured_and_do_not_count() -> None:
    bars = (BARS[0], ScaleBar("a", "d", 30.0, role=CHECK))
    scale, rows = measure_bars(bars, POINTS, None)
    assert scale == pytest.approx(2.5) and [row.used for row in rows] == [True, False]
    assert measure_bars(bars[1:], POINTS, None)[0] == pytest.approx(3.75)  # nothing else gives a scale


def test_a_known_scale_is_kept() -> None:
    scale, rows = measure_bars(BARS, POINTS, 2.0)
    assert scale == 2.0 and not any(row.used for row in rows) and rows[0].found == pytest.approx(8.0)
    assert BARS[0].role == CONTROL and BARS[0].name == "a–b"
