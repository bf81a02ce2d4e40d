# SPDX-License-Identifier: GPL-3.0-or-later
"""Regions that are the noise of one wall become one, undersides belong to the wall; steps and leaning walls stay."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from mgf_engine.drawings.merge_regions import merge_regions
from mgf_engine.drawings.model import DrawingFrame
from mgf_engine.drawings.project import Grid, GridBuffers
from mgf_engine.drawings.regions import LOOSE, RegionMap

PIXEL = 0.1  # the map has two pixels to it
HEIGHT, WIDTH = 160, 200
WALL, OTHER, ROOF = 1, 2, 3
ROW, COLUMN = np.mgrid[:HEIGHT, :WIDTH]


def merge(label: np.ndarray, slope: np.ndarray, up: np.ndarray, level: bool = False) -> np.ndarray:
    """Labels after merging; the surface lies in the plane of each label, ``up`` is its normal's part upwards [H, W]."""
    x, y = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]) if level else np.array([0.0, 0.0, 1.0])
    size = np.array([WIDTH, HEIGHT]) * 0.5 * PIXEL
    grid = Grid(
        DrawingFrame("A", np.zeros(3), x, y, np.zeros(2), size), 0.5 * PIXEL, 0.0, float(size[1]), WIDTH, HEIGHT
    )
    at = grid.places(np.stack([COLUMN, ROW], -1) + 0.5)
    a, b, c = np.moveaxis(slope[np.minimum(label, len(slope)) - 1], -1, 0)
    before = np.where(label > 0, a * at[..., 0] + b * at[..., 1] + c, np.nan).astype(np.float32)
    face = np.where(label > 0, np.arange(label.size).reshape(label.shape), -1).astype(np.int32)
    survey = SimpleNamespace(working_pixel=PIXEL, normals=np.stack([np.zeros(label.size)] * 2 + [up.ravel()], 1))
    regions = RegionMap(grid, label.astype(np.int32), slope)
    merge_regions(regions, GridBuffers(grid, face, before), survey)  # type: ignore[arg-type]
    return regions.label


@pytest.mark.parametrize("pixels,merged", [(2.0, True), (-2.5, True), (3.5, False), (-8.0, False)])
def test_a_plane_that_hardly_stands_before_its_wall_is_that_wall(pixels: float, merged: bool) -> None:
    label = np.where((ROW > 40) & (ROW < 90) & (COLUMN > 30) & (COLUMN < 120), OTHER, WALL)
    slope = np.array([[0.0, 0, 0], [0, 0, pixels * PIXEL]])
    found = merge(label, slope, np.zeros(label.shape))
    np.testing.assert_array_equal(found, WALL if merged else label)


def test_a_tilted_plane_stays_where_it_parts_from_the_wall() -> None:
    label = np.where(COLUMN < 60, OTHER, WALL)  # a bay's side: 30 pixels wide
    for angle, merged in ((5.0, True), (30.0, False)):
        a = np.tan(np.radians(angle))
        slope = np.array([[0.0, 0, 0], [a, 0, -a * 60 * 0.5 * PIXEL]])
        found = merge(label, slope, np.zeros(label.shape))
        np.testing.assert_array_equal(found, WALL if merged else label)


def eaves(high: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A roof over an underside so many rows high, over a wall that stands 10 pixels back; the upper part of normals."""
    label = np.where(ROW < 40, ROOF, np.where(ROW - high < 40, OTHER, WALL))
    a = 10 * PIXEL / (high * 0.5 * PIXEL)
    foot = (HEIGHT - 40 - high) * 0.5 * PIXEL
    slope = np.array([[0.0, 0, 0], [0, a, -a * foot], [0, -1.5, 1.0 + 1.5 * (HEIGHT - 40) * 0.5 * PIXEL]])
    down = -a / np.hypot(a, 1)
    return label, slope, np.where(label == OTHER, down, np.where(label == ROOF, 0.8, 0.0))


@pytest.mark.parametrize("loose", [False, True])
def test_undersides_belong_to_the_wall_below(loose: bool) -> None:
    label, slope, up = eaves(24)
    if loose:
        label = np.where(label == OTHER, LOOSE, label)
    np.testing.assert_array_equal(merge(label, slope, up), np.where(ROW < 40, ROOF, WALL))


def test_a_high_wall_that_leans_outwards_stays() -> None:
    label, slope, up = eaves(80)
    np.testing.assert_array_equal(merge(label, slope, up), label)


def test_nothing_is_an_underside_from_above() -> None:
    label, slope, up = eaves(24)
    np.testing.assert_array_equal(merge(label, slope, up, level=True), label)
