# SPDX-License-Identifier: GPL-3.0-or-later
"""The wall of ``wall.py`` with a texture that aliases or mirror images: another pattern in each photo."""

from __future__ import annotations

import cv2
import numpy as np

from mgf_engine.model.scene import Scene
from mgf_engine.scene.stereo import StereoOptions

DISTANCE = 3.0
CENTRES = [[x, y, -DISTANCE] for x in (-0.6, -0.2, 0.2, 0.6) for y in (0, 0.4)]
#: All points lie at one depth; with a search that narrow, photos would agree by chance.
STEREO = StereoOptions(search_margin=(0.25, 30.0))


def add_moire(scene: Scene) -> None:
    """Add waves of four pixels and their fringes to the photos, of another direction and phase in each."""
    rng = np.random.default_rng(3)
    for view in scene.views:
        path = str(scene.folder / view.file)
        photo = cv2.imread(path).astype(float)
        y, x = np.mgrid[: photo.shape[0], : photo.shape[1]]
        turn, phase = rng.uniform(0, np.pi), rng.uniform(0, 6.28, 2)
        along, across = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
        waves = np.sin(1.6 * along + phase[0]) * np.sin(1.4 * across + phase[1])
        cv2.imwrite(path, np.clip(photo + 110 * waves[..., None], 0, 255).astype(np.uint8))


def add_mirror_image(scene: Scene, index: int) -> None:
    """Replace the middle of a photo by patches that no other photo shows, however far it is reduced."""
    path = str(scene.folder / scene.views[index].file)
    photo = cv2.imread(path)
    patches = cv2.GaussianBlur(np.random.default_rng(3).normal(0, 1, photo.shape[:2]), (0, 0), 4)
    height, width = photo.shape[:2]
    middle = (slice(height // 6, -height // 6), slice(width // 6, -width // 6))
    photo[middle] = np.clip(120 + 60 * (patches / patches.std())[..., None], 0, 255)[middle]
    cv2.imwrite(path, photo)
