# SPDX-License-Identifier: GPL-3.0-or-later
"""The direction up (against gravity) in a scene: one function for masks, georeferencing, drawings and pictures.

In order of accuracy: the common vanishing direction of vertical edges of buildings (a tenth of a degree), the gravity
tags of the photos (1 degree), and the way people and drones hold cameras (2 degrees). Edges need one of the other two,
to know roughly where to look.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.geometry.normals import unit_vectors
from mgf_engine.model.scene import Scene, View
from mgf_engine.model.up_direction import UpDirection
from mgf_engine.native.parallel import parallel_map
from mgf_engine.options.algorithms import parameter

Array = NDArray[np.float64]


@dataclass(frozen=True)
class GravityOptions:
    """Options of the direction up."""

    tag_sd: float = parameter(1.0, "Standard deviation of gravity tags of photos", "degrees", low=1e-3)
    level_sd: float = parameter(2.0, "Standard deviation of up by cameras that are held level", "degrees", low=1e-3)
    near: float = parameter(10.0, "Maximum angle between a vertical edge and up by tags or cameras", "degrees", high=45)
    inlier: float = parameter(0.4, "Maximum angle between a vertical edge and up", "degrees", low=1e-3, high=45)
    least_sd: float = parameter(0.05, "Minimum standard deviation of up by vertical edges", "degrees", low=1e-6)
    least_edges: int = parameter(24, "Minimum number of vertical edges", low=3)
    least_photos: int = parameter(3, "Minimum number of photos with vertical edges", low=1)
    least_share: float = parameter(0.25, "Minimum share of the edges near up, by length, that are vertical", high=1)
    most_photos: int = parameter(40, "Maximum number of photos that edges are looked for in", low=1)
    samples: int = parameter(1500, "Number of pairs of edges that are tried (RANSAC)", low=1)
    least_length: float = parameter(0.04, "Minimum length of an edge, as a share of the photo's longest side", high=1)
    grid_photos: int = parameter(8, "Minimum number of photos of an aerial grid that looks straight down", low=3)
    grid_alignment: float = parameter(
        0.97, "Minimum length of the mean viewing direction of an aerial grid (1 if all look the same way)", high=1
    )
    grid_width: float = parameter(0.3, "Minimum width of an aerial grid, as a share of its length", high=1)
    steep: float = parameter(
        45.0, "Maximum angle between the mean viewing direction of photos from above and down", "degrees", high=90
    )


def find_up(scene: Scene, threads: int | None = None, options: GravityOptions = GravityOptions()) -> UpDirection:
    """Find up by the most accurate evidence that a scene has.

    Args:
        scene: cameras and photos.
        threads: maximum number of photos at a time; None for the number of kernel threads.
        options: accuracies and limits.
    """
    rough = rough_up(scene.views, options)
    return up_from_edges(scene, rough.vector, threads, options) or rough


def rough_up(views: Sequence[View], options: GravityOptions = GravityOptions()) -> UpDirection:
    """Find up by the gravity tags of the photos, or by the way their cameras are held."""
    tagged = [view.rotation.T @ np.array(view.gravity) for view in views if view.gravity is not None]
    if len(tagged) >= max(3, len(views) // 4):
        return UpDirection(unit_vectors(np.median(tagged, axis=0)), np.radians(options.tag_sd), "tags")
    return UpDirection(up_from_cameras(views, options), np.radians(options.level_sd), "cameras")


def up_from_cameras(views: Sequence[View], options: GravityOptions = GravityOptions()) -> Array:
    """Estimate up from how cameras are held: upright with a level horizon, or straight down; unit [3].

    Up is perpendicular to the x axes of level cameras. Where they look in too few directions to tell (a facade), the
    mean of what is up in the photos decides what they leave open; of steep photos from above it is level itself, and
    only the x axes count.
    """
    down = looking_down(views, options)
    if down is not None:
        return -down
    mean = np.mean([view.up for view in views], axis=0)
    length = float(np.linalg.norm(mean))
    mean = mean / length if length > 1e-6 else np.array([0.0, -1.0, 0.0])
    right = np.array([view.right for view in views])
    matrix = right.T @ right / len(right)
    spread, axes = np.linalg.eigh(matrix)
    if spread[1] > 0.05 and spread[1] > 4 * spread[0]:
        if _flown_over(views, axes[:, 0], options):
            return np.asarray(-axes[:, 0] * np.sign(axes[:, 0] @ _mean_axis(views)))
    else:
        axes = np.linalg.eigh(matrix - 0.05 * np.outer(mean, mean))[1]
    up = axes[:, 0] * np.sign(axes[:, 0] @ mean or 1.0)
    return np.asarray(up if up @ mean > 0.5 else mean)


def _mean_axis(views: Sequence[View]) -> Array:
    return np.asarray(np.mean([view.rotation[2] for view in views], axis=0))


def _flown_over(views: Sequence[View], vertical: Array, options: GravityOptions) -> bool:
    """Tell whether photos were taken from above: steeply along a direction [3], from places wide across it.

    What is up in such a photo is level rather than up, and says by where the camera headed. Photos of a front, some of
    them on their side, have one common perpendicular of their x axes, too, but come in a row.
    """
    steep = abs(float(_mean_axis(views) @ vertical)) > np.cos(np.radians(options.steep))
    return steep and _width_across(views, vertical)[1] > options.grid_width


def _width_across(views: Sequence[View], axis: Array) -> tuple[float, float]:
    """Return the larger extent of the camera centres across a direction [3], and the smaller as a share of it."""
    centres = np.stack([v.centre for v in views])
    centres = centres - centres.mean(0)
    wide = np.linalg.svd(centres - np.outer(centres @ axis, axis), compute_uv=False)
    return float(wide[0]), float(wide[1] / max(wide[0], 1e-12))


def up_of_tilted_view(
    view: View, others: Sequence[View], tilt: float, level_rms: float, options: GravityOptions = GravityOptions()
) -> Array | None:
    """Estimate up for a photo that is far from level, by all cameras, unit [3]; None where its own up serves.

    What is up in a photo is up in the world only as far as its camera is held level. All cameras know better, unless
    they were held in different ways or all look straight down.

    Args:
        view: the photo.
        others: all photos of the scene.
        tilt: degrees between the photo's own up and that of all cameras from which it counts as far from level.
        level_rms: the most that the cameras' horizontal axes may deviate from the horizon, RMS in degrees.
        options: of the estimate by all cameras.
    """
    up = up_from_cameras(others, options)
    slope = np.array([other.right for other in others]) @ up
    level = np.sqrt(np.mean(slope**2)) <= np.sin(np.radians(level_rms))
    tilted = view.up @ up < np.cos(np.radians(tilt))
    return up if tilted and level and looking_down(others, options) is None else None


def turn_up(up: Array) -> Array:
    """Return the smallest rotation [3, 3] that takes a unit vector [3] to z."""
    x, y, z = up
    if z < -0.999999:
        return np.diag([1.0, -1.0, -1.0])
    return np.array([
        [1 - x * x / (1 + z), -x * y / (1 + z), -x], [-x * y / (1 + z), 1 - y * y / (1 + z), -y], [x, y, z]
    ])  # fmt: skip


def horizontal_axes(up: Array) -> Array:
    """Return two unit vectors perpendicular to up [3] and to each other, [2, 3]."""
    return np.linalg.svd(up[None])[2][1:]


def looking_down(views: Sequence[View], options: GravityOptions = GravityOptions()) -> NDArray[np.float64] | None:
    """Return the common viewing direction of a grid of photos, [3]; None without one.

    Drones fly such grids straight down; upright photos of a front come in a row, or look at it from several sides.
    """
    axis = _mean_axis(views)
    length = np.linalg.norm(axis)
    if len(views) < options.grid_photos or length < options.grid_alignment:
        return None
    axis /= length
    wide, ratio = _width_across(views, axis)
    along = np.stack([v.centre for v in views]) @ axis
    flat = np.linalg.norm(along - along.mean()) < 0.5 * ratio * wide
    return axis if flat and ratio > options.grid_width else None


def up_from_edges(
    scene: Scene, rough: Array, threads: int | None = None, options: GravityOptions = GravityOptions()
) -> UpDirection | None:
    """Estimate up from vertical edges near a rough direction [3]; None where too few agree.

    Args:
        scene: cameras and photos.
        rough: unit [3], normalised frame.
        threads: as for :func:`find_up`.
        options: limits of edges.
    """
    step = max(1, -(-len(scene.views) // options.most_photos))
    normals, lengths, owner = [], [], []
    indices = range(0, len(scene.views), step)
    edges = parallel_map(lambda i: edge_planes(scene.views[i], scene.photo(i), options.least_length), indices, threads)
    for index, (found, length) in zip(indices, edges, strict=True):
        near = np.abs(found @ rough) < np.sin(np.radians(options.near))
        normals.append(found[near])
        lengths.append(length[near])
        owner += [index] * int(near.sum())
    planes, weights, views = np.concatenate(normals), np.concatenate(lengths), np.array(owner)
    if len(planes) < options.least_edges:
        return None
    found = common_direction(planes, weights, rough, options)
    good = np.abs(planes @ found) < np.radians(options.inlier)
    share = float(weights[good].sum() / weights.sum())
    photos = len(set(views[good]))
    if good.sum() < options.least_edges or photos < options.least_photos or share < options.least_share:
        return None
    spread = float(np.sqrt(np.average((planes[good] @ found) ** 2, weights=weights[good])))
    sd = max(np.radians(options.least_sd), 2 * spread / np.sqrt(photos))  # edges of one photo err together
    return UpDirection(found, sd, "walls", int(good.sum()))


def edge_planes(view: View, photo: NDArray[np.uint8], least_length: float) -> tuple[Array, Array]:
    """Find the straight edges of a photo, each with the plane through it and the camera.

    Args:
        view: camera of the photo.
        photo: RGB uint8 [H, W, 3].
        least_length: of an edge, as a share of the photo's longest side.

    Returns:
        Unit normals of the planes [S, 3], normalised frame, and lengths of the edges [S], px.
    """
    grey = cv2.cvtColor(photo, cv2.COLOR_RGB2GRAY)
    found = cv2.createLineSegmentDetector().detect(grey)[0]
    ends = np.zeros((0, 4)) if found is None else np.asarray(found, np.float64).reshape(-1, 4) + 0.5
    length = np.hypot(*(ends[:, 2:] - ends[:, :2]).T)
    kept = length > least_length * max(view.width, view.height)
    ends, length = ends[kept], length[kept]
    first, second = (
        np.stack([(x - view.cx) / view.fx, (y - view.cy) / view.fy, np.ones(len(x))], 1)
        for x, y in ((ends[:, 0], ends[:, 1]), (ends[:, 2], ends[:, 3]))
    )
    normals = np.cross(first, second) @ view.rotation
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12), length


def common_direction(normals: Array, weights: Array, rough: Array, options: GravityOptions = GravityOptions()) -> Array:
    """Find the vanishing direction [3] of vertical edges: near ``rough`` [3], in most planes [S, 3] by weight [S].

    Args:
        normals: of the planes through edges and cameras, unit [S, 3].
        weights: of the planes, [S].
        rough: approximate direction, unit [3].
        options: limits of the angles.
    """
    inlier = np.radians(options.inlier)
    rng = np.random.default_rng(0)
    pairs = rng.choice(len(normals), (options.samples, 2), p=weights / weights.sum())
    tried = np.cross(normals[pairs[:, 0]], normals[pairs[:, 1]])
    size = np.linalg.norm(tried, axis=1)
    tried = tried[size > 0.05] / size[size > 0.05, None]
    tried = tried * np.where(tried @ rough < 0, -1.0, 1.0)[:, None]
    tried = np.concatenate([rough[None], tried[tried @ rough > np.cos(np.radians(options.near))]])
    away = np.minimum((normals @ tried.T / np.sin(inlier)) ** 2, 1.0)
    best = tried[int(np.argmin(weights @ away))]
    for _ in range(10):
        share = weights / (1.0 + (normals @ best / (0.5 * inlier)) ** 2)  # Cauchy's weights
        _, vectors = np.linalg.eigh((normals * share[:, None]).T @ normals)
        best = vectors[:, 0] * np.sign(vectors[:, 0] @ best)
    return np.asarray(best)
