# SPDX-License-Identifier: GPL-3.0-or-later
"""Arched heads: their geometry, what the contour of a mesh proposes, and what photos decide."""

from __future__ import annotations

import numpy as np
import pytest

from mgf_engine.openings.arches import (
    ArchOptions,
    Proposals,
    arch_drop,
    arch_outline,
    arch_places,
    arch_radius,
    contour_rise,
    crown_above,
    find_heads,
    heads_of_contours,
)
from mgf_engine.openings.detection import OpeningDetectionOptions, openings_in
from mgf_engine.openings.locate import locate_openings
from mgf_engine.openings.photo_edges import EdgePhotos
from tests.openings.test_photo_edges import CENTRES, FRAME, PIXEL, photo_of, view_from

OPTIONS = OpeningDetectionOptions()
WIDTH = 30.0
BOX = np.array([40.0, 90.0, 70.0, 30.0])  # left, top, right, bottom, y up


@pytest.mark.parametrize("rise", [3.0, 8.0, 15.0])
def test_a_head_is_a_segment_of_a_circle(rise: float) -> None:
    drop = arch_drop(np.array([0.0, WIDTH / 2, -WIDTH / 2, WIDTH]), WIDTH, rise)
    np.testing.assert_allclose(drop, [0, rise, rise, rise], atol=1e-9)
    ring = arch_outline(BOX, rise, 1.0)
    radius = arch_radius(WIDTH, rise)
    centre = np.array([55.0, 90.0 - radius])
    np.testing.assert_allclose(np.linalg.norm(ring[:-2] - centre, axis=1), radius, atol=1e-9)
    np.testing.assert_allclose(ring[[0, -3, -2, -1]], [(40, 90 - rise), (70, 90 - rise), (70, 30), (40, 30)])
    steps = np.linalg.norm(np.diff(ring[:-2], axis=0), axis=1)
    np.testing.assert_allclose(steps, steps[0])
    assert steps[0] < 1.5


def test_a_level_head_is_a_line() -> None:
    assert arch_drop(np.array([0.0, 20.0]), WIDTH, 0.0).tolist() == [0.0, 0.0]
    assert arch_places(WIDTH, 0.0, 1.0).tolist() == [-15.0, 15.0] and crown_above(WIDTH, 0.0) == 0
    assert arch_outline(BOX, 0.0, 1.0).tolist() == [[40, 90], [70, 90], [70, 30], [40, 30]]


def wall(rise: float, slope: float = 2.0, width: float = WIDTH, pixels: int = 2) -> np.ndarray:
    """Depths of a wall with an opening 3 deep that the map slopes into, ``pixels`` to a ground pixel."""
    row, column = (np.mgrid[: 120 * pixels, : 110 * pixels] + 0.5) / pixels
    away = column - 55.0
    inward = np.minimum(width / 2 - np.abs(away), np.minimum(row - 30 - arch_drop(away, width, rise), 90 - row))
    return (3.0 * np.clip(0.5 + inward / (2 * slope), 0, 1)).astype(np.float32)


@pytest.mark.parametrize("share", [0.2, 0.35, 0.5])
def test_the_contour_proposes_an_arch(share: float) -> None:
    (one,) = openings_in(wall(share * WIDTH), 1.0, 0.5, 1e6, OPTIONS)
    assert one.rise / 2 == pytest.approx(share * WIDTH, abs=2.2)
    np.testing.assert_allclose(one.box[[0, 2, 3]] / 2, [40, 70, 90], atol=0.6)


def test_the_contour_of_a_rectangle_proposes_none() -> None:
    (one,) = openings_in(wall(0.0), 1.0, 0.5, 1e6, OPTIONS)
    assert one.rise == 0 and one.level


def test_a_round_window_is_neither() -> None:
    row, column = np.mgrid[:120, :160] + 0.5
    assert list(openings_in(np.where(np.hypot(column - 60, row - 60) < 25, 3.0, 0.0), 1.0, 1.0, 1e6, OPTIONS)) == []


