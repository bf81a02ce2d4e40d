# SPDX-License-Identifier: GPL-3.0-or-later
"""3D low-pass filter of Mip-Splatting: no Gaussian is smaller than the best photo's sampling rate can show."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from mgf_engine.model.gaussians import Gaussians
from mgf_engine.model.scene import View
from mgf_engine.native.parallel import parallel_map
from mgf_engine.options.algorithms import parameter

_NEAR = 1e-3  # depth, normalised frame, below which no photo shows anything
_TABLE = 1 << 19  # points times views worked on at once: what stays in the cache


@dataclass(frozen=True)
class FilterOptions:
    """Options of the 3D low-pass filter."""

    variance: float = parameter(0.2, "Variance of the filter in the finest photo (Mip-Splatting, section 5.1)", "px²")
    margin: float = parameter(
        0.15, "Distance beside the frame up to which a photo counts, as a share of its width and height"
    )


def update_filter(
    field: Gaussians, views: Sequence[View], threads: int = 1, options: FilterOptions = FilterOptions()
) -> None:
    """Set ``filter_3d`` from the finest sampling of each centre over ``views``, in place.

    Args:
        field: normalised frame; changed.
        views: cameras of the training photos.
        threads: views that are worked on at a time.
        options: width of the filter.
    """
    finest = finest_sampling(field.positions.detach().cpu().numpy(), views, threads, options.margin)
    seen = finest > 0
    width = np.float32(np.sqrt(options.variance)) / np.where(seen, finest, 1)
    fallback = width[seen].max() if seen.any() else np.float32(1e-3)
    found = torch.from_numpy(np.where(seen, width, fallback))
    field.filter_3d = found.to(field.positions.device)


def finest_sampling(
    points: NDArray[np.float32], views: Sequence[View], threads: int = 1, margin: float = FilterOptions.margin
) -> NDArray[np.float32]:
    """Compute the sampling rate of each point in the view that samples it most finely.

    Args:
        points: [N, 3], normalised frame.
        views: cameras of the photos.
        threads: number of worker threads.
        margin: see :class:`FilterOptions`.

    Returns:
        Pixels per unit of the normalised frame, [N]; 0 where no view shows the point.
    """
    rotations = np.concatenate([view.rotation for view in views]).astype(np.float32)
    shifts = np.concatenate([view.translation for view in views])[:, None].astype(np.float32)
    fx, fy, cx, cy, width, height = (
        np.array([getattr(view, name) for view in views], np.float32)[:, None]
        for name in ("fx", "fy", "cx", "cy", "width", "height")
    )
    beside = margin * np.maximum(width, height)
    chunk = max(1, _TABLE // len(views))

    def sampled(index: int) -> NDArray[np.float32]:
        local = rotations @ points[index * chunk : (index + 1) * chunk].T
        local += shifts
        x, y, depth = local.reshape(len(views), 3, -1).transpose(1, 0, 2)
        # In the frame, without dividing: the pixel's distance from the centre of the frame, times depth.
        inside = depth > _NEAR
        inside &= np.abs(x * fx + depth * (cx - width / 2)) < depth * (width / 2 + beside)
        inside &= np.abs(y * fy + depth * (cy - height / 2)) < depth * (height / 2 + beside)
        rate = np.divide(np.maximum(fx, fy), depth, out=np.zeros_like(depth), where=inside)
        return rate.max(0)

    chunks = range(math.ceil(len(points) / chunk))
    return np.concatenate([np.zeros(0, np.float32), *(rate for rate in parallel_map(sampled, chunks, threads))])
