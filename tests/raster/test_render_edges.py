# SPDX-License-Identifier: GPL-3.0-or-later
"""Extreme Gaussians and frames: outputs and gradients agree with the reference and are finite."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from rendered import OUTPUTS, assert_agrees, assert_finite, camera, draw, gaussians, random_weights, run

from mgf_engine.model.gaussians import Gaussians
from mgf_engine.raster.api import Camera


def front_camera(width: int = 45, height: int = 35, near: float = 0.2) -> Camera:
    """At the origin, looking along +z, so that tests can place Gaussians by depth."""
    return Camera(width, height, 40.0, 42.0, width / 2, height / 2, np.eye(3), np.zeros(3), near)


def ahead(n: int, seed: int = 0, depth: float = 5.0, **options: float) -> Gaussians:
    field = gaussians(n, seed, **options)
    field.positions[:, 2] += depth
    return field


def behind_camera() -> Gaussians:
    field = ahead(30)
    field.positions[::2, 2] *= -1
    return field


def at_the_near_plane() -> Gaussians:
    """Centres on both sides of the near plane, with footprints larger than the frame."""
    field = ahead(12, spread=0.05, depth=0.0, log_scale=-3.0)
    field.positions[:, 2] = torch.linspace(0.11, 0.45, 12)
    return field


def off_screen() -> Gaussians:
    """Centres outside the frame, some reaching in and some not."""
    field = ahead(40, log_scale=-0.7)
    field.positions[:, 0] = torch.linspace(-9, 9, 40)
    field.positions[:, 1] = torch.linspace(7, -7, 40).roll(7)
    return field


def needles() -> Gaussians:
    field = ahead(20, filter_3d=0.0)
    field.log_scales[:] = torch.tensor([-7.5, -7.5, -0.5])
    return field


def pancakes() -> Gaussians:
    field = ahead(20, filter_3d=0.0)
    field.log_scales[:] = torch.tensor([-1.0, -1.3, -9.0])
    return field


def pancakes_edge_on() -> Gaussians:
    """Flat Gaussians whose plane almost holds the viewing ray."""
    field = ahead(8, spread=0.3, filter_3d=0.002)
    field.log_scales[:] = torch.tensor([-1.0, -1.0, -8.0])
    angle = torch.linspace(-0.02, 0.02, 8) + np.pi / 2  # about y
    field.rotations[:] = torch.stack([torch.cos(angle / 2), 0 * angle, torch.sin(angle / 2), 0 * angle], 1)
    return field


def huge() -> Gaussians:
    """Far larger than the frame; some reach the camera's plane or hold the camera."""
    field = ahead(8, spread=0.5)
    field.log_scales[:] = torch.linspace(0.0, 3.0, 8)[:, None] + torch.tensor([0.0, 0.2, -0.3])
    field.opacity_logits[:] = -1.0
    return field


def opaque() -> Gaussians:
    field = ahead(60, seed=2)
    field.opacity_logits[:] = torch.linspace(4.0, 60.0, 60)
    return field


def transparent() -> Gaussians:
    """Below, around and just above the 1/255 below which nothing is drawn."""
    field = ahead(60, seed=3)
    field.opacity_logits[:] = torch.linspace(-60.0, -4.0, 60)
    return field


def zero_quaternions() -> Gaussians:
    field = ahead(10)
    field.rotations[:5] = 0.0
    field.rotations[5:] *= torch.tensor([1e-9, 1e-5, 1.0, 1e5, 1e9])[:, None]
    return field


def vanishing_scales() -> Gaussians:
    """Scales that underflow; the filter keeps a size, and the opacity fades with the volume."""
    field = ahead(9, spread=0.3, filter_3d=0.1)
    field.log_scales[:] = torch.tensor([-200.0, -50.0, -20.0, -10.0, -4.0, -3.0, -2.5, -2.0, -1.0])[:, None]
    field.opacity_logits[:] = 3.0
    return field


