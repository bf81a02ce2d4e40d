# SPDX-License-Identifier: GPL-3.0-or-later
"""Openings by their depth in a wall: right though the mesh slopes into them, and none where there is none."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from mgf_engine.drawings.elevation import is_within_opening
from mgf_engine.drawings.model import OUTLINE, STEP, DrawingFrame
from mgf_engine.drawings.openings import find_openings
from mgf_engine.drawings.project import Grid, GridBuffers
from mgf_engine.drawings.regions import RegionMap
from mgf_engine.drawings.trace import Chain
from mgf_engine.openings.detection import Opening, without_doubles

PIXEL = 0.05  # metres; the map has two pixels to it
HEIGHT, WIDTH = 300, 400
ROW, COLUMN = np.mgrid[:HEIGHT, :WIDTH]
WINDOWS = ((40, 60, 90, 130), (160, 60, 210, 130), (280, 200, 330, 290))  # left, top, right, bottom


def found(before: np.ndarray) -> np.ndarray:
    """Openings in a wall whose plane is that of the drawing, [n, 4], from the left."""
    up = np.array([0.0, 0.0, 1.0])
    size = np.array([WIDTH, HEIGHT]) * 0.5 * PIXEL
    frame = DrawingFrame("A", np.zeros(3), np.array([1.0, 0.0, 0.0]), up, np.zeros(2), size)
    grid = Grid(frame, 0.5 * PIXEL, 0.0, float(size[1]), WIDTH, HEIGHT)
    regions = RegionMap(grid, np.ones((HEIGHT, WIDTH), np.int32), np.zeros((1, 3)))
    seen = GridBuffers(grid, np.where(np.isfinite(before), 0, -1).astype(np.int32), before.astype(np.float32))
    boxes = np.array([one.box for one in find_openings(regions, seen, PIXEL)]).reshape(-1, 4)
    return boxes[np.argsort(boxes[:, 0])]


def wall(
    windows: tuple[tuple[int, int, int, int], ...] = WINDOWS, depth: float = 0.18, slope: float = 4.0
) -> np.ndarray:
    """A wall with windows that the mesh slopes into over several pixels, and noise."""
    before = np.zeros((HEIGHT, WIDTH))
    for left, top, right, bottom in windows:
        before[top:bottom, left:right] = -depth
    rng = np.random.default_rng(0)
    noise = cv2.GaussianBlur(rng.normal(0, 0.2, before.shape), (0, 0), 3.0)
    return cv2.GaussianBlur(before, (0, 0), slope) + 0.1 * noise


def test_windows_that_the_mesh_slopes_into_are_right_to_half_a_pixel() -> None:
    np.testing.assert_allclose(found(wall()), WINDOWS, atol=1.0)


def test_edges_on_one_line_are_level() -> None:
    uneven = ((40, 60, 90, 130), (160, 62, 210, 132), (280, 200, 330, 290))
    boxes = found(wall(uneven))
    assert boxes[0, 1] == boxes[1, 1] and boxes[0, 3] == boxes[1, 3] and boxes[2, 1] == pytest.approx(200, abs=1)


def test_a_door_ends_where_the_wall_does() -> None:
    before = wall(((100, 180, 150, 280),))
    before[280:] = np.nan
    np.testing.assert_allclose(found(before), [(100, 180, 150, 280)], atol=1.5)


@pytest.mark.parametrize(
    "before",
    [
        wall(()),
        wall(depth=-0.18),
        np.where(np.hypot(ROW - 150, COLUMN - 200) < 60, -0.2, 0.0),
        np.where((ROW > 60) & (np.abs(COLUMN - 200) < 0.6 * (ROW - 60)) & (ROW < 200), -0.2, 0.0),
        np.where(COLUMN < 150, -0.3, 0.0),
        wall(((40, 60, 52, 130),)),
    ],
    ids=["even", "before the wall", "round", "gable", "set back", "narrow"],
)
def test_what_is_no_opening_is_none(before: np.ndarray) -> None:
    assert len(found(before)) == 0


@pytest.mark.parametrize("noise,number", [(0.02, 1), (0.7, 0)], ids=["an even wall", "a noisy one"])
def test_an_opening_is_deeper_than_the_noise_of_its_wall(noise: float, number: int) -> None:
    """A place 1.2 ground pixels deep; the noise has so many ground pixels."""
    rough = cv2.GaussianBlur(np.random.default_rng(1).normal(0, 1, (HEIGHT, WIDTH)), (0, 0), 2.0)
    before = wall(((100, 60, 160, 140),), depth=1.2 * PIXEL) + noise * PIXEL * rough / rough.std()
    assert len(found(before)) == number


def test_of_two_openings_that_overlap_by_a_fifth_the_better_one_is_kept() -> None:
    window, foot, beside = np.array([0.0, 0, 10, 20]), np.array([-20.0, 16, 12, 24]), np.array([9.9, 0, 20, 20])
    openings = [Opening(0.7, foot, 1.0), Opening(0.95, window, 5.0), Opening(0.9, beside, 5.0)]
    assert without_doubles(openings) == [1, 2]


def test_a_hole_of_the_mesh_in_a_pane_is_no_outline() -> None:
    boxes = [np.array([40.0, 60, 90, 130])]
    hole = np.array([[45.0, 70], [80, 70], [80, 120], [45, 70]])
    assert is_within_opening(Chain(hole, 0, 1, (7, 7)), OUTLINE, boxes, 2.0)
    assert not is_within_opening(Chain(hole + 100, 0, 1, (7, 7)), OUTLINE, boxes, 2.0)
    foot = np.array([[40.0, 130], [90, 130]])  # of a door, below which there is nothing
    assert not is_within_opening(Chain(foot, 0, 1, (1, 2)), OUTLINE, boxes, 2.0)
    assert is_within_opening(Chain(foot, 1, 2, (1, 2)), STEP, boxes, 2.0)
