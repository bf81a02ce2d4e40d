# SPDX-License-Identifier: GPL-3.0-or-later
"""Fit the ground plane to the sparse points by RANSAC.

It separates paving from walls of the same stone, and is the lower end of walls whose foot is hidden by bushes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mgf_engine.masks.geometry.point_features import PointFeatures
from mgf_engine.model.scene import Scene, View
from mgf_engine.options.algorithms import parameter


@dataclass(frozen=True)
class GroundPlaneOptions:
    """Options of the search for the ground."""

    least_support: int = parameter(20, "Minimum number of points on the plane", low=3)
    largest_tilt: float = parameter(0.26, "Largest angle between the plane's normal and up", "rad", high=1.57)
    trials: int = parameter(300, "Number of samples of RANSAC", low=1)


@dataclass(frozen=True)
class GroundPlane:
    """``normal @ x = level`` with normal [3] pointing up, and how thick the layer of its points is."""

    normal: NDArray[np.float64]
    level: float
    thickness: float

    def height(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Compute the height of points [N, 3] over the plane, [N]."""
        return points @ self.normal - self.level

    def depth(self, view: View, h: int, w: int) -> NDArray[np.float64]:
        """Return the depth at which each pixel's ray meets the ground, infinite where it does not; [h, w].

        Args:
            view: camera of the photo.
            h: rows of the map, at any scale of the photo.
            w: columns of the map.
        """
        xs = ((np.arange(w) + 0.5) * view.width / w - view.cx) / view.fx
        ys = ((np.arange(h) + 0.5) * view.height / h - view.cy) / view.fy
        normal = view.rotation @ self.normal
        slope = normal[0] * xs[None, :] + normal[1] * ys[:, None] + normal[2]
        above = float(self.height(view.centre[None])[0])
        with np.errstate(divide="ignore"):
            depth = np.where(slope < -1e-9, -above / np.minimum(slope, -1e-9), np.inf)
        return np.where(depth > 0, depth, np.inf)

    def membership(self, scene: Scene, features: PointFeatures) -> NDArray[np.float64]:
        """Rate each sparse point as ground, 0..1: 1 where its surface is level and in the plane, or below it; [P]."""
        height = self.height(scene.points) / self.thickness
        level = np.clip(2 * np.abs(features.normals @ features.up) - 0.6, 0, 1)
        return np.maximum(np.clip(1.5 - np.abs(height), 0, 1) * level, height < -1)


def find_ground_plane(
    scene: Scene,
    features: PointFeatures,
    outside: NDArray[np.floating],
    seed: int,
    options: GroundPlaneOptions = GroundPlaneOptions(),
) -> GroundPlane | None:
    """Find the plane most points agree on that lies below the cameras and nearly all points, or None.

    Args:
        scene: normalised frame.
        features: direction of "up", flatness and normals of its points.
        outside: [P], 0..1, how likely each point is not the building; weighs the support.
        seed: of the planes that are tried.
        options: number of planes tried, their slope, and the support they need.
    """
    upright = np.abs(features.normals @ features.up) * features.flatness
    weight = np.clip(outside, 0, 1) * np.clip(2 * upright - 0.6, 0, 1)
    pool = np.flatnonzero(weight > 0.05)
    if len(pool) < options.least_support:
        return None
    rng = np.random.default_rng(seed)
    thickness = 0.6 * float(np.median(features.spacing[pool]))
    centres = np.stack([v.centre for v in scene.views])
    points, best, best_score = scene.points, None, 0.0
    share = weight[pool] / weight[pool].sum()
    for three in _draws(rng, share, options.trials):
        plane = _through(points[pool[three]], features.up, thickness, options)
        if plane is None:
            continue
        score = _support(plane, points, weight, centres)
        if score > best_score:
            best, best_score = plane, score
    if best is None or best_score < options.least_support / 2:
        return None
    return _refit(best, points, weight, options)


def _draws(rng: np.random.Generator, share: NDArray[np.float64], count: int) -> Iterator[NDArray[np.int64]]:
    """Yield ``count`` samples of three different rows, drawn by their shares [N]: ``rng.choice`` that sums the shares
    up once."""
    below = np.cumsum(share)
    below /= below[-1]
    for _ in range(count):
        before = rng.bit_generator.state
        three = below.searchsorted(rng.random(3), side="right")
        if len(set(three.tolist())) < 3:
            rng.bit_generator.state = before
            three = rng.choice(len(share), 3, replace=False, p=share)
        yield three


def _through(
    three: NDArray[np.float64], up: NDArray[np.float64], thickness: float, options: GroundPlaneOptions
) -> GroundPlane | None:
    """Return the plane through three points [3, 3]; None where they lie on a line, or it is too steep."""
    normal = np.cross(three[1] - three[0], three[2] - three[0])
    length = np.linalg.norm(normal)
    if length < 1e-12:
        return None
    normal = normal / length * np.sign(normal @ up or 1.0)
    level = normal @ up > np.cos(options.largest_tilt)
    return GroundPlane(normal, float(normal @ three[0]), thickness) if level else None


def _support(
    plane: GroundPlane, points: NDArray[np.float64], weight: NDArray[np.float64], centres: NDArray[np.float64]
) -> float:
    """Return the weight [P] of the points [P, 3] on a plane, less where others lie below it; 0 below the cameras."""
    if np.mean(centres @ plane.normal > plane.level) < 0.9:
        return 0.0
    height = plane.height(points)
    below = np.mean(height < -3 * plane.thickness)
    return float(weight[np.abs(height) < plane.thickness].sum() * max(0.0, 1 - 10 * below))


def _refit(
    plane: GroundPlane, points: NDArray[np.float64], weight: NDArray[np.float64], options: GroundPlaneOptions
) -> GroundPlane:
    """Fit a plane to the points [P, 3] near it by weighted least squares, and measure how thick their layer is."""
    normal, level, thickness = plane.normal, plane.level, plane.thickness
    for _ in range(3):
        near = (np.abs(points @ normal - level) < thickness) & (weight > 0.05)
        centre = np.average(points[near], axis=0, weights=weight[near])
        offset = (points[near] - centre) * np.sqrt(weight[near])[:, None]
        fitted = np.linalg.svd(offset, full_matrices=False)[2][2]
        fitted = fitted * np.sign(fitted @ normal or 1.0)
        if fitted @ normal < np.cos(options.largest_tilt):
            break
        normal, level = fitted, float(fitted @ centre)
    near = (np.abs(points @ normal - level) < thickness) & (weight > 0.05)
    spread = 1.4826 * float(np.median(np.abs(points[near] @ normal - level)))
    return GroundPlane(normal, level, float(np.clip(3 * spread, 0.3 * thickness, thickness)))