def overflowing_scales() -> Gaussians:
    field = ahead(4, spread=0.3)
    field.log_scales[:] = torch.tensor([8.0, 20.0, 90.0, 200.0])[:, None]
    field.opacity_logits[:] = -1.0
    return field


def dark_colors() -> Gaussians:
    """Colours that the clamp at zero cuts off."""
    field = ahead(40, seed=5)
    field.sh *= 4.0
    return field


def equal_depths() -> Gaussians:
    """The same Gaussian several times: ties are kept in the order of the indices."""
    field = ahead(10, seed=6)
    field.positions[:] = field.positions[0].clone()
    return field


def none() -> Gaussians:
    return gaussians(0)


CASES: dict[str, Callable[[], Gaussians]] = {
    "behind camera": behind_camera,
    "near plane": at_the_near_plane,
    "off screen": off_screen,
    "needles": needles,
    "pancakes": pancakes,
    "pancakes edge-on": pancakes_edge_on,
    "huge": huge,
    "opaque": opaque,
    "transparent": transparent,
    "zero quaternions": zero_quaternions,
    "vanishing scales": vanishing_scales,
    "overflowing scales": overflowing_scales,
    "dark colours": dark_colors,
    "equal depths": equal_depths,
    "none": none,
}


@pytest.mark.parametrize("case", CASES)
def test_edge_case(backend: str, case: str) -> None:
    found = assert_agrees(CASES[case](), front_camera(), backend, "needle" if case == "needles" else "plain")
    if case != "none":
        assert found.rendering.alpha.max() > 0.01, "the case shows nothing, so it tests nothing"


@pytest.mark.parametrize("size", [(1, 1), (16, 16), (17, 3), (3, 17), (32, 31), (49, 33)])
def test_odd_sizes(backend: str, size: tuple[int, int]) -> None:
    assert_agrees(ahead(60, seed=8, spread=0.4), front_camera(*size), backend)


MASKS = {
    "empty": torch.zeros(3, 3, dtype=torch.bool),
    "full": torch.ones(3, 3, dtype=torch.bool),
    "one tile": torch.tensor([[0, 0, 0], [0, 1, 0], [0, 0, 0]]),
    "checkered": torch.tensor([[1, 0, 1], [0, 1, 0], [1, 0, 1]], dtype=torch.uint8),
}


@pytest.mark.parametrize("mask", MASKS)
def test_tile_masks(backend: str, mask: str) -> None:
    found = assert_agrees(ahead(80, seed=9), front_camera(), backend, tile_mask=MASKS[mask]).rendering
    whole = draw(ahead(80, seed=9), front_camera(), sh_degree=3, backend=backend)
    wanted = MASKS[mask].bool().repeat_interleave(16, 0).repeat_interleave(16, 1)[:35, :45]
    assert torch.equal(found.color.detach(), whole.color * wanted)
    assert found.visible.any() == bool(MASKS[mask].any())


def test_near_plane_is_the_cameras(backend: str) -> None:
    field = ahead(20)
    for near in (0.05, 4.9):
        assert_agrees(field, front_camera(near=near), backend)


def test_values_that_are_no_numbers_are_not_drawn(variant: str) -> None:
    field = ahead(60, seed=1)
    bad = torch.tensor([float("nan"), float("inf"), -float("inf")])
    field.positions[0:3, 0], field.positions[3:6, 2] = bad, bad
    field.log_scales[6:9, 1], field.rotations[9:12, 2], field.opacity_logits[12:15] = bad, bad, bad
    field.sh[15:18, 0, 1], field.filter_3d[18:20] = bad, bad[:2]
    view = front_camera()
    weights = random_weights(view, ("color", "depth", "normal", "distortion"), 0, torch.ones(35, 45, dtype=torch.bool))
    found = run(field, view, "cpu", weights, torch.zeros(35, 45), sh_degree=3)
    assert_finite(found)
    assert not found.rendering.visible[0:6].any() and not found.rendering.visible[15:20].any()
    assert found.rendering.visible[20:].any()


