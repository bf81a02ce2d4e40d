# SPDX-License-Identifier: GPL-3.0-or-later
import numpy as np
import pytest
import torch

from mgf_engine.errors import BadInput
from mgf_engine.field.initialise import SH_CONSTANT, initial_field
from mgf_engine.model.gaussians import rotation_matrices


def plane(normal: np.ndarray, count: int = 400) -> np.ndarray:
    u = np.cross(normal, [0.3, 0.5, 0.8])
    u /= np.linalg.norm(u)
    uv = np.random.default_rng(0).random((count, 2))
    return uv[:, :1] * u + uv[:, 1:] * np.cross(normal, u)


@pytest.mark.parametrize("normal", [[0, 0, 1.0], [0, 0, -1.0], [1.0, 0, 0], [0.6, -0.8, 0]])
def test_discs_lie_in_the_plane_and_face_the_camera(normal) -> None:
    normal = np.array(normal)
    points = plane(normal)
    field = initial_field(points, np.zeros((400, 3), np.uint8), np.broadcast_to(normal * 5, points.shape))
    axis = rotation_matrices(field.rotations)[:, :, 2].numpy()
    assert (axis @ normal > 0.99).all()
    scales = torch.exp(field.log_scales)
    assert bool((scales[:, 2] < scales[:, 0]).all())


def test_colors_come_back_from_the_constant_harmonic() -> None:
    colors = np.random.default_rng(0).integers(0, 256, (10, 3)).astype(np.uint8)
    points = np.random.default_rng(1).random((10, 3))
    field = initial_field(points, colors, points + 1)
    back = (field.sh[:, 0].numpy() * SH_CONSTANT + 0.5) * 255
    np.testing.assert_allclose(back, colors, atol=1e-3)


def test_a_lone_far_point_stays_small() -> None:
    points = np.r_[np.random.default_rng(0).random((100, 3)), [[1000.0, 0, 0]]]
    field = initial_field(points, np.zeros((101, 3), np.uint8), points + 1)
    assert float(torch.exp(field.log_scales).max()) < 2


def test_duplicate_points_give_finite_parameters() -> None:
    field = initial_field(np.zeros((50, 3)), np.zeros((50, 3), np.uint8), np.ones((50, 3)))
    for value in (field.positions, field.log_scales, field.rotations, field.sh):
        assert bool(torch.isfinite(value).all())


def test_too_few_points_are_refused() -> None:
    with pytest.raises(BadInput, match="Only 3 points"):
        initial_field(np.eye(3), np.zeros((3, 3), np.uint8), np.ones((3, 3)))
