# SPDX-License-Identifier: GPL-3.0-or-later
"""Match each photo with its camera (size, EXIF rotation) and make the working photos, several at a time."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mgf_engine.errors import BadInput
from mgf_engine.files.images import PhotoInfo, UnreadablePhoto, apply_orientation, read_infos, read_rgb, write_png
from mgf_engine.messages import Reporter
from mgf_engine.model.scene import View
from mgf_engine.scene.cameras import WorkingCamera, plan_camera
from mgf_engine.scene.sparse import NO_POINT, SparseCamera, SparseImage, SparseModel
from mgf_engine.system.machine import cores
from mgf_engine.system.memory import share

#: Bytes that photos being decoded may take together, and the share of the job's memory where that is less; a photo
#: takes about nine times its pixels.
_MEMORY = 800 << 20
_SHARE = 0.25
_BYTES_PER_PIXEL = 9
_MAX_WORKERS = 8


@dataclass(frozen=True)
class Photo:
    """One photo of the model and what is done to it.

    Attributes:
        name: as the model has it.
        width, height: as its camera sees it, in pixels.
        orientation: the EXIF orientation to apply; 1 leaves the stored pixels.
        file: name of the working photo in the ``images`` folder.
        held: the EXIF orientation that is not applied, because the camera saw the stored pixels; 1 for none.
        gravity: up by the photo's tags, unit vector in the camera's frame; None without, or where it is turned.
    """

    name: str
    path: Path
    width: int
    height: int
    orientation: int
    file: str
    camera: WorkingCamera
    held: int = 1
    gravity: tuple[float, float, float] | None = None


def plan_photos(model: SparseModel, paths: list[Path], resolution: int, reporter: Reporter) -> list[Photo]:
    """Read the header of each photo, and choose its size, rotation and working camera.

    An unreadable photo gets the size of its camera; :func:`make_photos` reports it.

    Args:
        model: cameras of the photos.
        paths: of the photos, in the order of the model's images.
        resolution: longest side of the working photos, px.
        reporter: for warnings.

    Raises:
        BadInput: a photo does not fit its camera.
    """
    colors = _colors_by_id(model)
    cameras: dict[tuple[int, int, int], WorkingCamera] = {}
    photos: list[Photo] = []
    scaled: list[str] = []
    infos = read_infos(paths)
    for index, (image, path, info) in enumerate(zip(model.images, paths, infos, strict=True)):
        reporter.check()
        camera = model.cameras[image.camera_id]
        width, height, orientation = _seen_size(info, camera, image, path, colors)
        if (width, height) != (camera.width, camera.height):
            scaled.append(f"'{image.name}' is {width} x {height}, its camera {camera.width} x {camera.height}")
        key = (camera.id, width, height)
        if key not in cameras:
            cameras[key] = plan_camera(camera, (width, height), resolution)
        file = _file_name(index, image.name)
        stored = info if isinstance(info, PhotoInfo) and orientation == 1 else None
        held, gravity = (stored.orientation, stored.tags.up) if stored else (1, None)
        photos.append(Photo(image.name, path, width, height, orientation, file, cameras[key], held, gravity))
    if scaled:
        reporter.warning(
            f"{len(scaled)} of {len(photos)} photos have another size than their camera ({scaled[0]}); "
            "the cameras were scaled to the photos."
        )
    return photos


def make_photos(
    photos: list[Photo], folder: Path, threads: int, progress: Callable[[float], None]
) -> dict[int, UnreadablePhoto]:
    """Decode, undistort and resize all photos into ``folder``, in parallel within a memory budget.

    Args:
        photos: planned ones.
        folder: where the working photos go.
        threads: number of worker threads; 0 uses all cores.
        progress: called with the share that is done, 0..1.

    Returns:
        The photos that cannot be decoded, index -> what is wrong; nothing is written for them.
    """
    largest = max(p.width * p.height for p in photos) * _BYTES_PER_PIXEL
    workers = max(1, min(threads or cores(), _MAX_WORKERS, share(_SHARE, _MEMORY) // largest))
    with ThreadPoolExecutor(workers) as pool:
        jobs = [pool.submit(_make_photo, photo, folder) for photo in photos]
        unreadable: dict[int, UnreadablePhoto] = {}
        try:
            for i, job in enumerate(jobs):
                try:
                    job.result()
                except UnreadablePhoto as error:
                    unreadable[i] = error
                progress((i + 1) / len(jobs))
        finally:
            for job in jobs:
                job.cancel()
    return unreadable


class PhotoMemory:
    """Memory budget of the photos that threads decode at the same time.

    One photo always fits, however large.
    """

    def __init__(self) -> None:
        self._taken = 0
        self._changed = threading.Condition()

    @contextmanager
    def reserve(self, width: int, height: int) -> Iterator[None]:
        """Wait until a photo of ``width`` x ``height`` pixels fits, and reserve its memory inside the block."""
        wanted, budget = width * height * _BYTES_PER_PIXEL, share(_SHARE, _MEMORY)
        with self._changed:
            self._changed.wait_for(lambda: self._taken == 0 or self._taken + wanted <= budget)
            self._taken += wanted
        try:
            yield
        finally:
            with self._changed:
                self._taken -= wanted
                self._changed.notify_all()


def original_photo(view: View) -> NDArray[np.uint8]:
    """Return the user's photo of a view, as its camera saw it, RGB uint8 [original_height, original_width, 3].

    Raises:
        BadInput: it is gone, damaged or another one; or the scene does not say where it lies.
    """
    if not view.photo:
        raise BadInput("The job's scene was made by an earlier version and does not say where its photos are.")
    image = _turned(Path(view.photo), view.orientation)
    if image.shape[:2] != (view.original_height, view.original_width):
        raise BadInput(f"The photo '{view.photo}' has changed since the job began; put the original back.")
    return image


def _turned(path: Path, orientation: int) -> NDArray[np.uint8]:
    """Turn a photo as its camera saw it."""
    image = read_rgb(path)
    return image if orientation == 1 else apply_orientation(image, orientation)


def _make_photo(photo: Photo, folder: Path) -> None:
    image = _turned(photo.path, photo.orientation)
    if image.shape[:2] != (photo.height, photo.width):
        raise UnreadablePhoto(
            f"The photo '{photo.path}' does not have the size its header says; export the photo again."
        )
    write_png(folder / photo.file, photo.camera.make_photo(image))


def _seen_size(
    info: PhotoInfo | UnreadablePhoto, camera: SparseCamera, image: SparseImage, path: Path, colors: _Colors
) -> tuple[int, int, int]:
    """Return width and height of a photo as its camera saw it, and the EXIF orientation to apply for that."""
    if isinstance(info, UnreadablePhoto):
        return camera.width, camera.height, 1
    orientation = _orientation(info, camera, image, path, colors)
    return *(info.turned_size if orientation != 1 else (info.width, info.height)), orientation


def _orientation(info: PhotoInfo, camera: SparseCamera, image: SparseImage, path: Path, colors: _Colors) -> int:
    """Return the orientation that the camera was calibrated with: 1 for the stored pixels, else EXIF's.

    The aspect ratio decides; where it cannot (half turns, square photos), the colours of the points do.

    Raises:
        BadInput: the photo has another aspect ratio than its camera either way.
    """
    stored = _same_shape((info.width, info.height), camera)
    turned = info.orientation != 1 and _same_shape(info.turned_size, camera)
    if not stored and not turned:
        turned_since = _same_shape((info.height, info.width), camera)
        raise BadInput(
            f"The photo '{path}' is {info.width} x {info.height} pixels but its camera {camera.width} x "
            f"{camera.height}{', as if it was turned since' if turned_since else ''}; use the photos the COLMAP model "
            "was made from."
        )
    if stored and turned:
        return _orientation_by_color(info, camera, image, path, colors)
    return 1 if stored else info.orientation


def _orientation_by_color(
    info: PhotoInfo, camera: SparseCamera, image: SparseImage, path: Path, colors: _Colors
) -> int:
    """Choose between the stored pixels and EXIF's orientation by which shows the colours of the sparse points.

    Args:
        info: size and EXIF orientation of the photo.
        camera: that saw it.
        image: its observations.
        path: of the photo.
        colors: of the points.

    Returns:
        The orientation to apply; 1 where too few points tell, or the photo cannot be read.
    """
    seen = image.point_ids != NO_POINT
    if seen.sum() < 10:
        return 1
    expected = colors.of(image.point_ids[seen])
    try:
        photo = read_rgb(path)
    except UnreadablePhoto:
        return 1
    best = {}
    for orientation in (1, info.orientation):
        turned = apply_orientation(photo, orientation)
        height, width = turned.shape[:2]
        at = np.floor(image.keypoints[seen] * (width / camera.width, height / camera.height)).astype(np.int64)
        at = at.clip(0, (width - 1, height - 1))
        best[orientation] = np.abs(turned[at[:, 1], at[:, 0]].astype(np.float64) - expected).mean()
    return min(best, key=lambda o: best[o])


@dataclass(frozen=True)
class _Colors:
    """Colours of the points by id."""

    ids: NDArray[np.int64]  # sorted
    rgb: NDArray[np.uint8]

    def of(self, ids: NDArray[np.int64]) -> NDArray[np.float64]:
        return self.rgb[np.searchsorted(self.ids, ids)].astype(np.float64)


def _colors_by_id(model: SparseModel) -> _Colors:
    order = np.argsort(model.points.ids)
    return _Colors(model.points.ids[order], model.points.rgb[order])


def _same_shape(size: tuple[int, int], camera: SparseCamera) -> bool:
    """Tell whether two sizes have the same aspect ratio, up to rounding both sides to whole pixels."""
    width, height = size
    slack = 1.0 + max(width / camera.width, height / camera.height)
    return abs(height - width * camera.height / camera.width) <= slack or (
        abs(width - height * camera.width / camera.height) <= slack
    )


def _file_name(index: int, name: str) -> str:
    """Make a name of the working photo that sorts and reads like the user's and is safe on every system."""
    stem = name.replace("\\", "/").split("/")[-1].rsplit(".", 1)[0]
    return f"{index:04d}_{re.sub(r'[^A-Za-z0-9_-]+', '_', stem)[:40]}.png"
