# SPDX-License-Identifier: GPL-3.0-or-later
from __future__ import annotations

import numpy as np
import pytest
import torch
from rendered import device_of, skip_without_gpu

from mgf_engine.errors import BadInput
from mgf_engine.model.gaussians import Gaussians
from mgf_engine.model.scene import View
from mgf_engine.native import library
from mgf_engine.raster.points import BACKGROUND, IGNORE, INSIDE, NEAR, OUTSIDE, SEEN, UNSEEN, PointOpacity, locate
from mgf_engine.raster.reference_points import opacity_of_points

TOLERANCE = 3e-5  # float32 quotients of quadratics, see csrc/raster/records.h


def field(count: int, seed: int = 0, scale: float = 0.1, spread: float = 0.7, opacity: float = 0.0) -> Gaussians:
    generator = torch.Generator().manual_seed(seed)

    def normal(*shape):
        return torch.randn(*shape, generator=generator)

    return Gaussians(
        positions=normal(count, 3) * 0.6,
        log_scales=float(np.log(scale)) + spread * normal(count, 3),
        rotations=normal(count, 4),
        opacity_logits=1.5 * normal(count) + opacity,
        sh=torch.zeros(count, 16, 3),
        filter_3d=torch.full((count,), 0.005),
    )


def view(distance: float = 4.0, width: int = 97, height: int = 71, focal: float = 90.0) -> View:
    translation = np.array([0.1, -0.05, distance])
    return View(
        "a", "a.png", width, height, focal, 1.05 * focal, width / 2 + 1.3, height / 2 - 2.1, np.eye(3), translation,
        width, height,
    )  # fmt: skip


def ask(gaussians, points, camera, stop=1e-4, mask=None, backend="cpu"):
    lowest = np.full((len(points), 2), 2.0, np.float32)
    mask = np.full((camera.height, camera.width), INSIDE, np.uint8) if mask is None else mask
    visibility = PointOpacity(gaussians.to(device_of(backend)), backend).lower(
        lowest, points.astype(np.float32), camera, mask, stop
    )
    return lowest, visibility


def cloud(count: int = 800, seed: int = 1, size: float = 0.8) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(count, 3)).astype(np.float32).astype(np.float64) * size


FIELDS = {
    "one": field(1, 1, 0.3),
    "many": field(300, 0, 0.1),
    "small": field(600, 2, 0.03),
    "huge": field(80, 3, 1.0),
    "needles": field(200, 4, 0.05, spread=1.6),
    "opaque": field(300, 5, 0.1, opacity=6.0),
    "transparent": field(300, 6, 0.1, opacity=-4.0),
}


@pytest.fixture(params=["cpu", "cuda-source-on-cpu", "cuda"])
def backend(request: pytest.FixtureRequest) -> str:
    skip_without_gpu(request.param)
    return request.param


@pytest.mark.parametrize("name", FIELDS)
@pytest.mark.parametrize("distance", [4.0, 0.3])  # 0.3: among the Gaussians, some behind and some near the camera
def test_matches_the_reference(name, distance, backend):
    camera, points = view(distance), cloud().astype(np.float32).astype(np.float64)
    lowest, visibility = ask(FIELDS[name], points, camera, backend=backend)
    seen = visibility == SEEN
    assert seen.sum() > 50
    expected = opacity_of_points(points[seen], FIELDS[name], camera, NEAR).numpy()
    error = np.abs(lowest[seen, 0] - expected)
    # a response that meets 1/255 in one and misses it in the other moves the result by at most 1/255
    assert np.quantile(error, 0.995) < TOLERANCE and error.max() < 2.1 / 255
    assert (lowest[seen, 1] == 2).all() and (lowest[~seen] == 2).all()


def test_pancakes_facing_away_and_edge_on(backend):
    flat = field(200, 7, 0.1)
    flat.log_scales[:, 2] = np.log(1e-4)
    flat.filter_3d[:] = 1e-4
    camera, points = view(), cloud().astype(np.float32).astype(np.float64)
    lowest, visibility = ask(flat, points, camera, backend=backend)
    seen = visibility == SEEN
    expected = opacity_of_points(points[seen], flat, camera, NEAR).numpy()
    # discs 0.002 of their size thick: float32 depths of points near their plane carry errors of 1e-7 / 1e-4 deviations
    assert np.quantile(np.abs(lowest[seen, 0] - expected), 0.98) < 1e-2


