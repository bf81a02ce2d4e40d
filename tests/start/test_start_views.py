# SPDX-License-Identifier: GPL-3.0-or-later
"""Sparse points of the starting surface: those that enough photos saw inside of their masks, and by which photos."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.analytic import camera
from support.small_scene import make_scene

from mgf_engine.model.masks import BACKGROUND, BUILDING, IGNORE, MaskSet
from mgf_engine.start.options import ViewOptions
from mgf_engine.start.views import StartViews, start_views

CORNERS = np.stack(np.meshgrid([-0.5, 0.5], [-0.5, 0.5], [-0.5, 0.5]), -1).reshape(-1, 3)
VIEWS = [camera((5 * np.cos(a), 5 * np.sin(a), 1.0), name=f"{a:.1f}") for a in np.arange(6)]
SHORT, MASKED, ONCE_MASKED, OTHER = range(4)  # corners that differ from the rest
OPTIONS = replace(ViewOptions(), hull=replace(ViewOptions().hull, least_points=3))


def prepare(
    indices: list[int], label: int = BACKGROUND, options: ViewOptions = OPTIONS, half: tuple[int, ...] = ()
) -> StartViews:
    """A cube whose first corner two photos saw; the masks of three photos lack the second, that of one the third.

    Of the views ``half`` the mask has the right half only.
    """
    pixels = [view.project(CORNERS)[0] for view in VIEWS]
    tracks = [[(v, *pixels[v][k]) for v in range(2 if k == SHORT else 6)] for k in range(8)]
    labels = [np.full((view.height, view.width), BUILDING, np.uint8) for view in VIEWS]
    for corner, photos in ((MASKED, (1, 3, 5)), (ONCE_MASKED, (2,))):
        for v in photos:
            column, row = np.floor(pixels[v][corner]).astype(int)
            labels[v][row, column] = label
    for v in half:
        labels[v][:, : VIEWS[v].width // 2] = BACKGROUND
    on_building = np.arange(8) != OTHER
    masks = MaskSet(tuple(labels), np.ones(6, bool), np.ones(6, np.float32), on_building)
    return start_views(make_scene(VIEWS, CORNERS, tracks), masks, indices, options)


def test_points_need_photos_that_saw_them_and_masks_that_contain_them() -> None:
    views = prepare([0, 1, 2, 3, 4, 5])
    np.testing.assert_array_equal(views.points, CORNERS[[ONCE_MASKED, 4, 5, 6, 7]])
    assert [seen.tolist() for seen in views.seen] == [[0, 1, 2, 3, 4, 5]] * 5


def test_what_is_ignored_is_not_inside_either() -> None:
    np.testing.assert_array_equal(prepare([0, 1, 2, 3, 4, 5], IGNORE).points, CORNERS[[ONCE_MASKED, 4, 5, 6, 7]])


def test_views_are_numbered_by_their_place_in_the_list_and_others_have_no_say() -> None:
    views = prepare([4, 2, 0])  # whose masks all have the second corner
    np.testing.assert_array_equal(views.points, CORNERS[[MASKED, ONCE_MASKED, 4, 5, 6, 7]])
    assert [seen.tolist() for seen in views.seen] == [[0, 1, 2]] * 6
    assert [view.name for view in views.views] == [VIEWS[k].name for k in (4, 2, 0)]


@pytest.mark.parametrize("change", [{"least_track": 2}, {"track_share": 0.4}])
def test_how_many_photos_must_agree_is_an_option(change: dict[str, float]) -> None:
    options = replace(OPTIONS, **change)  # type: ignore[arg-type]
    assert len(prepare([0, 1, 2, 3, 4, 5], options=options).points) == 6


def test_a_pixel_is_that_of_the_photos_at_the_points() -> None:
    views = prepare([0, 1, 2, 3, 4, 5])
    depths = np.concatenate([view.project(views.points)[1] for view in VIEWS])
    assert views.pixel == pytest.approx(float(np.median(depths)) / VIEWS[0].fx)


@pytest.mark.parametrize("half", [(), (3,), (0, 4)])
def test_masks_that_cut_off_half_of_the_building_call_nothing_outside(half: tuple[int, ...]) -> None:
    sizes = prepare([0, 1, 2, 3, 4, 5], half=half).silhouettes.sizes
    assert [k for k, size in enumerate(sizes) if not size.any()] == list(half)
