# SPDX-License-Identifier: GPL-3.0-or-later
"""Convert cameras of any COLMAP model to undistorted pinhole cameras at the working resolution.

PINHOLE and SIMPLE_PINHOLE photos are only resized. All others are undistorted: COLMAP chooses the largest pinhole
picture without blank pixels, the map into the photo is made once per camera, and photos are sampled through it.
All pixel coordinates have the centre of the top-left pixel at (0.5, 0.5).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import pycolmap
from numpy.typing import NDArray

from mgf_engine.errors import BadInput
from mgf_engine.files.images import resize
from mgf_engine.model.scene import Lens, View
from mgf_engine.scene.sparse import SparseCamera

_PINHOLES = ("PINHOLE", "SIMPLE_PINHOLE")
#: Share of the undistorted picture that may look past the photo's edge, or at what another part shows too, before the
#: lens is refused.
_BLANK_LIMIT = 0.02
_STEP = 16  # the lens is checked on every 16th pixel


@dataclass(frozen=True)
class WorkingCamera:
    """The pinhole camera of working photos, and how to make one from a photo.

    Attributes:
        width, height, fx, fy, cx, cy: the pinhole camera in working pixels.
        lens: the camera before undistortion, or None when photos are only resized.
        source_size: width, height the photo is shrunk to before it is sampled (its own size when smaller).
        maps: float32 [h, w] columns and rows into the shrunk photo (OpenCV's convention), or None.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    lens: Lens | None
    source_size: tuple[int, int]
    maps: tuple[NDArray[np.float32], NDArray[np.float32]] | None

    def make_photo(self, photo: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Make the working photo [height, width, 3] of an original one of the size this camera was planned for."""
        if self.maps is None:
            return resize(photo, self.width, self.height)
        source = resize(photo, *self.source_size)
        exact = self.maps[0].shape == (self.height, self.width)
        kind = cv2.INTER_CUBIC if exact else cv2.INTER_LINEAR
        straight = cv2.remap(source, *self.maps, interpolation=kind, borderMode=cv2.BORDER_REPLICATE)
        return resize(straight, self.width, self.height)  # type: ignore[arg-type]

    def keypoints(self, observed: NDArray[np.float64], camera: SparseCamera) -> NDArray[np.float64]:
        """Convert keypoints [N, 2] in pixels of the COLMAP camera to working pixels; NaN where the lens has no such
        ray."""
        if self.lens is None:
            return observed * (self.width / camera.width, self.height / camera.height)
        return lens_rays(self.lens, observed) * (self.fx, self.fy) + (self.cx, self.cy)


def plan_camera(camera: SparseCamera, photo_size: tuple[int, int], resolution: int) -> WorkingCamera:
    """Choose the working camera of photos with ``photo_size`` (width, height; same aspect ratio as the camera).

    Args:
        resolution: longest side of the working photo; smaller photos keep their size.

    Raises:
        BadInput: the lens cannot be turned into a pinhole picture.
    """
    lens = Lens(camera.model, camera.width, camera.height, camera.params)
    original = lens_camera(lens)
    if not original.verify_params():
        raise BadInput(f"Camera {camera.id} ({camera.model}) has impossible parameters; export the COLMAP model again.")
    if camera.model in _PINHOLES or _is_straight(lens):
        scale = min(1.0, resolution / max(photo_size))
        width, height = (max(1, round(side * scale)) for side in photo_size)
        fx, fy, cx, cy = _pinhole(original)
        sx, sy = width / camera.width, height / camera.height
        return WorkingCamera(width, height, fx * sx, fy * sy, cx * sx, cy * sy, None, (width, height), None)
    straight = _undistorted(camera, original)
    photo_scale = max(photo_size) / max(camera.width, camera.height)
    longest = max(straight.width, straight.height)
    scale = min(photo_scale, resolution / longest)
    width, height = max(1, round(straight.width * scale)), max(1, round(straight.height * scale))
    fx, fy, cx, cy = _pinhole(straight)
    sx, sy = width / straight.width, height / straight.height
    # Twice the working resolution while sampling, then the area filter: sharp and free of aliasing.
    over = min(2.0, photo_scale / scale)
    over = 1.0 if over < 1.2 else over
    source = (round(camera.width * scale * over), round(camera.height * scale * over))
    view = WorkingCamera(width, height, fx * sx, fy * sy, cx * sx, cy * sy, lens, source, None)
    maps = _make_maps(view, round(width * over), round(height * over))
    return WorkingCamera(**{**view.__dict__, "maps": maps})


def from_original(view: View, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Convert pixels [N, 2] of the user's photo to working pixels; NaN beyond the lens."""
    points = np.asarray(points, np.float64).reshape(-1, 2)
    if view.lens is None:
        return points * (view.width / view.original_width, view.height / view.original_height)
    own = points * (view.lens.width / view.original_width, view.lens.height / view.original_height)
    return lens_rays(view.lens, own) * (view.fx, view.fy) + (view.cx, view.cy)


def to_original(view: View, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Convert working pixels [N, 2] to pixels of the user's photo."""
    points = np.asarray(points, np.float64).reshape(-1, 2)
    if view.lens is None:
        return points * (view.original_width / view.width, view.original_height / view.height)
    own = _project(view.lens, (points - (view.cx, view.cy)) / (view.fx, view.fy))
    return own * (view.original_width / view.lens.width, view.original_height / view.lens.height)


def warp_labels(view: View, labels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Warp labels in the frame of the user's photo (any scale) to [height, width] of the working photo, nearest
    pixel."""
    uv = to_original(view, _pixel_centres(view.width, view.height))
    height, width = labels.shape[:2]
    column = np.floor(uv[:, 0] * (width / view.original_width)).clip(0, width - 1).astype(np.int64)
    row = np.floor(uv[:, 1] * (height / view.original_height)).clip(0, height - 1).astype(np.int64)
    return labels[row, column].reshape(view.height, view.width, *labels.shape[2:])


def _undistorted(camera: SparseCamera, original: pycolmap.Camera) -> pycolmap.Camera:
    """Return COLMAP's pinhole camera without blank pixels.

    Raises:
        BadInput: there is none that lies inside the photo.
    """
    refuse = BadInput(
        f"Camera {camera.id} ({camera.model}, {camera.width} x {camera.height}) bends too much to be undistorted; "
        "check its parameters, or undistort the photos with COLMAP first."
    )
    try:
        straight = pycolmap.undistort_camera(pycolmap.UndistortCameraOptions(), original)
    except Exception as error:
        raise refuse from error
    if straight.width < 2 or straight.height < 2 or not np.isfinite(straight.params).all():
        raise refuse
    fx, fy, cx, cy = _pinhole(straight)
    grid = _pixel_centres(straight.width, straight.height, _STEP)
    lens = Lens(camera.model, camera.width, camera.height, camera.params)
    rays = (grid - (cx, cy)) / (fx, fy)
    uv = _project(lens, rays)
    inside = ((uv >= -1.0) & (uv <= (camera.width + 1.0, camera.height + 1.0))).all(1)
    # Far from what it was fitted to, a polynomial folds back: two rays then meet in one pixel.
    single = (np.abs(lens_rays(lens, uv) - rays) * (fx, fy) < 0.5).all(1)
    if (~(inside & single)).mean() > _BLANK_LIMIT:
        raise refuse
    return straight


def _is_straight(lens: Lens) -> bool:
    """Tell whether the lens is a pinhole within a pixel (COLMAP's own test also says so of plain fisheyes)."""
    grid = _pixel_centres(lens.width, lens.height, _STEP)
    fx, fy, cx, cy = _pinhole(lens_camera(lens))
    return bool((np.abs(lens_rays(lens, grid) * (fx, fy) + (cx, cy) - grid) < 1e-6).all())


def _make_maps(view: WorkingCamera, width: int, height: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Map each pixel of a ``width`` x ``height`` picture of the pinhole camera into the shrunk photo."""
    assert view.lens is not None
    columns = np.empty((height, width), np.float32)
    rows = np.empty((height, width), np.float32)
    sx, sy = view.source_size[0] / view.lens.width, view.source_size[1] / view.lens.height
    for first in range(0, height, 256):  # in bands: the rays of a whole large picture would take much memory
        band = _pixel_centres(width, min(256, height - first))
        band[:, 1] += first
        ray = (band * (view.width / width, view.height / height) - (view.cx, view.cy)) / (view.fx, view.fy)
        uv = _project(view.lens, ray) * (sx, sy) - 0.5
        columns[first : first + 256] = uv[:, 0].reshape(-1, width)
        rows[first : first + 256] = uv[:, 1].reshape(-1, width)
    return np.nan_to_num(columns, nan=-1.0), np.nan_to_num(rows, nan=-1.0)


def _pixel_centres(width: int, height: int, step: int = 1) -> NDArray[np.float64]:
    """Return the centres of every ``step``-th pixel, row by row, [N, 2]."""
    x, y = np.meshgrid(np.arange(0, width, step) + 0.5, np.arange(0, height, step) + 0.5)
    return np.stack([x.ravel(), y.ravel()], 1)


def lens_camera(lens: Lens) -> pycolmap.Camera:
    """Return the lens as COLMAP's camera."""
    return pycolmap.Camera(model=lens.model, width=lens.width, height=lens.height, params=list(lens.params))


def _project(lens: Lens, rays: NDArray[np.float64]) -> NDArray[np.float64]:
    """Project rays (x / z, y / z) [N, 2] to pixels of the lens [N, 2]; NaN where they miss it."""
    local = np.concatenate([rays, np.ones((len(rays), 1))], 1)
    return np.asarray(lens_camera(lens).img_from_cam(local), np.float64).reshape(-1, 2)


def lens_rays(lens: Lens, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    """Convert pixels of the lens [N, 2] to rays (x / z, y / z) [N, 2]; NaN where there is none."""
    found = lens_camera(lens).cam_from_img(np.ascontiguousarray(pixels, np.float64).reshape(-1, 2))
    return np.asarray(found, np.float64).reshape(-1, 2)


def _pinhole(camera: pycolmap.Camera) -> tuple[float, float, float, float]:
    return camera.focal_length_x, camera.focal_length_y, camera.principal_point_x, camera.principal_point_y
