# SPDX-License-Identifier: GPL-3.0-or-later
"""Worse buildings, painted over the photos: walls without texture, windows that mirror something else in every photo.

The generator's maps of elements say which pixel shows which wall or window. Sparse points on what was painted over go,
as structure from motion would not have found them.
"""

from __future__ import annotations

import json
from collections.abc import Collection

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.perturb_copy import SceneCopy
from mgf_engine.errors import BadInput

#: A window's name holds this word.
WINDOW = "window"
_RIM = 2  # pixels at the edge of an element where points stay: a corner is seen whatever its faces show


def fade_walls(copy: SceneCopy, share: float) -> None:
    """All faces of the building lose ``share`` of their texture: each pixel goes towards the mean of its element."""
    for name in copy.names:
        photo, elements = copy.photo(name).astype(float), _elements(copy, name)
        for element in np.unique(elements[elements > 0]):
            here = elements == element
            photo[here] += share * (photo[here].mean(0) - photo[here])
        copy.write_photo(name, photo)
    _drop_points(copy, range(1, 256), share)


def mirror_windows(copy: SceneCopy, share: float) -> None:
    """This share of the windows shows, in every photo, a part of another photo upside down."""
    names, record = copy.names, json.loads((copy.source / "scene.json").read_text(encoding="utf-8"))
    windows = [number for title, number in record["elements"].items() if WINDOW in title]
    chosen = copy.rng.permutation(windows)[: round(share * len(windows))].tolist()
    for index, name in enumerate(names):
        photo, glass = copy.photo(name), np.isin(_elements(copy, name), chosen)
        reflected = copy.photo(names[(index + len(names) // 3) % len(names)])[::-1]
        photo[glass] = reflected[glass]
        copy.write_photo(name, photo)
    _drop_points(copy, chosen, 1.0)


def _drop_points(copy: SceneCopy, elements: Collection[int], share: float) -> None:
    """Delete this share of the points that most photos see within these elements, away from their edges."""
    inside: dict[int, int] = {}
    for image in copy.images:
        within = _interior(_elements(copy, str(image.name)), elements)
        for point in image.points2D:
            if point.has_point3D():
                x, y = (min(max(int(v), 0), n - 1) for v, n in zip(point.xy, within.shape[::-1], strict=True))
                inside[point.point3D_id] = inside.get(point.point3D_id, 0) + (1 if within[y, x] else -1)
    ids = sorted(i for i, votes in inside.items() if votes > 0)
    for point_id in copy.rng.permutation(ids)[: round(share * len(ids))]:
        copy.model.delete_point3D(int(point_id))
    copy.touch_model()


def _interior(elements: NDArray[np.uint8], chosen: Collection[int]) -> NDArray[np.bool_]:
    """Pixels of the chosen elements whose neighbourhood is all the same element."""
    kernel = np.ones((2 * _RIM + 1, 2 * _RIM + 1), np.uint8)
    same = cv2.dilate(elements, kernel) == cv2.erode(elements, kernel)
    return np.asarray(same & np.isin(elements, list(chosen)))


def _elements(copy: SceneCopy, name: str) -> NDArray[np.uint8]:
    """The map of elements of a photo, uint8 [H, W]; 0 outside the building, 255 hidden."""
    path = copy.source / "elements" / name
    picture = cv2.imread(str(path.with_suffix(".png")), cv2.IMREAD_UNCHANGED)
    if picture is None:
        raise BadInput(f"The map of elements '{path.with_suffix('.png')}' cannot be read; make the scene again.")
    return np.where(picture == 255, 0, picture).astype(np.uint8)
