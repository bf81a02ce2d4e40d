# SPDX-License-Identifier: GPL-3.0-or-later
"""Small COLMAP scenes with exact keypoints and with photos whose content is known for every ray."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pycolmap

from mgf_engine.messages import Reporter
from mgf_engine.model.scene import Scene
from mgf_engine.options.config import Config, make_config
from mgf_engine.scene.load import load_scene

SIZE = (160, 120)
FOCAL = 150.0
CENTRE = (80.0, 60.0)
#: Parameters of every COLMAP model that has a picture plane, for photos of SIZE.
LENSES: dict[str, list[float]] = {
    "SIMPLE_PINHOLE": [FOCAL, *CENTRE],
    "PINHOLE": [FOCAL, 0.99 * FOCAL, 81.5, 58.0],
    "SIMPLE_RADIAL": [FOCAL, *CENTRE, -0.08],
    "RADIAL": [FOCAL, *CENTRE, -0.1, 0.03],
    "OPENCV": [FOCAL, 1.01 * FOCAL, 79.0, 61.0, -0.12, 0.02, 0.002, -0.001],
    "FULL_OPENCV": [FOCAL, FOCAL, *CENTRE, -0.1, 0.02, 0.001, -0.001, 0.005, 0.01, -0.005, 0.001],
    "SIMPLE_RADIAL_FISHEYE": [FOCAL, *CENTRE, 0.02],
    "RADIAL_FISHEYE": [FOCAL, *CENTRE, 0.02, -0.01],
    "OPENCV_FISHEYE": [FOCAL, FOCAL, *CENTRE, 0.03, -0.01, 0.002, -0.001],
    "FOV": [FOCAL, FOCAL, *CENTRE, 0.6],
    "THIN_PRISM_FISHEYE": [FOCAL, FOCAL, *CENTRE, 0.02, -0.01, 0.001, -0.001, 0.001, 0.0, 0.001, 0.001],
    "RAD_TAN_THIN_PRISM_FISHEYE": [FOCAL, FOCAL, *CENTRE, 0.02, -0.01, 0, 0, 0, 0, 0.001, 0.001, 0.001, 0, 0.001, 0],
    "SIMPLE_DIVISION": [FOCAL, *CENTRE, -0.1],
    "DIVISION": [FOCAL, 1.01 * FOCAL, *CENTRE, -0.1],
    "SIMPLE_FISHEYE": [FOCAL, *CENTRE],
    "FISHEYE": [FOCAL, 1.01 * FOCAL, *CENTRE],
    "EUCM": [FOCAL, FOCAL, *CENTRE, 0.5, 1.05],
}


def reconstruction(model: str = "PINHOLE", rigs: int = 1, sensors: int = 1, frames: int = 5, points: int = 60) -> Any:
    """Return a COLMAP model whose keypoints are exact projections; ``rigs * sensors`` cameras."""
    pycolmap.set_random_seed(7)
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig = rigs, sensors, frames
    options.num_points3D, options.num_points2D_without_point3D = points, 3
    options.camera_model_id = getattr(pycolmap.CameraModelId, model)
    options.camera_params, (options.camera_width, options.camera_height) = LENSES[model], SIZE
    return pycolmap.synthesize_dataset(options)


def write_model(model: Any, folder: Path, kind: str = ".bin") -> Path:
    """Write the model's files into a folder, as .bin or .txt; returns the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    (model.write_binary if kind == ".bin" else model.write_text)(folder)
    return folder


def write_scene(model: Any, folder: Path, kind: str = ".bin") -> Path:
    """Write ``sparse/0`` and one photo per image in ``images``; returns the folder."""
    write_model(model, folder / "sparse" / "0", kind)
    for image in model.images.values():
        write_photo(folder / "images" / image.name, photo_of(image.camera))
    return folder


def photo_of(camera: Any, size: tuple[int, int] = SIZE) -> np.ndarray:
    """A photo [height, width, 3] whose colour depends only on the ray through each pixel: see :func:`color_of_rays`."""
    x, y = np.meshgrid((np.arange(size[0]) + 0.5) / size[0], (np.arange(size[1]) + 0.5) / size[1])
    pixels = np.stack([x.ravel() * camera.width, y.ravel() * camera.height], 1)
    rays = np.nan_to_num(camera.cam_from_img(pixels))
    return np.rint(color_of_rays(rays)).astype(np.uint8).reshape(size[1], size[0], 3)


def color_of_rays(rays: np.ndarray) -> np.ndarray:
    """Smooth colours 28..228 of rays (x / z, y / z) [N, 2], with no symmetry between the corners."""
    x, y = rays[:, 0], rays[:, 1]
    return 128 + 100 * np.stack([np.sin(3 * x + 0.5), np.sin(3 * y + 1.0), np.sin(2 * x + 2 * y)], 1)


def write_photo(path: Path, rgb: np.ndarray) -> Path:
    """Write RGB in the format of the path's suffix, whatever letters the path has."""
    path.parent.mkdir(parents=True, exist_ok=True)
    ok, data = cv2.imencode(path.suffix, cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR))
    assert ok
    data.tofile(path)
    return path


class Messages:
    """A reporter whose messages are kept."""

    def __init__(self) -> None:
        self.sent: list[dict[str, Any]] = []
        self.reporter = Reporter(self.sent.append)
        self.reporter.stage("scene")

    @property
    def warnings(self) -> list[str]:
        return [m["text"] for m in self.sent if m["type"] == "warning"]


def load(source: Path, job: Path, messages: Messages | None = None, **options: Any) -> Scene:
    """Run the whole scene stage."""
    return load_scene(source, job / "scene", config(**options), (messages or Messages()).reporter)


def config(**options: Any) -> Config:
    return make_config({"holdout_every": 4, **options})


def reprojection(scene: Scene) -> np.ndarray:
    """Return the distance in working pixels between each observation and the projection of its point, [T]."""
    owner = np.repeat(np.arange(len(scene.points)), np.diff(scene.track_start))
    result = np.empty(len(owner))
    for index, view in enumerate(scene.views):
        mine = scene.track_view == index
        uv, depth = view.project(scene.points[owner[mine]])
        assert (depth > 0).all()
        result[mine] = np.linalg.norm(uv - scene.track_uv[mine], axis=1)
    return result
