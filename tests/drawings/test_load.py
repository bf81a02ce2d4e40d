# SPDX-License-Identifier: GPL-3.0-or-later
"""The direction up of a mesh without georeference: by its walls, near that of the cameras."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from mgf_engine.drawings.load import UpOptions, up_from_walls
from mgf_engine.model.mesh import Mesh

Z = np.array([0.0, 0.0, 1.0])


def tilted(degrees: float, shape: trimesh.Trimesh | None = None) -> tuple[Mesh, np.ndarray]:
    """A block of 6 x 4 x 3 (or another shape) that leans about an axis of no wall, and its up."""
    turn = Rotation.from_rotvec(np.radians(degrees) * np.array([0.6, 0.8, 0.0])).as_matrix()
    block = trimesh.creation.box((6, 4, 3)) if shape is None else shape
    faces = np.asarray(block.faces, np.int32)
    return Mesh(block.vertices @ turn.T, faces, np.zeros((len(block.vertices), 3), np.uint8)), turn @ Z


def angle(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.degrees(np.arccos(np.clip(one @ other, -1, 1))))


@pytest.mark.parametrize("degrees", [5.0, 30.0, 100.0])
def test_walls_correct_what_cameras_say(degrees: float) -> None:
    mesh, up = tilted(degrees)
    guess = Rotation.from_rotvec(np.radians([0.0, 3.0, 0.0])).apply(up)
    found = up_from_walls(mesh, guess)
    assert angle(found, up) < 0.1 < angle(guess, up) and np.linalg.norm(found) == pytest.approx(1.0)


@pytest.mark.parametrize(("degrees", "exact"), [(0.0, True), (0.8, True), (1.3, False)])
def test_up_near_an_axis_is_that_axis(degrees: float, exact: bool) -> None:
    mesh, up = tilted(degrees)
    found = up_from_walls(mesh, up)
    assert (found == Z).all() == exact
    assert angle(found, up) <= degrees + 1e-6
    downwards = up_from_walls(mesh, -up)
    assert downwards @ found == pytest.approx(-1.0, abs=1e-9)


def test_without_walls_the_cameras_count() -> None:
    plate, _ = tilted(20.0, trimesh.creation.box((6, 4, 0.01)))
    guess = np.array([0.1, 0.2, 1.0]) / np.linalg.norm([0.1, 0.2, 1.0])
    assert up_from_walls(plate, guess, UpOptions()) is guess
