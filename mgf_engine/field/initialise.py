# SPDX-License-Identifier: GPL-3.0-or-later
"""Initialise the Gaussians: a flat disc for each starting point, in the tangent plane of its neighbours."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mgf_engine.errors import BadInput
from mgf_engine.geometry.normals import principal_normals
from mgf_engine.model.gaussians import Gaussians
from mgf_engine.options.algorithms import parameter

SH_CONSTANT = 0.28209479177387814  # Y_0^0


@dataclass(frozen=True)
class InitialisationOptions:
    """Options of the first Gaussians."""

    neighbours: int = parameter(9, "Number of nearest points, itself included, that a normal is fitted to", low=4)
    flatness: float = parameter(0.25, "Thickness of a disc, as a share of its radius", low=1e-3, high=1)
    opacity: float = parameter(0.3, "Opacity of a disc", low=0.001, high=0.999)


def initial_field(
    points: NDArray[np.float64],
    colors: NDArray[np.uint8],
    towards: NDArray[np.float64],
    given: NDArray[np.float64] | None = None,
    options: InitialisationOptions = InitialisationOptions(),
) -> Gaussians:
    """Make one Gaussian per point.

    Args:
        points: [N, 3] in the normalised frame.
        colors: uint8 [N, 3].
        towards: [N, 3] a place that sees each point (a camera centre); orients the discs.
        given: [N, 3] unit normals where they are known, NaN elsewhere: there they are fitted to neighbouring points.
        options: of shape and opacity.

    Raises:
        BadInput: fewer than four points, too few to know distances from.
    """
    if len(points) < 4:
        raise BadInput(
            f"Only {len(points)} points lie on the building, too few to start from; add clicks on the building, "
            "or photos that overlap more."
        )
    distance, index = cKDTree(points).query(points, k=min(options.neighbours, len(points)))
    normals = _normals(points, index, towards)
    if given is not None:
        normals = np.where(np.isnan(given), normals, given)
    spacing = distance[:, 1:4].mean(1)
    # Limit the size, so that an isolated point does not become a disc as large as the building.
    spacing = np.clip(spacing, 1e-4, max(3.0 * float(np.median(spacing)), 1e-4))
    scales = spacing[:, None] * np.array([1.0, 1.0, options.flatness])
    sh = np.zeros((len(points), 16, 3))
    sh[:, 0] = (colors / 255.0 - 0.5) / SH_CONSTANT
    return Gaussians(
        positions=_tensor(points),
        log_scales=_tensor(np.log(scales)),
        rotations=_tensor(_quaternion_to(normals)),
        opacity_logits=torch.full((len(points),), float(np.log(options.opacity / (1 - options.opacity)))),
        sh=_tensor(sh),
        filter_3d=torch.zeros(len(points)),
    )


def _tensor(array: NDArray[np.float64]) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(array, dtype=np.float32))


def _normals(
    points: NDArray[np.float64], index: NDArray[np.int64], towards: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the direction of least spread among each point's neighbours, facing ``towards``; [N, 3] unit vectors."""
    normals = principal_normals(points, index)
    flip = np.einsum("ni,ni->n", normals, towards - points) < 0
    normals[flip] *= -1
    return normals


def _quaternion_to(normals: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return unit quaternions (w, x, y, z) that turn the z axis onto each normal; [N, 4]."""
    half = np.array([0.0, 0.0, 1.0]) + normals
    length = np.linalg.norm(half, axis=1, keepdims=True)
    opposite = length[:, 0] < 1e-6
    half = np.where(opposite[:, None], [1.0, 0.0, 0.0], half / np.maximum(length, 1e-12))
    # Turning z onto n is two reflections: q = (z . h, z x h) with h half-way between them.
    return np.stack([half[:, 2], -half[:, 1], half[:, 0], np.zeros(len(half))], axis=1)
