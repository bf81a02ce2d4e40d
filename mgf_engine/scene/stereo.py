# SPDX-License-Identifier: GPL-3.0-or-later
"""Depth of one view by semi-global matching against a neighbour (OpenCV's SGBM on a rectified pair).

Both photos are turned by a rotation about their centres so that the baseline becomes the x axis; this works for
neighbours beside, above or below each other alike, because the turn may be in the picture plane too.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.model.scene import View

_BLOCK = 5  # px, matching window
_LARGEST_RANGE = 256  # disparities searched at most
_LARGEST_SIDE = 4.0  # a rectified picture may be this many times as long as the photo's longest side
_SMOOTHNESS = (8, 32)  # SGBM's P1 and P2 per pixel of the window


@dataclass(frozen=True)
class Photo:
    """A view's photo at the resolution stereo works at, with its intrinsics there.

    Attributes:
        grey: uint8 [h, w].
        inside: bool [h, w]; the pixels whose depth is wanted.
        intrinsics: [3, 3] at this resolution.
    """

    view: View
    grey: NDArray[np.uint8]
    inside: NDArray[np.bool_]
    intrinsics: NDArray[np.float64]


def pair_depth(first: Photo, second: Photo, points: NDArray[np.float64]) -> NDArray[np.float32] | None:
    """Depth of ``first`` (its own z, normalised frame), [h, w], 0 where unknown; None for a pair that cannot work.

    Args:
        points: [N, 3] sparse points both views see; they bound the search.
    """
    rotation = _common_rotation(first.view, second.view)
    baseline = float((rotation @ (second.view.centre - first.view.centre))[0])
    local = (points - first.view.centre) @ rotation.T
    local_second = (points - second.view.centre) @ rotation.T
    if len(points) < 8 or baseline < 1e-6 or (local[:, 2] <= 0).any() or (local_second[:, 2] <= 0).any():
        return None
    focal = (first.intrinsics[0, 0] + second.intrinsics[0, 0]) / 2
    frames = [_Frame.around(p, rotation, focal) for p in (first, second)]
    if any(f is None for f in frames):
        return None
    left, right = frames
    assert left is not None and right is not None
    # One row of the pair must be one row of the scene: both frames share their vertical extent.
    top = min(left.top, right.top)
    height = max(left.top + left.height, right.top + right.height) - top
    left, right = left.with_rows(top, height), right.with_rows(top, height)
    shift = left.left - right.left  # disparity of a point at infinity, before the offsets
    disparity = focal * baseline / local[:, 2] - shift
    low, high = np.percentile(disparity, [1, 99])
    margin = 0.25 * (high - low) + 4
    lowest, count = int(np.floor(low - margin)), int(np.ceil((high - low + 2 * margin) / 16)) * 16
    if count > _LARGEST_RANGE:
        return None
    found = _match(left.warp(first.grey), right.warp(second.grey), lowest, count)
    total = found + shift
    depth_rectified = np.where((found > lowest) & (total > 1e-3), focal * baseline / np.maximum(total, 1e-3), 0)
    return left.depth_in_photo(depth_rectified.astype(np.float32))


@dataclass(frozen=True)
class _Frame:
    """One rectified picture: the photo seen through ``rotation`` with focal length ``focal``.

    Pixel (x, y) of the picture is the direction ``((x + 0.5 + left) / focal, (y + 0.5 + top) / focal, 1)``.
    """

    photo: Photo
    rotation: NDArray[np.float64]
    focal: float
    left: int
    top: int
    width: int
    height: int

    @classmethod
    def around(cls, photo: Photo, rotation: NDArray[np.float64], focal: float) -> _Frame | None:
        """The frame that holds the wanted pixels of ``photo``; None when the turn is too far for that."""
        rows, columns = np.nonzero(photo.inside)
        if len(rows) == 0:
            return None
        box = np.array([[columns.min(), rows.min()], [columns.max() + 1, rows.min()],
                        [columns.min(), rows.max() + 1], [columns.max() + 1, rows.max() + 1]], float)  # fmt: skip
        rays = np.c_[box, np.ones(4)] @ np.linalg.inv(photo.intrinsics).T @ photo.view.rotation @ rotation.T
        if (rays[:, 2] < 0.2 * np.linalg.norm(rays, axis=1)).any():
            return None
        uv = rays[:, :2] / rays[:, 2:] * focal
        low, high = np.floor(uv.min(0)).astype(int), np.ceil(uv.max(0)).astype(int)
        if (high - low).max() > _LARGEST_SIDE * max(photo.grey.shape):
            return None
        return cls(photo, rotation, focal, int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1]))

    def with_rows(self, top: int, height: int) -> _Frame:
        return _Frame(self.photo, self.rotation, self.focal, self.left, top, self.width, height)

    def to_photo(self) -> NDArray[np.float64]:
        """[3, 3] homography from continuous picture coordinates to continuous photo coordinates."""
        back = np.array([[1, 0, self.left], [0, 1, self.top], [0, 0, self.focal]], float)
        return self.photo.intrinsics @ self.photo.view.rotation @ self.rotation.T @ back

    def warp(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        half = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])  # pixel index -> continuous coordinate
        matrix = np.linalg.inv(half) @ self.to_photo() @ half
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        return np.asarray(cv2.warpPerspective(image, matrix, (self.width, self.height), flags=flags), np.uint8)

    def depth_in_photo(self, depth: NDArray[np.float32]) -> NDArray[np.float32]:
        """Depth along the frame's z axis -> depth along the photo's own, sampled at the photo's pixels."""
        height, width = self.photo.grey.shape
        x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
        rays = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(self.photo.intrinsics).T
        turned = rays @ (self.rotation @ self.photo.view.rotation.T).T
        scale = np.maximum(turned[..., 2], 1e-6)
        column = turned[..., 0] / scale * self.focal - self.left - 0.5
        row = turned[..., 1] / scale * self.focal - self.top - 0.5
        sampled = cv2.remap(depth, column.astype(np.float32), row.astype(np.float32), cv2.INTER_NEAREST)
        # The photo's ray has z = 1, so its multiple is the photo's depth; the frame's depth is that times turned z.
        return np.where(self.photo.inside, sampled / scale, 0).astype(np.float32)


