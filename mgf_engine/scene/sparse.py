# SPDX-License-Identifier: GPL-3.0-or-later
"""A sparse COLMAP model as plain arrays, and the checks that make it safe to work with.

COLMAP conventions: ``camera = R @ world + t``; the centre of the top-left pixel is (0.5, 0.5).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NoReturn

import numpy as np
import pycolmap
from numpy.typing import NDArray

from mgf_engine.errors import BadInput
from mgf_engine.model.scene import rows_by_view

NO_POINT = -1
#: Models that are not a picture plane at all; no pinhole view can be cut from them as a whole.
_NOT_PLANAR = {"EQUIRECTANGULAR"}
_LARGEST_SIDE = 200_000
_LARGEST_VALUE = 1e15


@dataclass(frozen=True)
class SparseCamera:
    """Intrinsics as COLMAP stores them: model name, size in pixels, parameters in the model's own order."""

    id: int
    model: str
    width: int
    height: int
    params: tuple[float, ...]


@dataclass(frozen=True)
class SparseImage:
    """A registered photo.

    Attributes:
        quaternion: (w, x, y, z), world -> camera, float64 [4].
        translation: float64 [3].
        keypoints: float64 [K, 2] in pixels of the camera (distorted).
        point_ids: int64 [K], :data:`NO_POINT` where no point was triangulated.
    """

    id: int
    name: str
    camera_id: int
    quaternion: NDArray[np.float64]
    translation: NDArray[np.float64]
    keypoints: NDArray[np.float64]
    point_ids: NDArray[np.int64]


@dataclass(frozen=True)
class SparsePoints:
    """``P`` points with ``T`` track elements; element ``start[i]:start[i + 1]`` belong to point i.

    Attributes:
        ids: int64 [P].
        xyz: float64 [P, 3].
        rgb: uint8 [P, 3].
        errors: float64 [P], mean reprojection error in pixels; negative where unknown.
        start: int64 [P + 1].
        image_ids: int64 [T].
        keypoint: int64 [T], index into the image's keypoints.
    """

    ids: NDArray[np.int64]
    xyz: NDArray[np.float64]
    rgb: NDArray[np.uint8]
    errors: NDArray[np.float64]
    start: NDArray[np.int64]
    image_ids: NDArray[np.int64]
    keypoint: NDArray[np.int64]

    @cached_property
    def track_point(self) -> NDArray[np.int64]:
        """Index of the point of each track element, [T]."""
        return np.repeat(np.arange(len(self.ids)), np.diff(self.start))


@dataclass(frozen=True)
class Rigs:
    """Rigs and frames of COLMAP 4, as far as they are needed to see whether the files belong together.

    Attributes:
        rig_ids: ids of the rigs.
        sensors: camera ids of all rigs.
        frame_rigs: the rig of each frame.
        frame_images: image ids of all frames.
    """

    rig_ids: list[int]
    sensors: list[int]
    frame_rigs: list[int]
    frame_images: list[int]


@dataclass(frozen=True)
class SparseModel:
    """The content of a COLMAP model; checked by :func:`check_model`."""

    folder: Path
    cameras: dict[int, SparseCamera]
    images: tuple[SparseImage, ...]
    points: SparsePoints
    rigs: Rigs | None

    @cached_property
    def track_view(self) -> NDArray[np.int32]:
        """Index of the image of each track element, [T]; of any image where the model has none of that id."""
        ids = np.array([image.id for image in self.images], np.int64)
        order = np.argsort(ids)
        slot = np.minimum(np.searchsorted(ids[order], self.points.image_ids), len(ids) - 1)
        return order[slot].astype(np.int32)

    def observations(self, index: int) -> NDArray[np.int64]:
        """Return the track elements of one image, ascending."""
        return self._by_view[index]

    @cached_property
    def _by_view(self) -> list[NDArray[np.int64]]:
        return rows_by_view(self.track_view, len(self.images))


def damaged(path: Path, detail: str) -> NoReturn:
    """Refuse a file that ends too early or holds nonsense.

    Raises:
        BadInput: always, for what fails inside.
    """
    raise BadInput(f"The COLMAP file '{path}' is cut off or damaged ({detail}); copy or export it again.")


def parameter_count(model: str, path: Path) -> int:
    """Return the number of parameters of a camera model.

    Raises:
        BadInput: COLMAP has no such model.
    """
    known = pycolmap.CameraModelId.__members__
    if model == "INVALID" or model not in known:
        raise BadInput(
            f"'{path}' uses the unknown camera model '{model}'; export with one of COLMAP's own, such as OPENCV."
        )
    return len(pycolmap.Camera.create_from_model_id(1, known[model], 1.0, 2, 2).params)


def check_model(model: SparseModel) -> None:
    """Check that every number is finite and that the files refer to each other consistently.

    Raises:
        BadInput: naming the first thing that is wrong.
    """
    for camera in model.cameras.values():
        _check_camera(camera, model.folder)
    _check_images(model)
    _check_points(model)
    if model.rigs is not None:
        _check_rigs(model, model.rigs)


