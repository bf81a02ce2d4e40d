# SPDX-License-Identifier: GPL-3.0-or-later
"""Sky seen through an arch, and sky mirrored in a closed wall at the same place."""

from __future__ import annotations

import numpy as np
import pytest

from mgf_engine.masks.refinement.mirrored_sky import MirroredSkyOptions, find_mirrored_sky
from mgf_engine.model.masks import BUILDING, IGNORE
from mgf_engine.model.scene import View
from tests.support.analytic import ring
from tests.support.rays import pixel_rays
from tests.support.small_scene import make_scene

VIEWS = ring(80, radius=5.0, elevations=(0.1, 0.2, 0.3, 0.2))
FACING = 20  # looks along the passage
HALF, PASSAGE = np.array([1.0, 0.4, 0.8]), np.array([0.5, 9.0, 0.5])
CORNERS = HALF * np.stack(np.meshgrid(*[(-1, 1)] * 3), -1).reshape(-1, 3)


def seen(view: View, open_: bool) -> np.ndarray:
    """Label map of a block, with a passage through it or closed."""
    rows, columns = np.indices((view.height, view.width)).reshape(2, -1)
    rays = pixel_rays(view, rows, columns)
    enter, leave = crossing(view, rays, HALF)
    solid = leave > enter
    if open_:
        first, last = crossing(view, rays, PASSAGE)
        solid &= (enter < first) | (leave > last)
    return solid.reshape(view.height, view.width).astype(np.uint8) * BUILDING


def crossing(view: View, rays: np.ndarray, half: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where rays [N, 3] enter and leave a block around the origin, [N] each; they miss it if they leave first."""
    ends = np.stack([(side * half - view.centre) / rays for side in (-1, 1)])
    return ends.min(0).max(1), ends.max(0).min(1)


CLOSED = [seen(view, False) for view in VIEWS]
OPEN = [seen(view, True) for view in VIEWS]
HOLES = [(closed > 0) & (opened == 0) for closed, opened in zip(CLOSED, OPEN, strict=True)]


def mirrored(labels: list[np.ndarray], holes: np.ndarray, points: np.ndarray = CORNERS, index: int = FACING, **options):
    scene, everywhere = make_scene(VIEWS, points, [[] for _ in points]), range(len(VIEWS))
    return find_mirrored_sky(scene, index, holes, labels, everywhere, points, MirroredSkyOptions(**options))


def test_nothing_is_mirrored_where_there_is_nothing_to_ask() -> None:
    assert not mirrored(CLOSED, np.zeros_like(HOLES[FACING])).any()
    assert not mirrored(CLOSED, HOLES[FACING], np.zeros((0, 3))).any()
    assert not mirrored(CLOSED, HOLES[FACING], least_views=len(VIEWS)).any()


def test_sky_through_an_arch_stays_a_hole() -> None:
    assert HOLES[FACING].sum() > 100
    assert not mirrored(OPEN, HOLES[FACING]).any()


def panes_cut(count: int) -> list[np.ndarray]:
    """Label maps of the closed block, of which some photos beside each other take a pane for sky."""
    labels = [label.copy() for label in CLOSED]
    for index in (FACING, FACING + 1, FACING - 1, FACING + 2, FACING - 2)[:count]:
        labels[index][HOLES[index]] = 0
    return labels


@pytest.mark.parametrize("photos", [1, 2, 3])
def test_sky_in_panes_is_mirrored(photos: int) -> None:
    """Also where other photos are wrong about the same pane."""
    assert (mirrored(panes_cut(photos), HOLES[FACING]) == HOLES[FACING]).all()


def test_a_hole_in_more_photos_than_the_share_allows_is_sky() -> None:
    labels = panes_cut(5)
    assert not mirrored(labels, HOLES[FACING]).any()
    assert (mirrored(labels, HOLES[FACING], held=0.8) == HOLES[FACING]).all()


def test_each_hole_is_tested_by_itself() -> None:
    """A pane beside the arch."""
    pane = np.zeros_like(HOLES[FACING])
    middle = np.argwhere(CLOSED[FACING] > 0).mean(0).astype(int)
    edge = np.flatnonzero(CLOSED[FACING][middle[0]])[0]
    pane[middle[0] - 4 : middle[0] + 4, edge + 3 : edge + 9] = True
    assert not (pane & HOLES[FACING]).any()
    assert (mirrored(OPEN, HOLES[FACING] | pane) == pane).all()


def test_ignored_pixels_are_not_asked() -> None:
    """All but four photos are hidden by trees."""
    labels = [np.full_like(label, IGNORE) for label in CLOSED]
    for index in (0, 2, 8, 12):
        labels[index] = CLOSED[index]
    assert (mirrored(labels, HOLES[FACING]) == HOLES[FACING]).all()
