# SPDX-License-Identifier: GPL-3.0-or-later
"""Compute the depth of one view by semi-global matching against a neighbour (OpenCV's SGBM on a rectified pair).

Both photos are turned by a rotation about their centres so that the baseline becomes the x axis; this works for
neighbours beside, above or below each other alike, because the turn may be in the picture plane too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.model.scene import View
from mgf_engine.options.algorithms import parameter
from mgf_engine.scene.kernel_photos import pack_quads
from mgf_engine.scene.neighbours import NeighbourOptions

_STEPS = 16  # of a disparity in SGBM per pixel


@dataclass(frozen=True)
class StereoOptions:
    """Options of semi-global matching; the last seven are OpenCV's StereoSGBM's own."""

    least_points: int = parameter(8, "Minimum number of sparse points that both photos see", low=1)
    tolerance: float = parameter(
        0.008, "Difference up to which the depths of two photos agree, as a share of the depth", low=1e-6, high=1
    )
    largest_side: float = parameter(
        4.0, "Maximum length of a rectified photo, as a factor of the photo's longest side", low=1
    )
    largest_turn: float = parameter(
        0.2, "Minimum cosine between a ray of the photo and the viewing direction of the rectified one", high=1
    )
    search_margin: tuple[float, float] = parameter(
        (0.25, 4.0), "Search beyond the disparities of the sparse points: share of their range, and disparities", "px"
    )
    largest_range: int = parameter(256, "Maximum number of disparities that are searched", "px", low=16)
    window: int = parameter(2, "Half width of the matching window (blockSize)", "px", low=0, high=10)
    penalties: tuple[int, int] = parameter(
        (8, 32), "Penalty for a change of disparity by 1 and by more, per pixel of the window (P1, P2)"
    )
    left_right: int = parameter(1, "Maximum difference of both photos' disparities (disp12MaxDiff)", "px")
    uniqueness: int = parameter(
        8, "Margin in percent by which the best match must win against the second (uniquenessRatio)", high=100
    )
    speckle_size: int = parameter(
        40, "Size up to which patches of other disparity are dropped (speckleWindowSize)", "px"
    )
    speckle_range: int = parameter(2, "Maximum change of disparity within a speckle (speckleRange)", "px")

    neighbours: NeighbourOptions = NeighbourOptions()


@dataclass(frozen=True)
class StereoPhoto:
    """A view's photo at the resolution that stereo works at.

    Attributes:
        view: the camera at that resolution.
        grey: uint8 [h, w].
        inside: bool [h, w]; the pixels whose depth is wanted.
    """

    view: View
    grey: NDArray[np.uint8]
    inside: NDArray[np.bool_]

    @cached_property
    def quads(self) -> NDArray[np.uint32]:
        """The photo as the kernels read it, [h, w]."""
        return pack_quads(self.grey)


def pair_depth(
    first: StereoPhoto, second: StereoPhoto, points: NDArray[np.float64], options: StereoOptions = StereoOptions()
) -> NDArray[np.float32] | None:
    """Compute the depth of one photo by matching it with another.

    Args:
        first: the photo whose depth is wanted.
        second: the photo it is matched with.
        points: [N, 3] sparse points that both see, normalised frame; they bound the search.
        options: of the matching.

    Returns:
        Depth along the first photo's z axis in normalised units, 0 where unknown, [h, w]; None where the two cannot be
        matched: too few points, no baseline, or a search that is too wide.
    """
    rotation = _common_rotation(first.view, second.view)
    baseline = float((rotation @ (second.view.centre - first.view.centre))[0])
    local = (points - first.view.centre) @ rotation.T
    local_second = (points - second.view.centre) @ rotation.T
    behind = (local[:, 2] <= 0).any() or (local_second[:, 2] <= 0).any()
    if len(points) < options.least_points or baseline < 1e-6 or behind:
        return None
    focal = (first.view.fx + second.view.fx) / 2
    frames = _rectified(first, second, rotation, focal, options)
    if frames is None:
        return None
    left, right = frames
    shift = left.left - right.left  # disparity of a point at infinity, before the offsets
    lowest, count = _search_range(focal * baseline / local[:, 2] - shift, options)
    if count > options.largest_range:
        return None
    found = _match(left.warp(first.grey), right.warp(second.grey), lowest, count, options)
    total = (found + shift).astype(np.float64)
    depth_rectified = np.where((found > lowest) & (total > 1e-3), focal * baseline / np.maximum(total, 1e-3), 0)
    return left.depth_in_photo(depth_rectified.astype(np.float32))


def _rectified(
    first: StereoPhoto, second: StereoPhoto, rotation: NDArray[np.float64], focal: float, options: StereoOptions
) -> tuple[_Frame, _Frame] | None:
    """Make the rectified pair, whose rows show the same; None where a photo is turned too far for that."""
    left, right = (_Frame.around(photo, rotation, focal, options) for photo in (first, second))
    if left is None or right is None:
        return None
    top = min(left.top, right.top)
    height = max(left.top + left.height, right.top + right.height) - top
    return replace(left, top=top, height=height), replace(right, top=top, height=height)


def _search_range(disparity: NDArray[np.float64], options: StereoOptions) -> tuple[int, int]:
    """Return the lowest disparity and the number of disparities to search, by those of the sparse points [N]."""
    low, high = np.percentile(disparity, [1, 99])
    share, least = options.search_margin
    margin = share * (high - low) + least
    return int(np.floor(low - margin)), int(np.ceil((high - low + 2 * margin) / 16)) * 16  # SGBM wants 16 k


@dataclass(frozen=True)
class _Frame:
    """One rectified picture: the photo seen through ``rotation`` with focal length ``focal``.

    Pixel (x, y) of the picture is the direction ``((x + 0.5 + left) / focal, (y + 0.5 + top) / focal, 1)``.
    """

    photo: StereoPhoto
    rotation: NDArray[np.float64]
    focal: float
    left: int
    top: int
    width: int
    height: int

    @classmethod
    def around(
        cls, photo: StereoPhoto, rotation: NDArray[np.float64], focal: float, options: StereoOptions
    ) -> _Frame | None:
        """Make the frame that holds the wanted pixels of ``photo``; None when the turn is too far for that."""
        rows, columns = np.nonzero(photo.inside)
        if len(rows) == 0:
            return None
        box = np.array([[columns.min(), rows.min()], [columns.max() + 1, rows.min()],
                        [columns.min(), rows.max() + 1], [columns.max() + 1, rows.max() + 1]], float)  # fmt: skip
        rays = np.c_[box, np.ones(4)] @ np.linalg.inv(photo.view.intrinsics).T @ photo.view.rotation @ rotation.T
        if (rays[:, 2] < options.largest_turn * np.linalg.norm(rays, axis=1)).any():
            return None
        uv = rays[:, :2] / rays[:, 2:] * focal
        low, high = np.floor(uv.min(0)).astype(int), np.ceil(uv.max(0)).astype(int)
        if (high - low).max() > options.largest_side * max(photo.grey.shape):
            return None
        return cls(photo, rotation, focal, int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1]))

    def to_photo(self) -> NDArray[np.float64]:
        """Return the homography [3, 3] from continuous picture coordinates to continuous photo coordinates."""
        back = np.array([[1, 0, self.left], [0, 1, self.top], [0, 0, self.focal]], float)
        return self.photo.view.intrinsics @ self.photo.view.rotation @ self.rotation.T @ back

    def warp(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Rectify the photo's image, uint8 [h, w] -> [height, width]."""
        half = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])  # pixel index -> continuous coordinate
        matrix = np.linalg.inv(half) @ self.to_photo() @ half
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        return np.asarray(cv2.warpPerspective(image, matrix, (self.width, self.height), flags=flags), np.uint8)

    def depth_in_photo(self, depth: NDArray[np.float32]) -> NDArray[np.float32]:
        """Convert depth along the frame's z axis [height, width] to the photo's pixels and z axis, [h, w]."""
        height, width = self.photo.grey.shape
        x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
        rays = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(self.photo.view.intrinsics).T
        turned = rays @ (self.rotation @ self.photo.view.rotation.T).T
        scale = np.maximum(turned[..., 2], 1e-6)
        column = turned[..., 0] / scale * self.focal - self.left - 0.5
        row = turned[..., 1] / scale * self.focal - self.top - 0.5
        sampled = cv2.remap(depth, column.astype(np.float32), row.astype(np.float32), cv2.INTER_NEAREST)
        # The photo's ray has z = 1, so its multiple is the photo's depth; the frame's depth is that times turned z.
        return np.where(self.photo.inside, sampled / scale, 0).astype(np.float32)


