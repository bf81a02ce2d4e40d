# SPDX-License-Identifier: GPL-3.0-or-later
"""The graph of the label propagation: nodes are superpixels and sparse points; with its edges and linear solver.

Its edges join superpixels with their neighbours (weakly across image edges), points with the superpixels in which
photos observed them, and points with neighbouring points.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.sparse.linalg import LinearOperator, cg

from mgf_engine.masks.geometry.point_features import PointFeatures
from mgf_engine.masks.prompts import Prompts
from mgf_engine.masks.propagation.appearance import vegetation_probability
from mgf_engine.masks.propagation.random_walker_options import RandomWalkerOptions
from mgf_engine.masks.propagation.sky_regions import SkyOptions, find_sky
from mgf_engine.masks.propagation.superpixels import Superpixels
from mgf_engine.model.scene import Scene

Array = NDArray[np.float64]
_CLICK_ARM = 5  # px from a click at which it counts, too


class LabelGraph:
    """Nodes, edges and features of a scene; arrays over nodes [N] hold the regions of all photos, then the points.

    Args:
        full: the scene with points added behind its own (:mod:`mgf_engine.masks.geometry.densify_points`). They are no
            nodes: trees and clouds would spread through them.

    Attributes:
        point_features: spacing, normals and neighbours of the scene's sparse points.
        features: appearance of the regions; ``point_appearance`` its mean over the regions that show each point.
        start: first node of each photo's regions, and their number, [V + 1].
        observed: region node of each observation of the scene, [T]; ``added_observed`` those of the added points.
        laplacian: sparse [N, N]; degree: sum of each node's edge weights, [N].
        sky: piece of sky of each node, 0 for none, [N]; plants: similarity to leaves and grass, [N].
    """

    def __init__(
        self,
        scene: Scene,
        regions: Sequence[Superpixels],
        features: PointFeatures,
        threads: int = 1,
        full: Scene | None = None,
        options: RandomWalkerOptions = RandomWalkerOptions(),
        sky: SkyOptions = SkyOptions(),
    ) -> None:
        self.scene, self.regions, self.point_features, self.options = scene, regions, features, options
        self.threads, self.full = threads, scene if full is None else full
        self.start = np.concatenate([[0], np.cumsum([len(r.area) for r in regions])]).astype(np.int64)
        self.region_count, self.point_count = int(self.start[-1]), len(scene.points)
        self.features = np.concatenate([r.features for r in regions])
        self.area = np.concatenate([r.area for r in regions]).astype(np.float64)
        self.observed, self.added_observed = np.split(self._observed_regions(), [len(scene.track_view)])
        self.added_count = len(self.full.points) - self.point_count
        self.added_owner = self.full.track_point[len(scene.track_view) :] - self.point_count
        self.laplacian, self.degree = self._laplacian(features)
        rows = np.repeat(np.arange(len(self.degree)), np.diff(self.laplacian.indptr))
        self._diagonal = np.flatnonzero(self.laplacian.indices == rows)  # of the matrix, in its data
        self.point_appearance = self._point_appearance(features)
        self.sky = self._sky(sky)
        self.plants = np.concatenate(
            [vegetation_probability(self.features), vegetation_probability(self.point_appearance)]
        )

    def solve(self, stiffness: Array, source: Array, start: Array | None) -> Array:
        """Solve (L + diag(stiffness)) x = source, [N], by conjugate gradients from ``start``; clipped to 0..1."""
        data = self.laplacian.data.copy()
        data[self._diagonal] += stiffness
        inverse = 1.0 / data[self._diagonal]
        matrix = sparse.csr_matrix((data, self.laplacian.indices, self.laplacian.indptr), self.laplacian.shape)
        scaled = LinearOperator(matrix.shape, matvec=lambda r: inverse * r, dtype=np.float64)
        result, _ = cg(matrix, source, x0=start, rtol=1e-4, maxiter=400, M=scaled)
        return np.clip(result, 0.0, 1.0)

    def click_pull(self, prompts: Prompts) -> tuple[Array, Array]:
        """Return strength and wanted value of the clicks, [N] each."""
        count = self.region_count + self.point_count
        pull, wanted = np.zeros(count), np.zeros(count)
        for index, clicks in prompts.items():
            for points, value in ((clicks.positive, 1.0), (clicks.negative, 0.0)):
                for click in points:
                    nodes = self.regions[index].at_cross(click, _CLICK_ARM) + self.start[index]
                    np.add.at(pull, nodes, self.options.click_weight)
                    np.add.at(wanted, nodes, self.options.click_weight * value)
        return pull, wanted / np.maximum(pull, 1e-12)

    def clicked_regions(self, prompts: Prompts) -> NDArray[np.bool_]:
        """Return the regions with a positive click, [regions]."""
        result = np.zeros(self.region_count, bool)
        for index, clicks in prompts.items():
            result[self.regions[index].at(clicks.positive) + self.start[index]] = True
        return result

    def unclicked_sky(self, prompts: Prompts) -> NDArray[np.bool_]:
        """Return nodes that are sky, [N]; what a click calls building is none."""
        taken = self.sky[: self.region_count][self.clicked_regions(prompts)]
        return (self.sky > 0) & ~np.isin(self.sky, taken)

    def points_at(self, index: int, clicks: Array) -> NDArray[np.int64]:
        """Return the sparse point nearest to each click [K, 2] in view ``index``, where one is near."""
        here = self.scene.observations(index)
        if not len(clicks) or not len(here):
            return np.zeros(0, np.int64)
        away = np.linalg.norm(self.scene.track_uv[here] - clicks[:, None], axis=2)  # few clicks: no tree is worth it
        nearest = away.argmin(1)
        near = away.min(1) < self.options.click_radius * self.scene.views[index].width
        return self.scene.track_point[here][nearest[near]]

    def clicked_points(self, prompts: Prompts) -> NDArray[np.int64]:
        """Return the sparse points nearest to the positive clicks, where any is near."""
        return np.concatenate([np.zeros(0, np.int64), *(self.points_at(i, c.positive) for i, c in prompts.items())])

    def added_on_building(self, probability: Array) -> NDArray[np.bool_]:
        """Find the added points that are seen in regions of the building, bool [A]."""
        seen = np.bincount(self.added_owner, probability[self.added_observed], minlength=self.added_count)
        tracks = np.bincount(self.added_owner, minlength=self.added_count)
        return np.asarray(seen > self.options.building_above * tracks, bool)

    def shows_added(self, values: Array) -> Array:
        """Return the mean over the added points that each region shows, 0 where it shows none, [regions]."""
        total = np.bincount(self.added_observed, values[self.added_owner], minlength=self.region_count)
        return np.asarray(total / np.maximum(np.bincount(self.added_observed, minlength=self.region_count), 1))

    def _observed_regions(self) -> NDArray[np.int64]:
        """Return the region node of each observation of the full scene, [T]."""
        result = np.empty(len(self.full.track_view), np.int64)
        for index, regions in enumerate(self.regions):
            here = self.full.observations(index)
            result[here] = regions.at(self.full.track_uv[here]) + self.start[index]
        return result

    def _laplacian(self, features: PointFeatures) -> tuple[sparse.csr_matrix, Array]:
        first, second, weight = [], [], []
        for index, regions in enumerate(self.regions):
            mean_square = (regions.contrast**2 * regions.border).sum() / max(regions.border.sum(), 1e-9)
            alike = np.exp(-(regions.contrast**2) / max(mean_square, 1e-9))
            first.append(regions.pairs[:, 0] + self.start[index])
            second.append(regions.pairs[:, 1] + self.start[index])
            weight.append(regions.border / 8 * alike + 0.002)
        first += [self.observed, features.pairs[:, 0] + self.region_count]
        second += [self.scene.track_point + self.region_count, features.pairs[:, 1] + self.region_count]
        weight += [
            np.full(len(self.observed), self.options.track_weight),
            self.options.space_weight * features.closeness,
        ]
        count = self.region_count + self.point_count
        ties = sparse.coo_matrix(
            (np.concatenate(weight), (np.concatenate(first), np.concatenate(second))), shape=(count, count)
        ).tocsr()
        ties = ties + ties.T
        degree = np.asarray(ties.sum(1)).ravel()
        return (sparse.diags(degree) - ties).tocsr(), degree

    def _point_appearance(self, features: PointFeatures) -> Array:
        owner = self.scene.track_point
        mean = np.zeros((self.point_count, self.features.shape[1]))
        np.add.at(mean, owner, self.features[self.observed])
        mean /= np.maximum(np.diff(self.scene.track_start), 1)[:, None]
        upright = np.abs(features.normals @ features.up)
        return np.column_stack([mean, 6 * features.flatness * upright, 4 * features.flatness])

    def _sky(self, options: SkyOptions) -> NDArray[np.int64]:
        """Return the piece of sky of each node, 0 for none, [N]; numbers are shared by no two photos."""
        result = np.zeros(self.region_count + self.point_count, np.int64)
        for index, regions in enumerate(self.regions):
            part = slice(self.start[index], self.start[index + 1])
            observed = self.observed[self.scene.observations(index)] - self.start[index]
            sky = find_sky(regions, observed, options)
            result[part] = np.where(sky > 0, sky + result.max(), 0)
        return result
