# SPDX-License-Identifier: GPL-3.0-or-later
"""Render the views of a finished field."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from mgf_engine.model.gaussians import Gaussians
from mgf_engine.model.scene import View
from mgf_engine.raster.api import Camera, Rendering, render


def render_view(field: Gaussians, view: View, sh_degree: int) -> Rendering:
    """Render a view of the whole field at working resolution, without gradients."""
    with torch.no_grad():
        return render(field, Camera.from_view(view), sh_degree=sh_degree).cpu()


def straight_rgba(rendering: Rendering) -> NDArray[np.uint8]:
    """Return the render as RGBA uint8 [H, W, 4] with straight (not premultiplied) alpha."""
    alpha = rendering.alpha.clamp(0, 1)
    color = (rendering.color / alpha.clamp_min(1e-4)).clamp(0, 1)
    rgba = torch.cat([color, alpha[None]]).permute(1, 2, 0)
    return (rgba * 255).round().to(torch.uint8).numpy()
