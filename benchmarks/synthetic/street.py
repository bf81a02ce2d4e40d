# SPDX-License-Identifier: GPL-3.0-or-later
"""Two painted houses side by side with a map of their footprints, for whole towns in seconds."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.synthetic.house import (
    OFFSET,
    house_mesh,
    lawn_mesh,
    mask_of_faces,
    paint,
    photograph_faces,
    ring_view,
    write_model,
)
from benchmarks.synthetic.meshes import merged
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.scene import View

#: Where the middles of the houses lie, and that of one that was torn down, from :data:`OFFSET`.
PLACES = {"left": (-3.2, 0.0), "right": (3.2, 0.8)}
GONE = (0.0, 7.0)
_HALF = (2.0, 1.5)


@dataclass(frozen=True)
class Street:
    """Where the files are, and the truth.

    Attributes:
        folder: ``images/``, ``sparse/0/`` and ``footprints.geojson`` (coordinates of the scene).
        meshes: the true houses, by name.
        masks: house -> photo -> true mask, bool [H, W].
    """

    folder: Path
    meshes: dict[str, Mesh]
    masks: dict[str, dict[str, NDArray[np.bool_]]]


def build_street(folder: Path, photos: int = 20, error: float = 0.1) -> Street:
    """Write the scene into ``folder``; footprints are ``error`` off."""
    (folder / "images").mkdir(parents=True, exist_ok=True)
    one, lawn = house_mesh(), lawn_mesh(16)
    meshes = {
        name: Mesh(one.vertices + np.array([*place, 0.0]), one.faces, one.colors) for name, place in PLACES.items()
    }
    houses = merged(*meshes.values())
    both = merged(houses, lawn)
    views = [_view(k, photos) for k in range(photos)]
    masks: dict[str, dict[str, NDArray[np.bool_]]] = {name: {} for name in PLACES}
    for view in views:
        picture, face = photograph_faces(both, len(houses.faces), view, _paint)
        cv2.imwrite(str(folder / "images" / view.name), picture[:, :, ::-1])
        for number, name in enumerate(PLACES):
            first = number * len(one.faces)
            masks[name][view.name] = mask_of_faces(face, first, first + len(one.faces))
    write_model(folder / "sparse" / "0", views, both, houses, 3000, 1500)
    write_footprints(folder / "footprints.geojson", {**PLACES, "gone": GONE}, error)
    return Street(folder, meshes, masks)


def write_footprints(path: Path, places: dict[str, tuple[float, float]], error: float = 0.0) -> None:
    """Rectangles around places as GeoJSON without a CRS, shifted by ``error`` towards the north-east."""
    features = []
    for name, place in places.items():
        middle = OFFSET[:2] + place + error / np.sqrt(2)
        corners = middle + np.array(_HALF) * [(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)]
        geometry = {"type": "Polygon", "coordinates": [corners.tolist()]}
        features.append({"type": "Feature", "properties": {"id": name}, "geometry": geometry})
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))


def _view(index: int, count: int) -> View:
    """Camera ``index`` of two rings around the street."""
    view = ring_view(index, count)
    centre = OFFSET + (view.centre - OFFSET) * (1.65, 1.35, 1.25)
    return replace(view, translation=-view.rotation @ centre)


def _paint(points: NDArray[np.float64], face: NDArray[np.int32], houses: int) -> NDArray[np.uint8]:
    """The second house as the first: its faces count from 0 again."""
    each = houses // len(PLACES)
    own = np.where((face >= 0) & (face < houses), face % each, np.where(face < 0, face, face - houses + each))
    return paint(points, own.astype(np.int32), each)
