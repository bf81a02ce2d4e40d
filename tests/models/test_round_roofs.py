# SPDX-License-Identifier: GPL-3.0-or-later
"""Roofs in no plane become a pyramid of four planes, or a level one."""

from __future__ import annotations

import numpy as np
import pytest

from mgf_engine.drawings.model import DrawingFrame
from mgf_engine.drawings.project import Grid
from mgf_engine.models.solid.evidence_options import EvidenceOptions
from mgf_engine.models.solid.round_roofs import add_round_roofs

PIXEL, SIDE, DETAIL = 0.1, 100, 0.3
NO_PLANES = np.zeros((0, 3))


def grid() -> Grid:
    frame = DrawingFrame("plan", np.zeros(3), np.eye(3)[0], np.eye(3)[1], np.zeros(2), np.full(2, PIXEL * SIDE))
    return Grid(frame, PIXEL, 0.0, PIXEL * SIDE, SIDE, SIDE)


def places() -> np.ndarray:
    row, column = np.mgrid[:SIDE, :SIDE] + 0.5
    return grid().places(np.stack([column, row], -1))


def cone(slope: float) -> tuple[np.ndarray, np.ndarray]:
    """Heights of a cone of 4 m around (5, 5), 10 m high, and where it stands."""
    away = np.linalg.norm(places() - 5.0, axis=-1)
    return np.where(away < 4, 10 - slope * away, np.nan), away < 4


def test_a_cone_becomes_a_pyramid_of_four_planes() -> None:
    height, inside = cone(1.0)
    label = np.zeros(height.shape, np.int32)
    slopes = add_round_roofs(label, NO_PLANES, height, inside, grid(), DETAIL, 0.0)
    assert len(slopes) == 4 and set(np.unique(label)) == {0, 1, 2, 3, 4}
    towards = sorted(np.round(np.degrees(np.arctan2(-slopes[:, 1], -slopes[:, 0])) % 360).tolist())
    assert towards == pytest.approx([0, 90, 180, 270], abs=2)
    own = label[inside] > 0
    assert own.mean() > 0.95
    plane = slopes[label[inside][own] - 1]
    made = (places()[inside][own] * plane[:, :2]).sum(1) + plane[:, 2]
    assert np.abs(made - height[inside][own]).mean() < 0.3
    # The peak is where the cone has it.
    assert slopes @ np.array([5.0, 5.0, 1.0]) == pytest.approx(10.0, abs=0.5)


def test_the_sides_of_the_pyramid_are_those_of_the_walls() -> None:
    height, inside = cone(1.0)
    slopes = add_round_roofs(np.zeros(height.shape, np.int32), NO_PLANES, height, inside, grid(), DETAIL, np.pi / 4)
    towards = sorted((np.degrees(np.arctan2(-slopes[:, 1], -slopes[:, 0])) % 90).tolist())
    assert towards == pytest.approx([45] * 4, abs=2)


def test_a_flat_dome_is_level() -> None:
    height, inside = cone(0.1)
    label = np.zeros(height.shape, np.int32)
    (plane,) = add_round_roofs(label, NO_PLANES, height, inside, grid(), DETAIL, 0.0)
    assert plane == pytest.approx([0, 0, np.nanmedian(height)], abs=0.02)


def test_planes_that_are_known_stay_and_small_parts_get_none() -> None:
    height, inside = cone(1.0)
    label = np.where(inside, 1, 0).astype(np.int32)
    label[48:52, 48:52] = 0  # 0.4 m, less than 16 squared details
    before = label.copy()
    slopes = add_round_roofs(label, np.array([[0.0, 0.0, 8.0]]), height, inside, grid(), DETAIL, 0.0)
    assert slopes.tolist() == [[0.0, 0.0, 8.0]] and (label == before).all()
    found = add_round_roofs(
        label, slopes, height, inside, grid(), DETAIL, 0.0, EvidenceOptions(round_least=0.5, round_opening=0.1)
    )
    assert len(found) > 1 and found[0].tolist() == [0.0, 0.0, 8.0] and (label[50, 50] > 1)


def test_what_was_not_seen_from_above_gets_no_planes() -> None:
    height, inside = cone(1.0)
    label = np.zeros(height.shape, np.int32)
    assert len(add_round_roofs(label, NO_PLANES, np.full_like(height, np.nan), inside, grid(), DETAIL, 0.0)) == 0
    assert not label.any()
