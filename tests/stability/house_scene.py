# SPDX-License-Identifier: GPL-3.0-or-later
"""The painted house as a folder of the scene generator's form, made once for all tests that only read it."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from house import build_house

PHOTOS = 20
_made: list[Path] = []


def house_scene(factory: pytest.TempPathFactory) -> Path:
    """The folder: images, masks, sparse/0, prompts.json, scene.json."""
    if not _made:
        folder = factory.mktemp("house")
        house = build_house(folder, PHOTOS)
        (folder / "masks").mkdir()
        for name, mask in house.masks.items():
            cv2.imwrite(str(folder / "masks" / name), mask.astype(np.uint8))
        (folder / "scene.json").write_text(json.dumps({"ground_pixel": 0.02}))
        _made.append(folder)
    return _made[0]
