# SPDX-License-Identifier: GPL-3.0-or-later
"""The painted house as a folder of the scene generator's form, made once for all tests that only read it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.synthetic.house import build_house

if TYPE_CHECKING:
    import pytest

PHOTOS = 20
WALL, WINDOW = 2, 3
_made: list[Path] = []


def wall_and_window(mask: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Return a map of elements: all of the house is one wall, with a window in the middle."""
    elements = np.where(mask, WALL, 0).astype(np.uint8)
    y, x = (int(v.mean()) for v in np.nonzero(mask))
    elements[y - 12 : y + 12, x - 20 : x + 20][mask[y - 12 : y + 12, x - 20 : x + 20]] = WINDOW
    return elements


def house_scene(factory: pytest.TempPathFactory) -> Path:
    """Return the folder: images, masks, elements, sparse/0, prompts.json, scene.json."""
    if not _made:
        folder = factory.mktemp("house")
        house = build_house(folder, PHOTOS)
        for part in ("masks", "elements"):
            (folder / part).mkdir()
        for name, mask in house.masks.items():
            cv2.imwrite(str(folder / "masks" / name), mask.astype(np.uint8))
            cv2.imwrite(str(folder / "elements" / name), wall_and_window(mask))
        elements = {"wall": WALL, "wall.window0": WINDOW}
        (folder / "scene.json").write_text(json.dumps({"ground_pixel": 0.02, "elements": elements}))
        _made.append(folder)
    return _made[0]
