# SPDX-License-Identifier: GPL-3.0-or-later
import numpy as np
import pytest

from mgf_engine.field import filter3d
from mgf_engine.field.filter3d import finest_sampling
from mgf_engine.model.scene import View


def view(x: float, fx: float = 100.0, turn: float = 0.0) -> View:
    c, s = np.cos(turn), np.sin(turn)
    rotation = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
    centre = np.array([x, 0.0, 0.0])
    return View("a", "a", 80, 60, fx, 90.0, 35.0, 32.0, rotation, -rotation @ centre, 80, 60)


def one_by_one(points: np.ndarray, views: list[View]) -> np.ndarray:
    """The reference: every point in every view, float64."""
    rate = np.zeros(len(points))
    for row, point in enumerate(points):
        for v in views:
            uv, depth = v.project(point[None])
            margin = 0.15 * max(v.width, v.height)
            u, w = uv[0]
            if depth[0] > 1e-3 and -margin < u < v.width + margin and -margin < w < v.height + margin:
                rate[row] = max(rate[row], max(v.fx, v.fy) / depth[0])
    return rate


@pytest.mark.parametrize("threads", [1, 3])
def test_finest_sampling_is_that_of_the_nearest_sharpest_view(threads: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(filter3d, "_TABLE", 300)  # several blocks
    points = np.random.default_rng(0).uniform(-3, 3, (500, 3))
    views = [view(0), view(1.0, 60.0, 0.4), view(-2.0, 130.0, -2.0)]
    found = finest_sampling(points.astype(np.float32), views, threads)
    expected = one_by_one(points, views)
    assert (expected == 0).any() and (expected > 0).any()
    np.testing.assert_allclose(found, expected, rtol=2e-5)


def test_no_points() -> None:
    assert finest_sampling(np.zeros((0, 3), np.float32), [view(0)]).shape == (0,)