def test_a_semicircle_is_no_rectangle_where_corners_count() -> None:
    (one,) = openings_in(wall(20.0, width=40.0), 1.0, 0.5, 1e6, OPTIONS)
    assert not one.level and one.rise > 0


@pytest.mark.parametrize("change", [{"width": 40.0}, {"rise": 16.0}, {"contour": 0.0}])
def test_options_say_what_an_arch_is(change: dict[str, float]) -> None:
    share = wall(15.0) / 3.0
    box = np.array([80.0, 61.5, 140.0, 180.0])
    assert contour_rise(share, box, 2.0, ArchOptions()) > 0
    assert contour_rise(share, box, 2.0, ArchOptions(**change)) == 0


WINDOW = np.array([2.0, 3.4, 3.6, 0.9])  # left, top, right, bottom on the wall, metres


def painted(rise: float) -> EdgePhotos:
    """Photos of a dark pane with such a head, flat on the wall."""
    left, top, right, bottom = WINDOW

    def dark(x: np.ndarray, z: np.ndarray) -> np.ndarray:
        head = top - arch_drop(x - 0.5 * (left + right), right - left, rise)
        return (x > left) & (x < right) & (z > bottom) & (z < head)

    views = [view_from(centre) for centre in CENTRES]
    pictures = [photo_of(view, dark) for view in views]
    return EdgePhotos(views, pictures.__getitem__, lambda k, points, _: np.ones(len(points), bool))


def proposals(rise: float, level: bool = True) -> Proposals:
    """The window, its level head in the middle of an arched one's, as the mesh has it."""
    box = WINDOW - [0, crown_above(1.6, 0.8), 0, 0]
    return Proposals(box[None], np.array([rise]), np.array([level]), [1])


@pytest.mark.parametrize(("true", "rise"), [(0.8, 0.5), (0.3, 0.8), (0.45, 0.45)])
def test_photos_tell_the_rise(true: float, rise: float) -> None:
    found = locate_openings(proposals(rise), {1: FRAME}, PIXEL, painted(true))
    assert found.found.all() and found.rises[0] == pytest.approx(true, abs=0.08)
    np.testing.assert_allclose(found.boxes[0], WINDOW, atol=1.2 * PIXEL)


def test_photos_that_show_a_level_head_have_the_last_word() -> None:
    photos = painted(0.0)
    found = locate_openings(proposals(0.8), {1: FRAME}, PIXEL, photos)
    assert found.rises[0] == 0 and found.found[0]
    np.testing.assert_allclose(found.boxes[0], WINDOW, atol=1.2 * PIXEL)
    assert not locate_openings(proposals(0.8, level=False), {1: FRAME}, PIXEL, photos).found[0], "neither"


def test_without_photos_only_what_has_no_level_head_is_arched() -> None:
    for level in (True, False):
        rises = heads_of_contours(proposals(0.8, level)).rises
        assert rises.tolist() == [0.0 if level else 0.8]
        assert locate_openings(proposals(0.8, level), {}, PIXEL, None).rises.tolist() == rises.tolist()


def test_photos_that_show_nothing_change_nothing() -> None:
    photos = painted(0.8)
    blind = EdgePhotos(photos.views, photos.photo, lambda k, points, _: np.zeros(len(points), bool))
    proposed = proposals(0.8, level=False)
    heads = find_heads(proposed, proposed.boxes, {1: FRAME}, PIXEL, blind)
    assert heads.rises.tolist() == [0.8] and heads.tops[0] == pytest.approx(WINDOW[1])


def test_openings_of_one_width_in_one_row_have_one_head() -> None:
    photos = painted(0.8)
    one = proposals(0.8)
    both = Proposals(np.repeat(one.boxes, 2, 0), np.array([0.8, 0.0]), np.array([True, True]), [1, 1])
    assert find_heads(both, both.boxes, {1: FRAME}, PIXEL, photos).rises.tolist() == [0.8, 0.8]
    narrow = both.boxes.copy()
    narrow[1, 2] -= 0.5
    assert find_heads(both._replace(boxes=narrow), narrow, {1: FRAME}, PIXEL, photos).rises.tolist() == [0.8, 0.0]
