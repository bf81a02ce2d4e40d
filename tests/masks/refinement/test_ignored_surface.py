# SPDX-License-Identifier: GPL-3.0-or-later
"""A door that all photos ignore is the building; what hides another part of the wall in each photo is not."""

from __future__ import annotations

import numpy as np
import pytest

from mgf_engine.masks.prompts import Clicks, Prompts
from mgf_engine.masks.refinement.ignored_surface import IgnoredSurfaceOptions, find_ignored_surface
from mgf_engine.model.masks import BACKGROUND, BUILDING, IGNORE
from tests.support.small_scene import make_scene, view

VIEWS = [view(f"{i}.jpg", 0.1 * i) for i in range(4)]
X, Y = np.meshgrid(np.linspace(-0.9, 0.9, 19), np.linspace(-0.4, 0.4, 9))
WALL = np.stack([X.ravel(), Y.ravel(), np.ones(X.size)], 1)  # before the cameras
SEEN = [v.project(WALL)[0] for v in VIEWS]
INSIDE = [((uv >= 0) & (uv < (20, 10))).all(1) for uv in SEEN]
SCENE = make_scene(
    VIEWS, WALL, [[(i, *SEEN[i][p]) for i in range(len(VIEWS)) if INSIDE[i][p]] for p in range(len(WALL))]
)

NO_CLICKS: Prompts = {}
BARE = np.zeros((10, 20), bool)


def masks(left: float | list[float]) -> list[np.ndarray]:
    """Label maps of the wall, 0.5 of it ignored from ``left`` on: at the same place, or at another in each photo."""
    result = []
    for index, x in enumerate(np.broadcast_to(left, len(VIEWS))):
        label = np.full((10, 20), BUILDING, np.uint8)
        begin = round(float(VIEWS[index].project(np.array([[x, 0.0, 1.0]]))[0][0, 0]))
        label[:, begin : begin + 5] = IGNORE
        result.append(label)
    return result


def found(
    labels: list[np.ndarray],
    on_surface: bool = True,
    voters: range = range(4),
    prompts: Prompts = NO_CLICKS,
    leaves: np.ndarray = BARE,
    **options: float,
) -> list[int]:
    """How many pixels of each mask are the building."""

    surface = [np.full(len(SCENE.observations(index)), on_surface) for index in range(len(VIEWS))]
    chosen = IgnoredSurfaceOptions(**options)  # type: ignore[arg-type]
    pieces = find_ignored_surface(SCENE, labels, surface, voters, prompts, lambda index: leaves, chosen)
    return [int(piece.sum()) for piece in pieces]


def test_what_all_photos_ignore_at_the_same_place_is_the_building() -> None:
    labels = masks(-0.2)
    surface = [np.ones(len(SCENE.observations(index)), bool) for index in range(len(VIEWS))]
    pieces = find_ignored_surface(SCENE, labels, surface, range(4), {}, lambda index: BARE)
    assert all((piece == (label == IGNORE)).all() for piece, label in zip(pieces, labels, strict=True))


def test_a_shrub_close_to_the_wall_is_not_though_all_photos_ignore_it() -> None:
    leaves = BARE.copy()
    leaves[7:] = True  # its other parts are too dark to look like leaves
    assert found(masks(-0.2), leaves=leaves) == [0, 0, 0, 0]


def test_what_hides_another_place_in_each_photo_stays_ignored() -> None:
    assert found(masks([-0.9, -0.4, 0.1, 0.4])) == [0, 0, 0, 0]


def test_a_photo_that_shows_the_place_as_something_else_contradicts() -> None:
    labels = masks(-0.2)
    labels[2][labels[2] == IGNORE] = BACKGROUND
    assert found(labels) == [0, 0, 0, 0]
    assert found(labels, voters=range(2), photos=2)[:2] == [50, 50], "its mask does not vote"


def test_a_click_beside_the_building_keeps_its_piece_ignored_in_all_photos() -> None:
    labels = masks(-0.2)
    inside = np.argwhere(labels[1] == IGNORE)[:1, ::-1] + 0.5
    assert found(labels, prompts={1: Clicks(np.zeros((0, 2)), inside)}) == [0, 0, 0, 0]


def test_a_hedge_beside_a_door_stays_ignored() -> None:
    """It hangs together with the door in one photo, in which the whole piece had become building."""
    labels = masks(-0.2)
    labels[0][:, : int(np.flatnonzero((labels[0] == IGNORE).any(0))[0])] = IGNORE
    assert found(labels, share=0.0) == [130, 50, 50, 50]
    assert found(labels) == [0, 50, 50, 50]


@pytest.mark.parametrize("change", [{"on_surface": False}, {"photos": 5}, {"points": 1000}])
def test_points_before_the_surface_few_photos_and_few_points_tell_nothing(change: dict[str, int]) -> None:
    assert found(masks(-0.2), **change) == [0, 0, 0, 0]  # type: ignore[arg-type]
