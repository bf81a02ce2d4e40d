# SPDX-License-Identifier: GPL-3.0-or-later
"""The 3D low-pass filter: no Gaussian may be finer than the finest photo can show (Mip-Splatting)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from mgf_engine.field.gaussians import Gaussians
from mgf_engine.scene.model import View

_VARIANCE = 0.2  # of the filter, in pixels squared of the finest view (Mip-Splatting, section 5.1)
_MARGIN = 0.15  # views count when the centre falls this far outside the frame at most


def update_filter(field: Gaussians, views: Sequence[View]) -> None:
    """Set ``filter_3d`` from the finest sampling of each centre over ``views``, in place."""
    points = field.positions.detach().double().cpu().numpy()
    finest = np.zeros(len(points))  # pixels per unit
    for view in views:
        uv, depth = view.project(points)
        margin = _MARGIN * max(view.width, view.height)
        inside = (depth > 1e-3) & (uv > -margin).all(1) & (uv < (view.width + margin, view.height + margin)).all(1)
        rate = np.where(inside, max(view.fx, view.fy) / np.where(inside, depth, 1.0), 0.0)
        np.maximum(finest, rate, out=finest)
    seen = finest > 0
    width = np.sqrt(_VARIANCE) / np.where(seen, finest, 1.0)
    fallback = float(width[seen].max()) if seen.any() else 1e-3
    found = torch.from_numpy(np.where(seen, width, fallback).astype(np.float32))
    field.filter_3d = found.to(field.positions.device)
