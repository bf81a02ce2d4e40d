# SPDX-License-Identifier: GPL-3.0-or-later
"""Edges of openings from photos: where the wall has them, not reveal or frame, however far off the mesh is."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from support.rays import pixel_rays

from mgf_engine.model.scene import View
from mgf_engine.openings.photo_edges import EdgePhotos, OpeningEdgeOptions, move_edges, wall_side_edge
from mgf_engine.openings.wall_frame import WallFrame

PIXEL = 0.04  # metres on the wall
FRAME = WallFrame(np.zeros(3), np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]]))
WINDOW = np.array([2.03, 1.51, 3.26, 3.11])  # left, low, right, high on the wall, metres
DEPTH, BAR = 0.2, 0.07
WALL, REVEAL, BARS, PANE = (200, 190, 170), (150, 140, 125), (235, 235, 230), (50, 60, 70)


def view_from(centre: tuple[float, float, float]) -> View:
    """A camera that looks at the middle of the wall y = 0; its pixels are PIXEL large there."""
    forward = np.array([3.0, 0.0, 2.4]) - centre
    far = float(np.linalg.norm(forward))
    forward /= far
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    return View(
        name="p", file="p", width=160, height=130, fx=far / PIXEL, fy=far / PIXEL, cx=80.0, cy=65.0, rotation=rotation,
        translation=-rotation @ centre, original_width=160, original_height=130,
    )  # fmt: skip


Shape = Callable[[np.ndarray, np.ndarray], np.ndarray]


def photo_of(view: View, dark: Shape | None = None) -> np.ndarray:
    """What the camera sees of the wall y = 0 and its window, from nine rays a pixel; or of a dark shape on it."""
    row, column = np.mgrid[: view.height, : view.width]
    total = np.zeros((row.size, 3))
    for u in (-1 / 3, 0, 1 / 3):
        for v in (-1 / 3, 0, 1 / 3):
            rays = pixel_rays(view, row.ravel() + v, column.ravel() + u)  # type: ignore[arg-type]
            total += _colors(view, rays) if dark is None else _painted(view, rays, dark)
    return np.rint(total / 9).astype(np.uint8).reshape(view.height, view.width, 3)


def _colors(view: View, rays: np.ndarray) -> np.ndarray:
    left, low, right, high = WINDOW
    front, back = (view.centre + rays * ((y - view.centre[1]) / rays[:, 1])[:, None] for y in (0.0, DEPTH))
    inside = [(p[:, 0] > left) & (p[:, 0] < right) & (p[:, 2] > low) & (p[:, 2] < high) for p in (front, back)]
    x, z = back[:, 0], back[:, 2]
    bar = np.minimum(np.minimum(x - left, right - x), np.minimum(z - low, high - z)) < BAR
    colors = np.where(inside[1][:, None], np.where(bar[:, None], BARS, PANE), REVEAL)
    return np.where(inside[0][:, None], colors, WALL).astype(np.float64)


def _painted(view: View, rays: np.ndarray, dark: Shape) -> np.ndarray:
    at = view.centre - rays * (view.centre[1] / rays[:, 1])[:, None]
    return np.where(dark(at[:, 0], at[:, 2])[:, None], PANE, WALL).astype(np.float64)


CENTRES = [(x, -9.0, z) for x in (-5.0, -1.0, 3.0, 7.0, 11.0) for z in (1.5, 7.0)]


@pytest.fixture(scope="module")
def photos() -> EdgePhotos:
    views = [view_from(centre) for centre in CENTRES]
    pictures = [photo_of(view) for view in views]
    return EdgePhotos(views, pictures.__getitem__, lambda k, points, _: np.ones(len(points), bool))


def moved(off: tuple[float, float, float, float], photos: EdgePhotos) -> np.ndarray:
    """Left, low, right, high in ground pixels from the truth, after a start that is off by so many, all outwards."""
    outward = np.array([-1.0, -1.0, 1.0, 1.0])
    left, low, right, high = WINDOW + outward * off * np.array(PIXEL)
    found = move_edges(np.array([[left, high, right, low]]), [1], {1: FRAME}, PIXEL, photos)[0]
    return outward * (found[[0, 3, 2, 1]] - WINDOW) / PIXEL


@pytest.mark.parametrize("off", [(0, 0, 0, 0), (-2, 0.5, -1.5, -3), (0.8, -1, -1.8, -1), (0, 0, 0, -3.5)])
def test_edges_come_to_where_the_wall_has_them(off: tuple[float, float, float, float], photos: EdgePhotos) -> None:
    left, low, right, high = moved(off, photos)
    assert max(abs(left), abs(right), abs(high)) < 0.5
    assert low == pytest.approx(off[1])  # photos see sills from above


def test_edges_that_no_photo_shows_stay(photos: EdgePhotos) -> None:
    nothing = EdgePhotos(photos.views, photos.photo, lambda k, points, _: np.zeros(len(points), bool))
    off = (-2.0, 0.5, 1.0, -3.0)
    np.testing.assert_allclose(moved(off, nothing), off, atol=1e-9)


def test_of_two_gradients_the_one_that_falls_off_towards_the_wall_near_the_expected_place_counts() -> None:
    offsets = np.arange(-7, 7.1, 0.25)

    def bump(at: float, height: float) -> np.ndarray:
        return height * np.exp(-0.5 * ((offsets - at) / 0.6) ** 2)

    shoulder = bump(1.0, 1.0) + bump(-0.6, 0.55)  # frame behind the edge
    assert wall_side_edge(shoulder, offsets) == pytest.approx(1.0 + 0.6 * 1.177 - 0.6, abs=0.1)
    surround = bump(1.0, 1.0) + bump(5.0, 1.0)
    assert wall_side_edge(surround, offsets) == pytest.approx(1.1, abs=0.1)
    assert wall_side_edge(np.zeros_like(offsets), offsets) == 0.0
    steep = OpeningEdgeOptions(prominence=0.99)
    assert wall_side_edge(0.1 + surround, offsets, steep) == 0.0