@given(
    seed=st.integers(0, 10_000),
    n=st.integers(0, 60),
    size=st.tuples(st.integers(1, 50), st.integers(1, 40)),
    log_scale=st.floats(-3.5, -0.5),
    sh_degree=st.integers(0, 3),
    outputs=st.sampled_from(["all", "basic"]),
    mask=st.integers(0, 2**16 - 1),
)
def test_random_scenes(
    seed: int, n: int, size: tuple[int, int], log_scale: float, sh_degree: int, outputs: str, mask: int
) -> None:
    view = camera(*size, seed=seed)
    tiles = torch.tensor([mask >> i & 1 for i in range(16)]).view(4, 4)[: view.tiles[0], : view.tiles[1]]
    field = gaussians(n, seed, log_scale=log_scale)
    assert_agrees(field, view, "cpu", "plain", sh_degree, tiles, outputs, seed)


@given(seed=st.integers(0, 100_000), wildness=st.floats(1.0, 30.0), near=st.sampled_from([0.01, 0.2, 2.0]))
def test_wild_parameters_stay_finite(seed: int, wildness: float, near: float) -> None:
    field = gaussians(48, seed, spread=wildness, log_scale=-2.0, log_spread=wildness, logit_spread=wildness)
    field.rotations *= torch.exp(wildness * torch.randn(48, 1, generator=torch.Generator().manual_seed(seed)))
    field.filter_3d[::2] = 0.0
    view = camera(40, 30, seed=seed, near=near)
    weights = random_weights(
        view, ("color", "alpha", "depth", "median", "normal", "distortion"), seed, torch.ones(30, 40)
    )
    found = run(field, view, "cpu", weights, torch.ones(30, 40), sh_degree=3)
    assert_finite(found)
    alpha = found.rendering.alpha
    assert alpha.min() >= 0 and alpha.max() <= 1
    assert found.rendering.distortion.min() >= -1e-5


def beyond_float32(seed: int) -> tuple[Gaussians, Camera]:
    """Scales of 1000 units, focal lengths below a pixel, everything far away."""
    generator = np.random.default_rng(seed)

    def one_of(*values: float) -> float:
        return float(generator.choice(values))

    log_scale, log_spread = one_of(-2, 6.5, 6.9, 3.0, -13), one_of(0.1, 1, 4, 10, 30)
    spread, filter_3d = one_of(1, 0.1, 30, 1000), one_of(0, 0.003, 1, 100)
    field = gaussians(48, seed, spread, log_scale, log_spread, filter_3d=filter_3d)
    field.log_scales[torch.arange(48), torch.from_numpy(generator.integers(0, 3, 48))] = one_of(6.9077, 9, -30)
    field.opacity_logits += one_of(0, 5, -2)
    field.positions[:, 2] += one_of(5, 0.01, 1000, 1e5, 1e7)
    focal, near = one_of(0.001, 0.1, 0.5, 42.0, 1e6), one_of(0.01, 0.2, 1e-5)
    return field, Camera(45, 35, focal, focal * 1.05, 22.0, 17.0, np.eye(3), np.zeros(3), near)


@pytest.mark.parametrize("seed", [289, 449, 569, 1228, 1668, 1829, 1964, 2458])  # of 3,000, those that gave NaN
@pytest.mark.parametrize("backend", ["cpu", "cuda-source-on-cpu"])  # the reference has NaN there
def test_gradients_beyond_float32_count_as_none(variant: str, backend: str, seed: int) -> None:
    field, view = beyond_float32(seed)
    weights = random_weights(view, OUTPUTS, seed, torch.ones(35, 45, dtype=torch.bool))
    found = run(field, view, backend, weights, torch.zeros(35, 45), sh_degree=3)
    assert_finite(found)
    assert found.rendering.visible.any()
