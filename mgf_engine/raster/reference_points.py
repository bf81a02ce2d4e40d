# SPDX-License-Identifier: GPL-3.0-or-later
"""Reference in plain torch of the opacity of points (``csrc/raster/points.c``), written from eq. 23-24; for tests."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mgf_engine.model.gaussians import Gaussians
from mgf_engine.model.scene import View
from mgf_engine.raster.points import deviations


def opacity_of_points(points: NDArray[np.float64], gaussians: Gaussians, view: View, near: float) -> Tensor:
    """Compute the opacity between the camera and each point, float64 [N]; every pair of point and Gaussian is looked
    at.

    Args:
        points: [N, 3], normalised frame, in front of the camera.
        gaussians: n Gaussians.
        view: camera of the photo.
        near: a Gaussian counts when its largest value on the ray lies beyond this depth.
    """
    rotation = torch.from_numpy(view.rotation)
    inverse = torch.linalg.inv(torch.from_numpy(deviations(gaussians)))  # normalised -> Gaussian's own frame
    centres = gaussians.positions.detach().double()
    camera = torch.from_numpy(view.centre)
    local = torch.from_numpy(points) @ rotation.T + torch.from_numpy(view.translation)
    depth = local[:, 2]
    rays = (local / depth[:, None]) @ rotation  # so that t is the depth
    origin = torch.einsum("nij,nj->ni", inverse, camera - centres)  # [n, 3]
    ray = torch.einsum("nij,pj->pni", inverse, rays)  # [N, n, 3]
    square = (ray**2).sum(2)
    peak = -(ray * origin).sum(2) / square
    closest = (torch.linalg.cross(origin.expand_as(ray), ray) ** 2).sum(2) / square
    opacity = gaussians.opacities.detach().double()
    at_peak = opacity * torch.exp(-0.5 * closest)
    at_point = at_peak * torch.exp(-0.5 * square * (torch.minimum(depth[:, None], peak) - peak) ** 2)
    centre_depth = centres @ rotation.T[:, 2] + view.translation[2]
    alpha = torch.where((at_point > 1 / 255) & (peak > near) & (centre_depth > near), at_point.clamp_max(0.99), 0.0)
    after = torch.cumprod(1 - alpha[:, torch.argsort(centre_depth)], 1)
    before = torch.cat([torch.ones(len(points), 1, dtype=torch.float64), after[:, :-1]], 1)
    blended = (before > 1e-4).sum(1, keepdim=True)  # from then on nothing is added
    return 1 - after.gather(1, blended - 1)[:, 0]
