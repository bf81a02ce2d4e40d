# SPDX-License-Identifier: GPL-3.0-or-later
"""Find the sparse points that a photo observed, and those that it should have observed, which are occluded."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mgf_engine.masks.geometry.point_features import PointFeatures
from mgf_engine.model.scene import Scene
from mgf_engine.options.algorithms import parameter


@dataclass(frozen=True)
class PointVisibilityOptions:
    """Options of the points that a photo should observe."""

    same_side: float = parameter(
        0.94, "Minimum cosine between two viewing directions that should see the same points", high=1
    )
    same_distance: tuple[float, float] = parameter(
        (0.7, 1.4), "Ratio of two distances from a point at which both cameras should see it", low=1e-3
    )
    steep: float = parameter(0.35, "Minimum cosine to the normal at which a photo should see a point", high=1)


class PointVisibility:
    """Which points each photo observed, and which it should have: a camera close by did.

    Args:
        scene: photos, points and their tracks.
        features: normals of the points.
        sparse: number of points, the first ones, that are of structure from motion; of others no photo is expected to
            have a track. None for all.
        options: which cameras should see the same points.
    """

    def __init__(
        self,
        scene: Scene,
        features: PointFeatures,
        sparse: int | None = None,
        options: PointVisibilityOptions = PointVisibilityOptions(),
    ) -> None:
        self.options = options
        self.scene, self.features, self.owner = scene, features, scene.track_point
        self._tracked = np.arange(len(scene.points)) < (len(scene.points) if sparse is None else sparse)
        centres = np.stack([v.centre for v in scene.views])
        self._rays = scene.points[self.owner] - centres[scene.track_view]
        self._lengths = np.linalg.norm(self._rays, axis=1)
        self._expected: dict[int, NDArray[np.int64]] = {}

    def observed(self, index: int) -> NDArray[np.bool_]:
        """Return points whose track goes through view ``index``, [P]."""
        result = np.zeros(len(self.scene.points), bool)
        result[self.owner[self.scene.observations(index)]] = True
        return result

    def expected(self, index: int) -> NDArray[np.int64]:
        """Return the points in the frame of view ``index`` that it should have observed: rows, ascending, [K].

        It observed them itself, or some camera did from nearly the same direction and distance.
        """
        if index not in self._expected:
            view, points, options = self.scene.views[index], self.scene.points, self.options
            framed = view.project_into_frame(points, margin=-1.0)[2] & self._tracked
            rows = np.flatnonzero(framed)
            place = np.cumsum(framed) - 1  # of a point among these
            towards = points[rows] - view.centre
            length = np.linalg.norm(towards, axis=1)
            facing = np.abs((towards * self.features.normals[rows]).sum(1)) > options.steep * length
            seen = np.flatnonzero(framed[self.owner])
            at = place[self.owner[seen]]
            mine, theirs, (nearest, farthest) = length[at], self._lengths[seen], options.same_distance
            cosine = np.einsum("ij,ij->i", self._rays[seen], towards[at]) / np.maximum(theirs * mine, 1e-12)
            alike = (cosine > options.same_side) & (theirs > nearest * mine) & (theirs < farthest * mine)
            result = np.zeros(len(rows), bool)
            result[at[alike]] = True
            self._expected[index] = rows[(result & facing) | self.observed(index)[rows]]
        return self._expected[index]
