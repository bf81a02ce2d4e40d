# SPDX-License-Identifier: GPL-3.0-or-later
"""Which sides of a building are facades."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from support.finished_job import FinishedJob
from trimesh.transformations import rotation_matrix

from mgf_engine.drawings.facades import FacadeOptions, _peak, find_facades
from mgf_engine.drawings.load import read_survey
from mgf_engine.drawings.model import Survey
from mgf_engine.model.mesh import Mesh

PIXEL = 0.03  # metres on the building


@pytest.fixture(scope="module")
def survey(finished: FinishedJob) -> Survey:
    return read_survey(finished.folder)


def of(survey: Survey, *bodies: trimesh.Trimesh) -> Survey:
    """The survey with other bodies in it."""
    body = trimesh.util.concatenate(bodies)
    mesh = Mesh(np.array(body.vertices), np.array(body.faces, np.int32), np.zeros((len(body.vertices), 3), np.uint8))
    return replace(survey, mesh=mesh, normalised=mesh, pixel=PIXEL, working_pixel=PIXEL)


def box(x: float, y: float, z: float) -> trimesh.Trimesh:
    """A box that stands on the ground at the origin."""
    return trimesh.creation.box(bounds=[[0, 0, 0], [x, y, z]])


def turret(x: float, y: float, side: float, height: float, sides: int = 8) -> trimesh.Trimesh:
    """A turret of so many sides, two of which face the axis x."""
    body = trimesh.creation.cylinder(side / (2 * np.sin(np.pi / sides)), height, sections=sides)
    body.apply_transform(rotation_matrix(np.pi / sides, [0, 0, 1]))
    body.apply_translation([x, y, height / 2])
    return body


def directions(survey: Survey) -> list[int]:
    return sorted(round(facade.direction) % 360 for facade in find_facades(survey))


def test_narrow_sides_of_turrets_are_no_facades(survey: Survey) -> None:
    """Those of two turrets face south-east together with 15 % of the largest wall's area, in two narrow planes."""
    house = of(survey, box(12, 6, 5), turret(0, 0, 0.55, 9), turret(12, 0, 0.55, 9))
    assert directions(house) == [0, 90, 180, 270]


def test_all_sides_of_a_tower_with_many_sides_are_facades(survey: Survey) -> None:
    assert directions(of(survey, turret(0, 0, 3, 9))) == [0, 45, 90, 135, 180, 225, 270, 315]


def test_the_largest_side_is_a_facade_even_if_it_is_small(survey: Survey) -> None:
    """A small hut seen beside a mast that is far higher."""
    found = directions(of(survey, box(2, 2, 2), turret(1, 1, 0.03, 60, 64)))
    assert 0 in found or 90 in found


@pytest.mark.parametrize("more", [(0.0, 0.0), (1e-13, 0.0), (0.0, 1e-13)])
def test_rounding_does_not_choose_between_equal_walls(more: tuple[float, float]) -> None:
    assert _peak(np.array([0.0, 180.0]), 12.0 + np.array(more), FacadeOptions()) == 180.25
