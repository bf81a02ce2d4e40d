# SPDX-License-Identifier: GPL-3.0-or-later
"""A finished job of the painted house with windows: true mesh, true masks, exact cameras."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.synthetic.house import OFFSET, House, build_house, paint
from mgf_engine.geometry.mesh_files import write_ply
from mgf_engine.jobs.job import Job
from mgf_engine.masks.parts import Part
from mgf_engine.masks.store import save_masks
from mgf_engine.messages import Reporter
from mgf_engine.model.masks import MaskSet
from mgf_engine.options.config import make_config
from mgf_engine.scene.load import load_scene
from mgf_engine.scene.store import save_scene

#: On the walls that face south and north: left, right, bottom, top, in the house's own metres.
WINDOWS = ((-1.5, -0.8, 0.7, 1.5), (0.4, 1.3, 0.7, 1.5))
DARK = (25, 30, 40)
WINDOW_LABEL = 2


@dataclass(frozen=True)
class FinishedJob:
    """Where the job is, and the house it is of."""

    folder: Path
    house: House


def on_window(points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which points [..., 3] of the scene frame lie on a window."""
    x, y, z = np.moveaxis(points - OFFSET, -1, 0)
    inside = np.zeros(x.shape, bool)
    for left, right, bottom, top in WINDOWS:
        inside |= (x > left) & (x < right) & (z > bottom) & (z < top)
    return inside & (np.abs(np.abs(y) - 1.5) < 0.02)


def with_windows(points: NDArray[np.float64], face: NDArray[np.int32], house_faces: int) -> NDArray[np.uint8]:
    """The house's paint, with dark windows in two walls."""
    picture = paint(points, face, house_faces)
    picture[on_window(points) & (face >= 0) & (face < house_faces)] = DARK
    return picture


def finish_job(folder: Path, photos: int = 16) -> FinishedJob:
    """Write scene, job folder, masks with windows as a part, and the true mesh."""
    house = build_house(folder / "scene", photos, with_windows)
    out = folder / "job"
    with Job.start(out, house.folder, house.prompts) as job:
        scene = load_scene(house.folder, out / "scene", make_config(), Reporter())
        save_scene(scene)
        labels = []
        for k, view in enumerate(scene.views):
            label = house.masks[view.name].astype(np.uint8)
            label[(label > 0) & (cv2.cvtColor(scene.photo(k), cv2.COLOR_RGB2GRAY) < 45)] = WINDOW_LABEL
            labels.append(label)
        count = len(labels)
        scores = np.ones(count, np.float32)
        masks = MaskSet(tuple(labels), np.ones(count, bool), scores, np.zeros(len(scene.points), bool))
        part = Part("window", [(k, WINDOW_LABEL) for k in range(count)])
        save_masks(masks, scene, out / "masks", [""] * count, parts=[part])
        write_ply(house.mesh, out / "mesh.ply")
        job.save()
    return FinishedJob(out, house)
