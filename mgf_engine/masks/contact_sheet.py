# SPDX-License-Identifier: GPL-3.0-or-later
"""Draw the contact sheet: a thumbnail of every photo with the outline, score and flag of its mask."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.masks.store import write_image
from mgf_engine.model.masks import IGNORE, MaskSet, building
from mgf_engine.model.scene import Scene
from mgf_engine.native.parallel import parallel_map

TILE = 320  # px, width of one photo on the sheet
CAPTION = 34
OUTSIDE, OCCLUDER, OUTLINE = (110, 30, 110), (30, 130, 200), (0, 255, 255)  # BGR
GOOD, BAD = (210, 255, 210), (80, 80, 255)


def write_contact_sheet(
    scene: Scene, masks: MaskSet, reasons: list[str], clicked: set[int], path: Path, threads: int = 1
) -> None:
    """Write the sheet as an image; photos with clicks carry a star.

    Args:
        scene: photos.
        masks: of all photos.
        reasons: why each mask is left out; empty for those in use.
        clicked: indices of photos with clicks.
        path: of the image.
        threads: number of worker threads.
    """

    def tile(index: int) -> NDArray[np.uint8]:
        title = f"{'* ' if index in clicked else ''}{scene.views[index].name}"
        note = reasons[index] or f"score {masks.scores[index]:.2f}"
        return _tile(scene.photo(index), masks.labels[index], title, note, bool(masks.used[index]))

    tiles = list(parallel_map(tile, range(len(scene.views)), threads))
    columns = min(len(tiles), max(1, round((len(tiles) * 1.2) ** 0.5)))
    height = max(t.shape[0] for t in tiles)
    tiles = [np.pad(t, ((0, height - t.shape[0]), (0, 0), (0, 0))) for t in tiles]
    tiles += [np.zeros_like(tiles[0])] * (-len(tiles) % columns)
    rows = [np.hstack(tiles[i : i + columns]) for i in range(0, len(tiles), columns)]
    write_image(path, np.vstack(rows))


def _tile(photo: NDArray[np.uint8], labels: NDArray[np.uint8], title: str, note: str, used: bool) -> NDArray[np.uint8]:
    height, width = labels.shape
    # Twice as large as it is shown: the outline is drawn there, and most of a large photo is never painted.
    drawn = min(width, 2 * TILE), min(height, max(1, round(2 * TILE * height / width)))
    small = np.asarray(cv2.resize(photo, drawn, interpolation=cv2.INTER_AREA), np.uint8)
    shown = np.asarray(cv2.resize(labels, drawn, interpolation=cv2.INTER_NEAREST), np.uint8)
    picture = cv2.resize(overlay(small, shown), (TILE, max(1, round(TILE * height / width))))
    caption = np.zeros((CAPTION, TILE, 3), np.uint8)
    for line, text in enumerate((title, note)):
        # The built-in font has no letters beyond ASCII; the names in scores.json are whole.
        text = text.encode("ascii", "replace").decode()
        color = GOOD if used else BAD
        cv2.putText(caption, text, (4, 13 + 15 * line), cv2.FONT_HERSHEY_SIMPLEX, 0.42, color, 1, cv2.LINE_AA)
    return np.vstack([picture, caption])


def overlay(photo: NDArray[np.uint8], labels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Draw the outline of a mask on its photo (RGB), and dim the outside; BGR uint8 [H, W, 3]."""
    result = np.ascontiguousarray(photo[..., ::-1])
    inside = building(labels)
    values = np.arange(256, dtype=np.float32)[:, None]
    for where, color in ((~inside & (labels != IGNORE), OUTSIDE), (labels == IGNORE, OCCLUDER)):
        dimmed = (0.35 * values + 0.5 * np.array(color, np.float32)).clip(0, 255).astype(np.uint8)
        cv2.copyTo(cv2.LUT(result, dimmed[None]), where.astype(np.uint8), result)
    outlines, _ = cv2.findContours(inside.astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(result, outlines, -1, OUTLINE, max(1, round(max(photo.shape[:2]) / 400)))
    return result
