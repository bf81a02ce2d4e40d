# SPDX-License-Identifier: GPL-3.0-or-later
import numpy as np
import pytest

from mgf_engine.field.dense import dense_points
from mgf_engine.messages import Reporter
from mgf_engine.scene.depths import photo_at
from mgf_engine.scene.stereo import pair_depth


@pytest.mark.parametrize("offset", [[0.5, 0, 0], [-0.5, 0, 0], [0, 0.5, 0], [0, -0.5, 0], [0.35, 0.35, 0.1]])
@pytest.mark.parametrize("roll", [0.0, 1.2])
def test_depth_of_a_wall_is_found_for_any_direction_of_the_baseline(make_wall, offset, roll) -> None:
    scene, _ = make_wall([[0, 0, -3.0], [offset[0], offset[1], -3.0 + offset[2]]], [0.0, roll])
    first, second = photo_at(scene, 0, None, 500), photo_at(scene, 1, None, 500)
    depth = pair_depth(first, second, scene.points)
    assert depth is not None
    middle = depth[30:-30, 50:-50]
    known = middle > 0
    assert known.mean() > 0.7
    assert np.median(np.abs(middle[known] - 3.0)) < 0.02
    assert np.quantile(np.abs(middle[known] - 3.0), 0.95) < 0.1


def test_a_pair_without_baseline_or_points_gives_nothing(make_wall) -> None:
    scene, _ = make_wall([[0, 0, -3.0], [0, 0, -3.0]])
    first, second = photo_at(scene, 0, None, 500), photo_at(scene, 1, None, 500)
    assert pair_depth(first, second, scene.points) is None
    assert pair_depth(first, first, scene.points[:3]) is None


def test_dense_points_lie_on_the_wall_and_keep_to_the_limit(make_wall) -> None:
    scene, masks = make_wall([[x, y, -3.0] for x in (-0.5, 0, 0.5) for y in (0, 0.4)])
    points, colors, towards = dense_points(scene, masks, range(6), 2000, Reporter(), threads=2)
    assert 500 < len(points) <= 2100
    assert np.quantile(np.abs(points[:, 2]), 0.95) < 0.05
    assert colors.shape == points.shape
    assert (towards[:, 2] == -3.0).all()


def test_no_pair_fits_gives_no_points(make_wall) -> None:
    scene, masks = make_wall([[0, 0, -3.0], [0.01, 0, -3.0]])
    points, colors, towards = dense_points(scene, masks, range(2), 100, Reporter())
    assert points.shape == colors.shape == towards.shape == (0, 3)
