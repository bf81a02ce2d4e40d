# SPDX-License-Identifier: GPL-3.0-or-later
"""Openings of generated buildings, and how drawn rectangles are compared with them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.buildings import BUILDINGS
from benchmarks.openings import compare, main, true_openings


def test_a_house_has_the_openings_it_was_given() -> None:
    openings = true_openings(BUILDINGS["plain_house"]("clean_white"))
    assert len(openings) == 9
    sizes = [np.ptp(corners, axis=0) for corners in openings]
    assert all(min(size[:2]) < 1e-9 and max(size[:2]) > 0.5 and size[2] > 0.5 for size in sizes)  # upright rectangles


def test_half_an_overlap_is_found_and_the_rest_missed_or_false() -> None:
    true = np.array([[0.0, 0, 1, 1], [3, 0, 4, 1], [6, 0, 7, 1]])
    drawn = np.array([[0.1, 0, 1.1, 1], [3.6, 0, 4.6, 1], [9, 0, 10, 1]])
    score = compare(true, drawn)
    assert (score.openings, score.found, score.false) == (3, 1, 2)
    assert score.rms == pytest.approx(100.0)
    assert score.edges == pytest.approx((100.0, 0.0))
    assert np.isnan(compare(true, np.zeros((0, 4))).rms)


def test_what_is_no_job_is_refused_in_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert error.startswith("Error: ") and error.count("\n") == 1 and str(tmp_path) in error