def _common_rotation(first: View, second: View) -> NDArray[np.float64]:
    """Rotation (normalised -> rectified) with x along the baseline and z as near both view directions as can be."""
    x = second.centre - first.centre
    x = x / max(float(np.linalg.norm(x)), 1e-12)
    z = first.rotation[2] + second.rotation[2]
    z = z - (z @ x) * x
    z = z / max(float(np.linalg.norm(z)), 1e-12)
    return np.stack([x, np.cross(z, x), z])


def _match(left: NDArray[np.uint8], right: NDArray[np.uint8], lowest: int, count: int) -> NDArray[np.float32]:
    """Disparity in pixels, ``left x - right x``; below ``lowest`` where unknown."""
    matcher = cv2.StereoSGBM.create(
        minDisparity=lowest, numDisparities=count, blockSize=_BLOCK, P1=_SMOOTHNESS[0] * _BLOCK**2,
        P2=_SMOOTHNESS[1] * _BLOCK**2, disp12MaxDiff=1, uniquenessRatio=8, speckleWindowSize=40, speckleRange=2,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )  # fmt: skip
    # SGBM cannot judge columns whose search leaves the right picture, so both get a margin of the search's width.
    width = max(left.shape[1], right.shape[1])
    before, after = max(0, lowest + count), max(0, -lowest)
    padded = [
        cv2.copyMakeBorder(image, 0, 0, before, after + width - image.shape[1], cv2.BORDER_REPLICATE)
        for image in (left, right)
    ]
    found = matcher.compute(padded[0], padded[1]).astype(np.float32) / 16.0
    return np.ascontiguousarray(found[:, before : before + left.shape[1]])