@pytest.mark.parametrize("size", [(1, 1), (17, 16), (33, 50), (160, 7)])
def test_odd_image_sizes(size, backend):
    camera, points = view(4.0, *size, focal=30.0), cloud().astype(np.float32).astype(np.float64)
    lowest, visibility = ask(FIELDS["many"], points, camera, backend=backend)
    seen = visibility == SEEN
    expected = opacity_of_points(points[seen], FIELDS["many"], camera, NEAR).numpy()
    error = np.abs(lowest[seen, 0] - expected)
    assert seen.any() and np.median(error) < TOLERANCE and error.max() < 2.1 / 255


def test_stopping_early_keeps_the_sign(backend):
    camera, points = view(), cloud(4000)
    exact = ask(FIELDS["many"], points, camera, backend=backend)[0][:, 0]
    early = ask(FIELDS["many"], points, camera, stop=0.5, backend=backend)[0][:, 0]
    assert ((exact >= 0.5) == (early >= 0.5)).all()
    assert (exact < 0.5).any() and (exact >= 0.5).any()


def test_two_smallest_are_kept_over_views(backend):
    points = cloud(500, size=0.3)
    cameras = [view(d) for d in (3.0, 4.0, 5.0, 6.0)]
    each = np.stack([ask(FIELDS["many"], points, c, backend=backend)[0][:, 0] for c in cameras])
    lowest = np.full((len(points), 2), 2.0, np.float32)
    asked = PointOpacity(FIELDS["many"].to(device_of(backend)), backend)
    for camera in cameras:
        asked.lower(lowest, points.astype(np.float32), camera, np.ones((camera.height, camera.width), np.uint8))
    assert np.array_equal(lowest, np.sort(each, 0)[:2].T)


def test_same_result_for_any_number_of_threads():
    points = cloud(3000)
    library.set_threads(1)
    alone = ask(FIELDS["many"], points, view())[0]
    library.set_threads(3)
    together = ask(FIELDS["many"], points, view())[0]
    library.set_threads(0)
    assert np.array_equal(alone, together)


def test_more_list_entries_than_32_bits_count_are_refused():
    """8,200 Gaussians around the camera that each touch all of 512 x 512 tiles: 2.15e9 entries."""
    wide = field(8200, 8, scale=1.0, spread=0.0, opacity=5.0)
    wide.positions[:] = torch.tensor([0.0, 0.0, 0.5])
    camera = view(0.0, 8192, 8192, focal=4000.0)
    middle = 16 * np.stack(np.meshgrid(np.arange(512), np.arange(512)), -1).reshape(-1, 2) + 8
    x, y = (middle - [camera.cx, camera.cy]).T / [[camera.fx], [camera.fy]] - camera.translation[:2, None]
    with pytest.raises(BadInput, match=r"touch 2,1\d+,.* tiles, more than the kernels can list; lower --resolution"):
        ask(wide, np.stack([x, y, np.ones_like(x)], 1), camera)


def test_visibility_by_the_mask():
    camera = view()
    mask = np.full((camera.height, camera.width), OUTSIDE, np.uint8)
    mask[:, 30:60] = INSIDE
    mask[:, 60:] = IGNORE
    points = np.array([[0, 0, 0], [-1.5, 0, 0], [1.5, 0, 0], [0, 0, -9], [50, 0, 0]], np.float32)
    located = locate(points, camera, mask)
    assert located.visibility.tolist() == [SEEN, BACKGROUND, UNSEEN, UNSEEN, UNSEEN]
    assert (located.block >= 0).tolist() == [True, False, False, False, False]
    uv, depth = camera.project(points[:1].astype(np.float64))
    assert np.allclose(located.place[0], [*uv[0], depth[0]], atol=1e-4)


def test_no_points_and_nothing_drawn(backend):
    empty = np.zeros((0, 3))
    assert ask(FIELDS["many"], empty, view(), backend=backend)[0].shape == (0, 2)
    faint = field(50, 8, 0.1, opacity=-20.0)
    lowest, visibility = ask(faint, cloud(100), view(), backend=backend)
    assert (lowest[visibility == SEEN, 0] == 0).all()


def test_mask_of_another_size_is_refused():
    with pytest.raises(ValueError, match="mask"):
        locate(np.zeros((1, 3), np.float32), view(), np.ones((5, 5), np.uint8))
