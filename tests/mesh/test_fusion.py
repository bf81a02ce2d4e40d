# SPDX-License-Identifier: GPL-3.0-or-later
"""What many depth maps of a wall say together, when some of them say otherwise."""

from __future__ import annotations

import numpy as np
import pytest

from mgf_engine.mesh.fusion import FusedField
from mgf_engine.mesh.isosurface import FREE, SOLID
from mgf_engine.mesh.photometric import Surface
from mgf_engine.scene.model import View

from .analytic import HEIGHT, WIDTH, camera

COUNT = 24
DEEPER = 10.0  # pixels


def wall_views() -> list[View]:
    """Cameras in front of the wall y = 0."""
    return [camera((0.1 * (i - COUNT / 2), -4.0, 0.3), target=(0.1 * (i - COUNT / 2), 0.0, 0.3)) for i in range(COUNT)]


def wall_field(deeper: int) -> FusedField:
    """A wall in which ``deeper`` of the views see a hole of some pixels around the origin."""
    views = wall_views()

    def show(number: int) -> Surface:
        view = views[number]
        depth = np.full((HEIGHT, WIDTH), 4.0, np.float32)
        if number < deeper:
            column, row = view.project(np.zeros((1, 3)))[0][0]
            rows, columns = np.indices(depth.shape)
            depth[(abs(rows - row) < 6) & (abs(columns - column) < 6)] += DEEPER * 4 / view.fx
        normal = np.zeros((HEIGHT, WIDTH, 3), np.float32)
        normal[..., 2] = -1
        return Surface(view, np.zeros(depth.shape, np.uint8), depth, normal, np.zeros(depth.shape, bool))

    return FusedField(show, [np.ones((HEIGHT, WIDTH), np.uint8)] * COUNT)


def behind(pixels: float) -> np.ndarray:
    return np.array([[0.0, pixels * 4 / wall_views()[0].fx, 0.0]])


@pytest.mark.parametrize("pixels", [3, 5, 7])
def test_one_view_digs_no_hole_where_many_see_a_wall(pixels):
    assert wall_field(0).classify(behind(pixels))[0] == SOLID
    assert wall_field(1).classify(behind(pixels))[0] == SOLID
    assert wall_field(2).classify(behind(pixels))[0] == SOLID


def test_a_niche_that_a_few_views_look_into_stays_open():
    assert wall_field(6).classify(behind(5))[0] == FREE
    assert wall_field(6).classify(behind(DEEPER + 3))[0] == SOLID


def test_far_behind_a_surface_it_has_no_say():
    """What stands in front of a courtyard does not fill it, however many views see only that."""
    assert wall_field(0).classify(np.array([[0.0, -0.5, 0.0]]))[0] == FREE
    field = wall_field(1)
    field.maps[0].pixels[..., 0] = 8.0
    assert field.classify(np.array([[0.0, 2.0, 0.0]]))[0] == FREE
