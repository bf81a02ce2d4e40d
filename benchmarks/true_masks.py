# SPDX-License-Identifier: GPL-3.0-or-later
"""The true masks of a scene as the engine takes them from a user."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.errors import BadInput
from mgf_engine.model.masks import BUILDING, IGNORE

#: Labels from here on would be read as the grey of a mask with soft edges (:mod:`mgf_engine.masks.user_masks`).
FIRST_GREY = 64


def few_labels(labels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Number a photo's elements from 2 without gaps; where there are too many, the smallest become plain building.

    Args:
        labels: [H, W]; 0 background, 1 building, 2..254 elements, 255 ignored.
    """
    values, counts = np.unique(labels[(labels > BUILDING) & (labels != IGNORE)], return_counts=True)
    largest = np.sort(values[np.argsort(-counts, kind="stable")][: FIRST_GREY - BUILDING - 1])
    table = np.full(256, BUILDING, np.uint8)
    table[[0, IGNORE]] = 0, IGNORE
    table[largest] = np.arange(len(largest)) + BUILDING + 1
    return np.asarray(table[labels], np.uint8)


def write_elements(scene: Path, folder: Path) -> Path:
    """Write the true elements of a scene's photos to a folder of masks; returns the folder.

    Raises:
        BadInput: an image of elements is damaged.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for path in sorted((scene / "elements").glob("*.png")):
        labels = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        if labels is None:
            raise BadInput(f"Cannot read '{path}'; delete the scene's folder and make it again.")
        cv2.imwrite(str(folder / path.name), few_labels(labels.astype(np.uint8)))
    return folder
