# SPDX-License-Identifier: GPL-3.0-or-later
"""A synthetic field, camera and target to check and time the rasterizer with, without any photo."""

from __future__ import annotations

import numpy as np
import torch

from mgf_engine.field.targets import Target, make_target
from mgf_engine.model.gaussians import Gaussians
from mgf_engine.model.scene import View
from mgf_engine.raster.camera import Camera


def synthetic_building(n: int, seed: int = 0, size: float = 0.02) -> Gaussians:
    """Make n flat Gaussians on the walls and roof of a box 2 wide, 1.4 deep and 2.6 high, and on the ground around it.

    Args:
        size: typical scale along the surface.
    """
    random = np.random.default_rng(seed)
    half = np.array([1.0, 0.7, 1.3])
    side = random.integers(0, 6, n)  # four walls, roof, ground
    axis, sign = np.array([0, 0, 1, 1, 2, 2])[side], np.array([-1, 1, -1, 1, 1, -1])[side]
    points = (2 * random.random((n, 3)) - 1) * half
    points[np.arange(n), axis] = sign * half[axis] + random.normal(0, 0.01, n)
    points[side == 5, :2] *= 2.5
    scales = size * np.exp(random.normal(0, 0.5, (n, 3)))
    scales[np.arange(n), axis] *= 0.15
    tilt = np.concatenate([np.ones((n, 1)), random.normal(0, 0.08, (n, 3))], 1)
    values = {
        "positions": points,
        "log_scales": np.log(scales),
        "rotations": tilt,
        "opacity_logits": random.normal(-0.5, 1.6, n),
        "sh": random.normal(0, 0.2, (n, 16, 3)),
        "filter_3d": np.full(n, 0.002),
    }
    return Gaussians(**{name: torch.from_numpy(v.astype(np.float32)) for name, v in values.items()})


def corner_view(width: int, height: int) -> Camera:
    """Return a camera that sees two walls and the roof, five units away."""
    centre = np.array([3.0, -3.4, 2.2])
    forward = np.array([0.0, 0.0, -0.1]) - centre
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    focal = 0.96 * width
    return Camera(width, height, focal, focal, width / 2, height / 2, rotation, -rotation @ centre)


def noise_target(camera: Camera, share: float = 1.0) -> Target:
    """Make a photo of noise with three labels, building all over, the most work there is, or in this share in its
    middle."""
    photo = np.random.default_rng(0).integers(0, 256, (camera.height, camera.width, 3)).astype(np.uint8)
    labels = np.ones((camera.height, camera.width), np.uint8)
    labels[:, camera.width // 2 :] = 2
    labels[camera.height // 3 : camera.height // 2, camera.width // 3 : camera.width // 2] = 3
    y, x = (round(size * (1 - share**0.5) / 2) for size in labels.shape)
    inside = np.zeros_like(labels)
    inside[y : camera.height - y, x : camera.width - x] = 1
    labels *= inside
    view = View(
        name="noise", file="noise.png", width=camera.width, height=camera.height, fx=camera.fx, fy=camera.fy,
        cx=camera.cx, cy=camera.cy, rotation=camera.rotation, translation=camera.translation,
        original_width=camera.width, original_height=camera.height,
    )  # fmt: skip
    target = make_target(photo, labels, view, 1)
    assert target is not None
    return target
