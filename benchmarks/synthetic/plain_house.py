# SPDX-License-Identifier: GPL-3.0-or-later
"""A house of plain colours without one sparse point: only edges, masks and colours tell where it is."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.synthetic.house import OFFSET, house_mesh, lawn_mesh, ring_view, write_model
from benchmarks.synthetic.meshes import merged
from mgf_engine.geometry.rasterize import render_mesh, scaled_view
from mgf_engine.model.masks import MaskSet
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.scene import Scene, Similarity

PHOTOS = 16
_WALLS = np.array([(235, 235, 230), (225, 228, 235), (238, 230, 220), (228, 236, 228)])
_ROOF, _LAWN, _SKY = (150, 80, 70), (80, 130, 60), (150, 190, 235)


@dataclass(frozen=True)
class PlainHouse:
    """A scene with masks, and the true mesh, in one frame."""

    scene: Scene
    masks: MaskSet
    truth: Mesh


def make_plain_house(folder: Path, photos: int = PHOTOS) -> PlainHouse:
    """Make photos of the house of ``house.py`` in plain colours, a face of the walls each."""
    (folder / "images").mkdir(parents=True)
    house = _at_origin(house_mesh())
    both = merged(house, _at_origin(lawn_mesh()))
    views, labels = [], []
    for k in range(photos):
        view = ring_view(k, photos)
        view = type(view)(**{**view.__dict__, "translation": view.translation + view.rotation @ OFFSET})
        face = render_mesh(both, scaled_view(view, 3)).face
        colors = _colors(house)[np.minimum(face, len(house.faces))]
        colors[face < 0] = _SKY
        size = (view.width, view.height)
        picture = cv2.resize(colors.astype(np.uint8), size, interpolation=cv2.INTER_AREA)
        cv2.imwrite(str(folder / view.file), picture[:, :, ::-1])
        share = cv2.resize(((face >= 0) & (face < len(house.faces))) * 1.0, size, interpolation=cv2.INTER_AREA)
        views.append(view)
        labels.append((share > 0.5).astype(np.uint8))
    scene = Scene(
        tuple(views), np.zeros((0, 3)), np.zeros((0, 3), np.uint8), np.zeros(0, np.float32), np.zeros(1, np.int64),
        np.zeros(0, np.int32), np.zeros((0, 2), np.float32), Similarity(1.0, np.eye(3), np.zeros(3)), (0,), (), folder,
    )  # fmt: skip
    masks = MaskSet(tuple(labels), np.ones(photos, bool), np.ones(photos, np.float32), np.zeros(0, bool))
    return PlainHouse(scene, masks, house)


def write_inputs(plain: PlainHouse) -> tuple[Path, Path]:
    """A folder to reconstruct from, with sparse points on the lawn alone, and one with the true masks beside it."""
    folder = plain.scene.folder
    both = merged(plain.truth, _at_origin(lawn_mesh()))
    write_model(folder / "sparse" / "0", list(plain.scene.views), both, plain.truth, 0, 1500)
    masks = folder.parent / "masks"
    masks.mkdir()
    for view, labels in zip(plain.scene.views, plain.masks.labels, strict=True):
        cv2.imwrite(str(masks / view.name), labels * 255)
    return folder, masks


def _at_origin(mesh: Mesh) -> Mesh:
    return Mesh(mesh.vertices - OFFSET, mesh.faces, mesh.colors)


def _colors(house: Mesh) -> NDArray[np.int64]:
    """Of each face of the house, and of the lawn at the end: a colour for each direction."""
    a, b, c = (house.vertices[house.faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    side = np.where(np.abs(normal[:, 0]) > 0.5, normal[:, 0] > 0, 2 + (normal[:, 1] > 0))
    walls = np.where((normal[:, 2] > 0.1)[:, None], _ROOF + 12 * (normal[:, 1] > 0)[:, None], _WALLS[side])
    return np.concatenate([walls, [_LAWN]])
