# SPDX-License-Identifier: GPL-3.0-or-later
"""The pinhole camera of the rasterizer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mgf_engine.model.scene import View

TILE = 16  # pixels; csrc/raster/records.h


class Intrinsics(Protocol):
    """What the image losses need of a camera: focal lengths and principal point in pixels."""

    @property
    def fx(self) -> float: ...
    @property
    def fy(self) -> float: ...
    @property
    def cx(self) -> float: ...
    @property
    def cy(self) -> float: ...


@dataclass(frozen=True)
class Camera:
    """A pinhole camera in the normalised frame; looks along +z, x right, y down.

    Attributes:
        width, height: pixels.
        fx, fy, cx, cy: intrinsics in pixels; the centre of the top-left pixel is (0.5, 0.5).
        rotation, translation: ``camera = rotation @ normalised + translation``, float64 [3, 3], [3].
        near: depth; Gaussians whose centre is nearer, and responses nearer along a ray, are not drawn.
        far: with ``near``, maps depths for the distortion: m = far / (far - near) * (1 - near / t); clips nothing.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    rotation: NDArray[np.float64]
    translation: NDArray[np.float64]
    near: float = 0.2
    far: float = 100.0

    @classmethod
    def from_view(cls, view: View, factor: float = 1.0, near: float = 0.2, far: float = 100.0) -> Camera:
        """Return the camera of a view, its pictures reduced by ``factor`` (0.5: half the size, at least one pixel).

        Sizes are rounded to whole pixels and the intrinsics follow the size really taken, per axis.

        Args:
            view: camera of the photo.
            factor: by which its pictures are reduced.
            near: depth in front of which nothing is drawn, normalised units.
            far: depth that the distortion is mapped with (see :class:`Camera`), normalised units; clips nothing.
        """
        width, height = max(1, round(view.width * factor)), max(1, round(view.height * factor))
        x, y = width / view.width, height / view.height
        intrinsics = (view.fx * x, view.fy * y, view.cx * x, view.cy * y)
        return cls(width, height, *intrinsics, view.rotation, view.translation, near, far)

    @property
    def centre(self) -> NDArray[np.float64]:
        """Centre of projection in the normalised frame, [3]."""
        return -self.rotation.T @ self.translation

    @property
    def tiles(self) -> tuple[int, int]:
        """Number of tiles (rows, columns) that cover the frame."""
        return -(-self.height // TILE), -(-self.width // TILE)

    def packed(self) -> Tensor:
        """Return float32 [32] as the kernels read it (struct Camera in ``csrc/raster/records.h``)."""
        values = np.zeros(32, np.float32)
        values[0:9] = self.rotation.reshape(-1)
        values[9:12] = self.translation
        values[12:15] = self.centre
        values[15:23] = self.fx, self.fy, self.cx, self.cy, self.near, self.far, self.width, self.height
        return torch.from_numpy(values)


def pose_and_intrinsics(view: View) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return a view as the kernels that project points read it: rotation by rows and translation [12]; fx, fy, cx, cy
    [4]."""
    pose = np.concatenate([view.rotation.ravel(), view.translation])
    return pose, np.array([view.fx, view.fy, view.cx, view.cy])
