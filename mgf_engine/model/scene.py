# SPDX-License-Identifier: GPL-3.0-or-later
"""Result of the scene stage: cameras, photos, sparse points and their tracks, in the normalised frame.

Frames. *Scene frame*: the coordinates of the COLMAP model the user gave. *Normalised frame*: the building
near the origin at a scale where the median camera is 5 units away; everything after the scene stage works in
it, and exports go back through the exact inverse. Cameras look along +z, x right, y down (COLMAP); the centre
of the top-left pixel is (0.5, 0.5).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mgf_engine.files.images import read_rgb
from mgf_engine.model.photo_cache import PHOTOS, PhotoCache


@dataclass(frozen=True)
class Similarity:
    """``normalised = scale * (rotation @ scene) + translation`` for column vectors, float64."""

    scale: float
    rotation: NDArray[np.float64]  # [3, 3]
    translation: NDArray[np.float64]  # [3]

    def apply(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Convert scene frame to normalised frame; points [..., 3]."""
        return self.scale * (points @ self.rotation.T) + self.translation

    def invert(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Convert normalised frame to scene frame; points [..., 3]."""
        return ((points - self.translation) / self.scale) @ self.rotation


@dataclass(frozen=True)
class Lens:
    """The user's camera before undistortion: a COLMAP camera model, its size in pixels and its parameters."""

    model: str
    width: int
    height: int
    params: tuple[float, ...]


#: EXIF orientation -> sign of the camera's axis (x from 5 on, else y) that points up in the turned photo.
_HELD_UP = {1: -1.0, 2: -1.0, 3: 1.0, 4: 1.0, 5: -1.0, 6: -1.0, 7: 1.0, 8: 1.0}


@dataclass(frozen=True)
class View:
    """One undistorted photo at working resolution with its pinhole camera.

    Attributes:
        name: as in the COLMAP model (POSIX path, may hold folders); prompts use it.
        file: the working photo, relative to the job's ``scene`` folder.
        width, height: pixels of the working photo.
        fx, fy, cx, cy: intrinsics in pixels; the top-left pixel's centre is (0.5, 0.5).
        rotation, translation: ``camera = rotation @ normalised + translation``, float64 [3, 3], [3].
        original_width, original_height: pixels of the user's photo as its camera saw it (after an EXIF rotation, if
            the camera was calibrated on the rotated photo); clicks and masks from outside are given in this frame.
        lens: the camera before undistortion; None when the working photo is the original one merely resized.
        photo: where the user's photo lies; empty in scenes of earlier versions.
        orientation: EXIF orientation that was applied to it, 1 for none.
        held: EXIF orientation that the working photo lacks, 1 for none: how the camera was held, for up and right.
        gravity: up by the photo's own tags (a drone's gimbal), unit vector in the camera's frame; None without.
        gain: what its red, green and blue were multiplied by to bring all photos to one exposure.
    """

    name: str
    file: str
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    rotation: NDArray[np.float64]
    translation: NDArray[np.float64]
    original_width: int
    original_height: int
    lens: Lens | None = None
    photo: str = ""
    orientation: int = 1
    held: int = 1
    gravity: tuple[float, float, float] | None = None
    gain: tuple[float, float, float] = (1.0, 1.0, 1.0)

    @property
    def up(self) -> NDArray[np.float64]:
        """Up in the photo as people look at it, unit [3], normalised frame."""
        return _HELD_UP[self.held] * self.rotation[0 if self.held > 4 else 1]

    @property
    def right(self) -> NDArray[np.float64]:
        """Right or left in the photo as people look at it, unit [3], normalised frame."""
        return self.rotation[1 if self.held > 4 else 0]

    @property
    def intrinsics(self) -> NDArray[np.float64]:
        """The calibration matrix K, [3, 3]: camera frame -> homogeneous pixels."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]])

    @property
    def centre(self) -> NDArray[np.float64]:
        """Camera centre in the normalised frame, [3]."""
        return -self.rotation.T @ self.translation

    def resized(self, width: int, height: int) -> View:
        """Return the camera of the photo resized to ``width`` x ``height`` pixels."""
        sx, sy = width / self.width, height / self.height
        return replace(
            self, width=width, height=height, fx=self.fx * sx, fy=self.fy * sy, cx=self.cx * sx, cy=self.cy * sy
        )

    def pixel_rays(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return x [W] and y [H]: the ray through the centre of a pixel is (x, y, 1) in the camera frame."""
        x = (np.arange(self.width, dtype=np.float64) + 0.5 - self.cx) / self.fx
        y = (np.arange(self.height, dtype=np.float64) + 0.5 - self.cy) / self.fy
        return x, y

    def project(self, points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Project by eq. 2 with its division by depth: points [N, 3] (normalised) -> pixels [N, 2], depth [N]."""
        # Coordinates as rows: numpy needs half the time it takes for points as rows.
        local = self.rotation @ points.T
        local += self.translation[:, None]
        depth = local[2]
        safe = np.where(np.abs(depth) < 1e-12, 1e-12, depth)
        uv = np.empty((len(points), 2))
        for axis, (focal, centre) in enumerate(((self.fx, self.cx), (self.fy, self.cy))):
            uv[:, axis] = local[axis] / safe * focal + centre
        return uv, depth

    def project_into_frame(
        self, points: NDArray[np.float64], margin: float = 0.0
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
        """Project points as :meth:`project` does, and tell which lie before the camera and in its frame.

        Args:
            points: [N, 3], normalised frame; one that is not a number is not in the frame.
            margin: least distance from the edges of the frame, px.

        Returns:
            Pixels [N, 2], depth [N], and bool [N].
        """
        uv, depth = self.project(points)
        inside = depth > 0
        for axis, size in enumerate((self.width, self.height)):
            inside &= (uv[:, axis] >= margin) & (uv[:, axis] < size - margin)
        return uv, depth, inside

    def unproject(self, uv: NDArray[np.floating], depth: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the points [N, 3] (normalised) that pixels [N, 2] show at a depth [N]: :meth:`project` undone."""
        ray = (uv - np.array([self.cx, self.cy])) / np.array([self.fx, self.fy])
        return np.asarray(self.centre + np.c_[ray * depth[:, None], depth] @ self.rotation, np.float64)


def most_pixels(views: Sequence[View]) -> int:
    """Return pixels of the largest working photo."""
    return max((view.width * view.height for view in views), default=0)


def rows_by_view(track_view: NDArray[np.integer], count: int) -> list[NDArray[np.int64]]:
    """Group observations by their view [T]: the rows of each of ``count`` views, ascending."""
    order = np.argsort(track_view, kind="stable")
    return np.split(order, np.searchsorted(track_view[order], np.arange(count + 1)))[1:-1]


@dataclass(frozen=True)
class Scene:
    """Cameras, sparse points and tracks; ``P`` points, ``T`` observations, ``V`` views.

    Attributes:
        views: the registered photos, in the order of their names.
        points: float64 [P, 3], normalised frame.
        colors: uint8 [P, 3].
        errors: float32 [P], mean reprojection error in pixels of the COLMAP cameras; 0 where unknown.
        track_start: int64 [P + 1]; observations of point i are ``track_start[i]:track_start[i + 1]``.
        track_view: int32 [T], index into ``views``.
        track_uv: float32 [T, 2], observed keypoint in working pixels (undistorted), always inside the frame.
        to_normalised: scene frame -> normalised frame.
        roots: indices of the views the user is asked to click on (a fifth, spread out).
        held_out: indices of the views kept out of training.
        folder: the job's ``scene`` folder (working photos lie under it).
        left_out: names of the user's photos that are not among the views; clicks on them are passed over.
    """

    views: tuple[View, ...]
    points: NDArray[np.float64]
    colors: NDArray[np.uint8]
    errors: NDArray[np.float32]
    track_start: NDArray[np.int64]
    track_view: NDArray[np.int32]
    track_uv: NDArray[np.float32]
    to_normalised: Similarity
    roots: tuple[int, ...]
    held_out: tuple[int, ...]
    folder: Path
    left_out: tuple[str, ...] = ()
    _photos: PhotoCache = field(default=PHOTOS, repr=False, compare=False)

    @cached_property
    def track_point(self) -> NDArray[np.int64]:
        """Index of the point of each observation, [T]."""
        return np.repeat(np.arange(len(self.points)), np.diff(self.track_start))

    def observations(self, index: int) -> NDArray[np.int64]:
        """Return rows of the observations of one view, ascending."""
        return self._by_view[index]

    @cached_property
    def _by_view(self) -> list[NDArray[np.int64]]:
        return rows_by_view(self.track_view, len(self.views))

    def photo(self, index: int) -> NDArray[np.uint8]:
        """Return the working photo of a view, RGB uint8 [height, width, 3]; it may not be written to."""
        return self._photos.get(self.folder / self.views[index].file, read_rgb)
