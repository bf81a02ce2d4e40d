# SPDX-License-Identifier: GPL-3.0-or-later
"""Planes give the lines of walls seen edge on and of ridges, none where eaves hide how roof and wall meet."""

from __future__ import annotations

import numpy as np
import pytest
from support.finished_job import FinishedJob

from mgf_engine.drawings.facades import find_facades
from mgf_engine.drawings.load import read_survey
from mgf_engine.drawings.model import Survey
from mgf_engine.drawings.plane_lines import plane_lines
from mgf_engine.drawings.regions import survey_planes
from mgf_engine.drawings.straighten import straighten
from mgf_engine.drawings.trace import trace

GROUND_TO_EAVES, RIDGE = 2.0, 3.2


@pytest.fixture(scope="module")
def survey(finished: FinishedJob) -> Survey:
    return read_survey(finished.folder)


def lines_of(survey: Survey, facade: int) -> np.ndarray:
    return plane_lines(survey, survey_planes(survey), find_facades(survey)[facade].frame)


def has(found: np.ndarray, line: tuple[float, float, float], slack: float) -> bool:
    """Whether ``a x + b y = c`` is among the lines."""
    a, b, c = line
    return any(min(np.abs(s * row - (a, b, -c)).max() for s in (1, -1)) < slack for row in found[:, :3])


def test_a_long_side_knows_its_end_walls_and_the_ridge_but_not_the_eaves(survey: Survey) -> None:
    found, bottom = lines_of(survey, 0), float(survey.mesh.vertices[:, 2].min())
    slack = survey.working_pixel
    assert has(found, (1, 0, 0), slack) and has(found, (1, 0, 4), slack)
    assert has(found, (0, 1, bottom + RIDGE), slack)
    assert not has(found, (0, 1, bottom + GROUND_TO_EAVES), slack)


def test_a_gable_knows_its_roof_edge_on(survey: Survey) -> None:
    found, bottom = lines_of(survey, 1), float(survey.mesh.vertices[:, 2].min())
    slope = np.array([-0.8, 1.0]) / np.hypot(0.8, 1)
    assert has(found, (*slope, slope[1] * (bottom + GROUND_TO_EAVES)), survey.working_pixel)


def border(height: np.ndarray) -> np.ndarray:
    label = np.where(np.arange(140)[:, None] >= height[None], 2, 1).astype(np.int32)
    return max((chain.corners for chain in trace(label) if (chain.low, chain.high) == (1, 2)), key=len)


@pytest.mark.parametrize("slope", [0.0, 0.3])
def test_a_border_that_wanders_about_a_known_line_is_that_line(slope: float) -> None:
    column = np.arange(240)
    rng = np.random.default_rng(0)
    wandering = np.interp(column, np.arange(0, 241, 8), rng.uniform(-3, 3, 31))
    corners = border(np.rint(30 + slope * column + wandering).astype(int))
    line = np.array([*np.array([-slope, 1.0, -31.0]) / np.hypot(slope, 1), -np.inf, np.inf])
    without, stroke = (straighten(corners, (0, 1), 1.0, known, frayed=True) for known in (None, line[None]))
    assert slope == 0.0 or len(without.segments) > 4
    assert len(stroke.segments) == 1 and stroke.segments[0].known
    np.testing.assert_allclose(stroke.points @ line[:2] + line[2], 0, atol=1e-9)


def test_a_border_beside_a_known_line_stays_where_it_is() -> None:
    corners = border(np.full(240, 60))
    stroke = straighten(
        corners, (0, 1), 1.0, np.array([[0.0, 1.0, -66.0, 0, 240], [1.0, 0.0, -60.0, -140, 0]]), frayed=True
    )
    np.testing.assert_array_equal(stroke.points[:, 1], 60)


def test_a_border_beyond_the_end_of_a_known_line_stays_where_it_is() -> None:
    corners = border(np.full(240, 60))
    drawn = [
        straighten(corners, (0, 1), 1.0, np.array([[0.0, 1.0, -61.0, begin, 400.0]]), frayed=True).points[0, 1]
        for begin in (0.0, 300.0)
    ]
    assert drawn == [61.0, 60.0]