def _check_camera(camera: SparseCamera, folder: Path) -> None:
    """Check the size, model and parameters of a camera.

    Raises:
        BadInput: something is wrong.
    """
    where = f"Camera {camera.id} in '{folder}'"
    if not (0 < camera.width <= _LARGEST_SIDE and 0 < camera.height <= _LARGEST_SIDE):
        raise BadInput(f"{where} has the size {camera.width} x {camera.height}; export the COLMAP model again.")
    if camera.model in _NOT_PLANAR:
        raise BadInput(f"{where} is {camera.model}, which has no image plane; cut perspective views from it first.")
    if not np.isfinite(camera.params).all():
        raise BadInput(f"{where} has parameters that are not finite; export the COLMAP model again.")
    focal = camera.params[: 1 if _single_focal(camera.model) else 2]
    if min(focal) <= 0.0 or max(focal) > 1e3 * max(camera.width, camera.height):
        raise BadInput(f"{where} has an impossible focal length ({min(focal):g} px); export the COLMAP model again.")


def _single_focal(model: str) -> bool:
    known = pycolmap.CameraModelId.__members__[model]
    return len(pycolmap.Camera.create_from_model_id(1, known, 1.0, 2, 2).focal_length_idxs()) == 1


def _check_images(model: SparseModel) -> None:
    """Check the names, poses and keypoints of the photos.

    Raises:
        BadInput: something is wrong.
    """
    if not model.images:
        raise BadInput(f"The COLMAP model '{model.folder}' has no registered photo; run the mapper again.")
    names: set[str] = set()
    ids: set[int] = set()
    for image in model.images:
        where = f"Photo '{image.name}' in '{model.folder}'"
        if not image.name:
            raise BadInput(f"Photo {image.id} in '{model.folder}' has no name; export the COLMAP model again.")
        if image.name in names or image.id in ids:
            raise BadInput(f"{where} is listed twice; export the COLMAP model again.")
        names.add(image.name)
        ids.add(image.id)
        if image.camera_id not in model.cameras:
            raise BadInput(f"{where} uses camera {image.camera_id}, which is missing; export the COLMAP model again.")
        if not (_sane(image.quaternion) and _sane(image.translation) and np.linalg.norm(image.quaternion) > 1e-3):
            raise BadInput(f"{where} has a pose that is not finite or beyond reason; export the COLMAP model again.")
        if not _sane(image.keypoints):
            raise BadInput(f"{where} has keypoints that are not finite; export the COLMAP model again.")


def _sane(values: NDArray[np.float64]) -> bool:
    """Tell whether all numbers are finite and small enough to be squared and added up."""
    return bool((np.abs(values) < _LARGEST_VALUE).all())


def _check_points(model: SparseModel) -> None:
    """Check the coordinates of the points, and that points and photos name each other.

    Raises:
        BadInput: something is wrong.
    """
    points = model.points
    again = "export the COLMAP model again."
    if len(points.ids) == 0:
        raise BadInput(f"The COLMAP model '{model.folder}' has no points; triangulate it, the job starts from them.")
    if len(np.unique(points.ids)) != len(points.ids):
        raise BadInput(f"The COLMAP model '{model.folder}' lists a point twice; {again}")
    if not _sane(points.xyz):
        bad = int(points.ids[~(np.abs(points.xyz) < _LARGEST_VALUE).all(1)][0])
        raise BadInput(f"Point {bad} in '{model.folder}' has coordinates that are not finite; {again}")
    seen = _point_of_keypoint(model)
    owner = np.repeat(points.ids, np.diff(points.start))
    if not np.array_equal(seen, owner):
        bad = int(owner[np.flatnonzero(seen != owner)[0]])
        raise BadInput(
            f"Points and photos of '{model.folder}' disagree (point {bad}): damaged files or two models; {again}"
        )
    claimed = sum(int((image.point_ids != NO_POINT).sum()) for image in model.images)
    if claimed != len(owner):
        raise BadInput(
            f"The photos of '{model.folder}' name {claimed} observations, the points {len(owner)}: "
            f"the files are cut off or of two models; {again}"
        )


def _point_of_keypoint(model: SparseModel) -> NDArray[np.int64]:
    """Find the point that the keypoint of each track element refers to; NO_POINT without such a keypoint."""
    points = model.points
    counts = np.array([len(image.point_ids) for image in model.images], np.int64)
    first = np.concatenate([[0], np.cumsum(counts)])
    ids, which = np.array([image.id for image in model.images], np.int64), model.track_view
    valid = (ids[which] == points.image_ids) & (points.keypoint >= 0) & (points.keypoint < counts[which])
    everything = np.concatenate([image.point_ids for image in model.images] or [np.empty(0, np.int64)])
    result = np.full(len(points.image_ids), NO_POINT, np.int64)
    result[valid] = everything[(first[which] + points.keypoint)[valid]]
    return result


def _check_rigs(model: SparseModel, rigs: Rigs) -> None:
    """Check that rigs and frames name each other, the cameras and the photos.

    Raises:
        BadInput: something is wrong.
    """
    again = "copy or export the whole model again."
    if len(set(rigs.rig_ids)) != len(rigs.rig_ids) or not set(rigs.frame_rigs) <= set(rigs.rig_ids):
        raise BadInput(f"The rigs and frames of '{model.folder}' do not belong together; {again}")
    if not set(rigs.sensors) <= set(model.cameras):
        raise BadInput(f"The rigs of '{model.folder}' name a camera that is missing; {again}")
    left = {image.id for image in model.images} - set(rigs.frame_images)
    if left:
        raise BadInput(f"The frames of '{model.folder}' leave out photo {min(left)}; {again}")
