# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras of a COLMAP model, for what they saw of the truth and how large their pixels are."""

from __future__ import annotations

from collections.abc import Callable
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mgf_engine.errors import BadInput
from mgf_engine.evaluation.evenness import typical_pixel
from mgf_engine.evaluation.surfaces import MaskedView
from mgf_engine.model.scene import View

MEASURED_POINTS = 400  # of a photo, which tell how far away what it shows is


def colmap_cameras(scene: Path) -> list[MaskedView]:
    """Return the registered cameras of a COLMAP model.

    Raises:
        BadInput: no model is found or it has no registered image.
    """
    return cameras_of(_model_folder(scene))


def colmap_pixel(scene: Path, longest_side: int) -> float:
    """Return the length that a pixel of photos with this longest side covers on their subject, scene units.

    Raises:
        BadInput: no model is found, or it has no registered image or no point.
    """
    distances, focals = [], []
    whole, images = _read_model(_model_folder(scene))
    for image in images:
        seen = (whole.points3D[p.point3D_id].xyz for p in image.points2D if p.has_point3D())
        points = np.array(list(islice(seen, MEASURED_POINTS))).reshape(-1, 3)
        distances.append(np.linalg.norm(points - image.projection_center(), axis=1))
        focals.append(
            image.camera.calibration_matrix()[0, 0] * longest_side / max(image.camera.width, image.camera.height)
        )
    return typical_pixel(distances, focals)


def cameras_of(model: Path, mask_of: Callable[[str], NDArray[np.bool_] | None] = lambda name: None) -> list[MaskedView]:
    """Return the registered cameras of the COLMAP model in a folder, in the order of their photos' names.

    Args:
        mask_of: name of a photo -> its mask, see :class:`~mgf_engine.evaluation.surfaces.MaskedView`.

    Raises:
        BadInput: the model cannot be read or has no registered image.
    """
    _, images = _read_model(model)
    return [MaskedView(_view(image), mask_of(str(image.name))) for image in images]


def _view(image: Any) -> View:
    """Return the view of a registered image of pycolmap; distortion is ignored: it hardly changes visibility."""
    camera, pose = image.camera, image.cam_from_world()
    k, size = camera.calibration_matrix(), (camera.width, camera.height)
    intrinsics = (k[0, 0], k[1, 1], k[0, 2], k[1, 2])
    return View(str(image.name), "", *size, *intrinsics, pose.rotation.matrix(), pose.translation, *size)


def _model_folder(scene: Path) -> Path:
    for place in (scene, scene / "sparse/0", scene / "sparse", scene / "sparse_truth"):
        if any((place / f"cameras{end}").exists() for end in (".bin", ".txt")):
            return place
    raise BadInput(f"There is no COLMAP model in '{scene}'; give the folder that holds 'sparse/0'.")


def _read_model(model: Path) -> tuple[Any, list[Any]]:
    """Read a model of pycolmap, which owns its images, and those that have a pose, in the order of their names."""
    import pycolmap

    try:
        whole = pycolmap.Reconstruction(model)
    except Exception as error:  # pycolmap raises several kinds
        raise BadInput(f"Cannot read the COLMAP model in '{model}' ({error}); export it again.") from error
    images = sorted((i for i in whole.images.values() if i.has_pose), key=lambda i: str(i.name))
    if not images:
        raise BadInput(f"The COLMAP model in '{model}' has no registered image; run structure from motion again.")
    return whole, images