def _common_rotation(first: View, second: View) -> NDArray[np.float64]:
    """Return the rotation [3, 3] (normalised -> rectified): x along the baseline, z near both viewing directions."""
    x = second.centre - first.centre
    x = x / max(float(np.linalg.norm(x)), 1e-12)
    z = first.rotation[2] + second.rotation[2]
    z = z - (z @ x) * x
    z = z / max(float(np.linalg.norm(z)), 1e-12)
    return np.stack([x, np.cross(z, x), z])


def _match(
    left: NDArray[np.uint8], right: NDArray[np.uint8], lowest: int, count: int, options: StereoOptions
) -> NDArray[np.float32]:
    """Match a rectified pair; returns disparities ``left x - right x`` in px, below ``lowest`` where unknown."""
    side = 2 * options.window + 1
    matcher = cv2.StereoSGBM.create(
        minDisparity=lowest, numDisparities=count, blockSize=side, P1=options.penalties[0] * side**2,
        P2=options.penalties[1] * side**2, disp12MaxDiff=options.left_right, uniquenessRatio=options.uniqueness,
        speckleWindowSize=options.speckle_size, speckleRange=options.speckle_range,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )  # fmt: skip
    # SGBM cannot match columns whose search leaves the right picture, so both get a margin of the search's width.
    width = max(left.shape[1], right.shape[1])
    before, after = max(0, lowest + count), max(0, -lowest)
    padded = [
        cv2.copyMakeBorder(image, 0, 0, before, after + width - image.shape[1], cv2.BORDER_REPLICATE)
        for image in (left, right)
    ]
    found = matcher.compute(padded[0], padded[1]).astype(np.float32) / _STEPS
    return np.ascontiguousarray(found[:, before : before + left.shape[1]])
