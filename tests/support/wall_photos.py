# SPDX-License-Identifier: GPL-3.0-or-later
"""Photos of a wall in the plane z = 0 around (75, 75): with a pattern, or without any texture."""

import cv2
import numpy as np

from mgf_engine.geometry.rasterize import render_mesh
from tests.support.analytic import camera

MIDDLE = np.array([75.0, 75.0, 0.0])


def cameras(count=8, radius=100.0, height=160.0):
    """Cameras around the wall's middle, some 190 away; a pixel covers 1."""
    angles = np.linspace(0, 2 * np.pi, count, endpoint=False)
    return [
        camera(MIDDLE + np.array([radius * np.cos(a), radius * np.sin(a), height]), MIDDLE, 240, 200, 190.0, f"{i}.png")
        for i, a in enumerate(angles)
    ]


def plain(view):
    return np.full((view.height, view.width), 200, np.uint8)


def textured(surface):
    """What a view sees of ``surface`` when it carries a pattern that depends on x and y."""
    random = np.random.default_rng(0)
    coarse = cv2.resize(random.random((115, 115)).astype(np.float32), (460, 460), interpolation=cv2.INTER_CUBIC)
    pattern = np.clip(coarse * 255, 0, 255).astype(np.float32)

    def photo(view):
        depth = render_mesh(surface, view).depth
        grid = np.stack(np.meshgrid(np.arange(view.width) + 0.5, np.arange(view.height) + 0.5), -1).reshape(-1, 2)
        at = view.unproject(grid, depth.ravel().astype(float))
        x, y = ((at[:, k] * 3).astype(np.float32).reshape(depth.shape) for k in (0, 1))
        seen = cv2.remap(pattern, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
        return np.where(depth > 0, seen, 0).astype(np.uint8)

    return photo
