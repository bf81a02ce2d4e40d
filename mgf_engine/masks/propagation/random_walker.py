# SPDX-License-Identifier: GPL-3.0-or-later
"""Label propagation: the probability of "building" for the superpixels of all photos and all sparse points.

One graph spans the scene; its nodes are the superpixels of every photo and the sparse points. Its edges join
superpixels with their neighbours (weakly across image edges), points with the superpixels in which photos observed
them, and points with neighbouring points. The probability is the harmonic function of a random walk with absorbing
clicks (Grady 2006). Models of colour, texture and shape, fitted to the probabilities so far, then add evidence where
no edge of the graph leads, and the two steps are repeated.

Because a point is one node for all photos that see it, photos cannot disagree about it: consistency between
views is built in, not repaired afterwards.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.sparse.linalg import LinearOperator, cg
from scipy.spatial import cKDTree

from mgf_engine.algorithms import parameter
from mgf_engine.masks.geometry.building_extent import (
    BuildingExtent,
    ExtentOptions,
    ViewRegions,
    Visibility,
    over_building,
)
from mgf_engine.masks.geometry.ground_plane import Ground, GroundPlaneOptions, find_ground
from mgf_engine.masks.geometry.point_features import (
    PointFeatureOptions,
    PointFeatures,
    clicked_groups,
    measure_point_features,
)
from mgf_engine.masks.prompts import Prompts
from mgf_engine.masks.propagation.appearance import (
    FEATURE_SCALE,
    Mixture,
    fit_mixture,
    log_ratio,
    vegetation_probability,
)
from mgf_engine.masks.propagation.sky_regions import SkyOptions, find_sky
from mgf_engine.masks.propagation.superpixels import Regions
from mgf_engine.model.scene import Scene, View
from mgf_engine.native.parallel import parallel_map

Array = NDArray[np.float64]

#: Features of points: those of the regions that saw them, how upright their surface is, and how flat.
POINT_SCALE = np.concatenate([FEATURE_SCALE, [1.0, 1.0]])


@dataclass(frozen=True)
class RandomWalkerOptions:
    """Options of the label propagation; odds are natural logarithms of the odds of "building"."""

    track_weight: float = parameter(1.0, "Edge weight between a point and a region that it was observed in")
    space_weight: float = parameter(0.3, "Edge weight between two neighbouring points")
    click_weight: float = parameter(2.0, "Weight of a click; it counts five times, at its pixel and 5 px to four sides")
    evidence_weight: float = parameter(1.5, "Weight of certain evidence (all the odds below) at a region")
    point_evidence_weight: float = parameter(
        2.0, "Weight of certain evidence at a point, which has an edge to each photo that observed it"
    )
    appearance_limit: float = parameter(3.0, "Maximum odds by colour, texture and shape, of either sign")
    plant_odds: float = parameter(-2.0, "Odds of leaves and grass", low=None)
    core_odds: float = parameter(2.2, "Odds where the ray meets the building", low=None)
    rim_odds: float = parameter(0.4, "Odds in the rim around the outermost points of the building", low=None)
    far_odds: float = parameter(-2.0, "Odds per point spacing away from the building, beyond far_from", low=None)
    far_from: float = parameter(1.2, "Distance from the building at which far_odds begins", "point spacings")
    far_limit: float = parameter(5.0, "Maximum distance that far_odds counts", "point spacings")
    apart_odds: float = parameter(-4.0, "Odds of points that are apart from every click on the building", low=None)
    hidden_odds: float = parameter(-2.0, "Odds where points that the photo should observe are not observed", low=None)
    ground_first_odds: float = parameter(-6.0, "Odds where the ray meets the ground first", low=None)
    sky_odds: float = parameter(-5.0, "Odds of sky", low=None)
    occluded_odds: float = parameter(-2.0, "Odds where points of something else are nearer to the camera", low=None)
    other_gap: float = parameter(
        4.0, "Distance from the building beyond which a point is something else", "point spacings"
    )
    building_above: float = parameter(0.6, "Probability above which a point belongs to the building", high=1)
    other_below: float = parameter(0.2, "Probability below which a point belongs to something else", high=1)
    ground_odds: float = parameter(-4.0, "Odds of points on the ground plane", low=None)
    within_odds: float = parameter(
        2.5, "Odds of points that photos see on the surface of the building or behind it", low=None
    )
    over_odds: float = parameter(4.0, "Odds of points that stand on the building", low=None)
    over_weight: float = parameter(
        0.5, "Weight of over_odds per photo that observed the point: the regions around a spire are mostly sky"
    )
    ground_training_weight: float = parameter(
        0.2, "Weight of ground in the colour models: walls may be of the same stone", high=1
    )
    click_radius: float = parameter(
        0.06, "Radius around a click in which its nearest point is sought, as a share of the photo's width", high=1
    )
    tie_appearance_weight: float = parameter(
        0.3, "Weight of certain appearance in what is tied to the building although no point of it is near"
    )
    tied: tuple[float, float] = parameter(
        (0.4, 0.7), "Probabilities from which and to which far_odds and ground_first_odds of such regions fade", high=1
    )
    termination: float = parameter(
        0.02, "Probability per step that the first random walk ends, which limits the reach of a click"
    )
    rounds: int = parameter(4, "Number of rounds of appearance, geometry and propagation", low=1, high=100)
    ground: GroundPlaneOptions = GroundPlaneOptions()
    features: PointFeatureOptions = PointFeatureOptions()


@dataclass(frozen=True)
class BuildingProbability:
    """Probability of "building", 0..1: per photo for its regions, and for the sparse points."""

    regions: tuple[NDArray[np.float32], ...]  # V arrays [S_v]
    points: NDArray[np.float32]  # [P]
    appearance: tuple[NDArray[np.float32], ...]  # V arrays [S_v], the part of colour and texture alone
    ground: Ground | None  # that the building stands on; None where there is none or the clicks count it in


@dataclass(frozen=True)
class _Placed:
    """What the geometry says, where it was looked at: of all nodes [N], regions first."""

    odds: Array  # log-odds of "building"
    grounded: NDArray[np.bool_]  # what is ground
    over: NDArray[np.bool_]  # points that stand on the building
    ground: Ground | None


class LabelGraph:
    """The graph of a scene and the solver on it; built once, asked with different clicks.

    Args:
        full: the scene with points added behind its own (``bare.py``). They are no nodes: trees and clouds would spread
            through them. Those observed in superpixels that are probably the building tell where it is.
    """

    def __init__(
        self,
        scene: Scene,
        regions: Sequence[Regions],
        shape: PointFeatures,
        threads: int = 1,
        full: Scene | None = None,
        options: RandomWalkerOptions = RandomWalkerOptions(),
        sky: SkyOptions = SkyOptions(),
        extent: ExtentOptions = ExtentOptions(),
    ) -> None:
        self.scene, self.regions, self.shape, self.options = scene, regions, shape, options
        self.threads, self._extent_options = threads, extent
        self.full = scene if full is None else full
        self.full_shape = shape if full is None else measure_point_features(full, shape.up, options.features)
        self.visibility = Visibility(self.full, self.full_shape, len(scene.points), extent)
        self.start = np.concatenate([[0], np.cumsum([len(r.area) for r in regions])]).astype(np.int64)
        self.region_count, self.point_count = int(self.start[-1]), len(scene.points)
        self.features = np.concatenate([r.features for r in regions])
        self.area = np.concatenate([r.area for r in regions]).astype(np.float64)
        self.observed, self.added_observed = np.split(self._observed_regions(), [len(scene.track_view)])
        self.added_count = len(self.full.points) - self.point_count
        self.added_owner = self.full.track_point[len(scene.track_view) :] - self.point_count
        self.laplacian, self.degree = self._laplacian(shape)
        rows = np.repeat(np.arange(len(self.degree)), np.diff(self.laplacian.indptr))
        self._diagonal = np.flatnonzero(self.laplacian.indices == rows)  # of the matrix, in its data
        self.point_features = self._point_features(shape)
        counts = [self.region_count, self.point_count]
        self.evidence_weight = np.repeat([self.options.evidence_weight, self.options.point_evidence_weight], counts)
        self.sky = self._sky(sky)
        self.plants = np.concatenate(
            [vegetation_probability(self.features), vegetation_probability(self.point_features)]
        )

    def solve(
        self, prompts: Prompts, seed: int = 0, rounds: int | None = None, views: Sequence[int] | None = None
    ) -> BuildingProbability:
        """The probability that follows from the clicks.

        Args:
            rounds: number of rounds; None for that of the options.
            views: where the geometry is looked at; None for all. With some, the probability holds for these alone.
        """
        looked_at = range(len(self.regions)) if views is None else views
        pull, target = self.click_pull(prompts)
        sky = self._unclicked_sky(prompts)
        # Where nobody said what is not the building, the sky says it first.
        silent = not any(len(c.negative) for c in prompts.values())
        weight = self.evidence_weight
        probability, trust = self._first_guess(pull + self.options.click_weight * (sky & silent), target)
        appearance, teach, ground = np.zeros(len(probability)), trust, None
        for round_ in range(self.options.rounds if rounds is None else rounds):
            appearance = self._appearance(probability, teach, seed)
            odds = appearance + self.options.plant_odds * self.plants + self.options.sky_odds * sky
            if round_ > 0:
                placed = self._place(probability, appearance, prompts, seed, looked_at)
                odds, ground = odds + placed.odds, placed.ground
                tied = np.maximum(self.evidence_weight, self.options.over_weight * self.degree)
                weight = np.where(placed.over, tied, self.evidence_weight)
                teach = np.where(placed.grounded, self.options.ground_training_weight, 1.0)
            else:
                teach = np.ones(len(probability))
            wanted = 1.0 / (1.0 + np.exp(-odds))
            strength = weight * np.abs(2 * wanted - 1) + 1e-4
            probability = self._flow(pull + strength, pull * target + strength * wanted, probability)
        return self._split(probability, appearance, ground)

    def _place(
        self, probability: Array, appearance: Array, prompts: Prompts, seed: int, views: Sequence[int]
    ) -> _Placed:
        """Compute the odds that the geometry gives in these views."""
        points = probability[self.region_count :]
        odds, grounded, over = (
            np.zeros(len(probability)),
            np.zeros(len(probability), bool),
            np.zeros(len(probability), bool),
        )
        added_ground = np.zeros(self.added_count)
        ground = find_ground(self.scene, self.shape, 1 - points, seed, self.options.ground)
        if ground is not None:
            held = ground.holds(self.scene, self.shape)
            if self._clicks_reject(held, prompts):
                odds[self.region_count :] = self.options.ground_odds * held
                added_ground = ground.holds(self.full, self.full_shape)[self.point_count :]
                odds[: self.region_count] = self.options.ground_odds * self._shows_added(added_ground)
                grounded[self.region_count :] = held > 0.5
                points = np.minimum(points, 1 - held)
            else:
                # A plinth the building stands on, as far as anybody said: no evidence against it.
                ground = None
        keep = points > self.options.building_above
        apart = keep & ~clicked_groups(
            self.scene.points, keep, self._clicked_points(prompts), self.shape, self.options.features
        )
        odds[self.region_count :] += self.options.apart_odds * apart
        keep &= ~apart
        if keep.sum() < 10:
            return _Placed(odds, grounded, over, ground)
        over[self.region_count :] = over_building(self.scene.points, keep, self.shape, self._extent_options)
        odds += self.options.over_odds * over
        keep |= over[self.region_count :] & (points > self.options.other_below)
        away = (points < self.options.other_below) & ~grounded[self.region_count :] & ~over[self.region_count :]
        others = apart | (away & self._far_from(keep))
        extent = self.extent(np.concatenate([keep, self._added(probability) & (added_ground < 0.5)]), ground, others)
        tied = self._tied_to_building(keep, points, appearance)
        within = np.zeros(self.point_count)
        geometry = parallel_map(lambda i: self._geometry(extent, i, tied), views, self.threads)
        for index, (region_odds, first, inside) in zip(views, geometry, strict=True):
            part = slice(self.start[index], self.start[index + 1])
            odds[part] += region_odds
            grounded[part] = first & (ground is not None)
            within += inside
        seen = np.bincount(self.scene.track_point[np.isin(self.scene.track_view, views)], minlength=self.point_count)
        share = within / np.maximum(seen, 1)
        odds[self.region_count :] += self.options.within_odds * share * ~grounded[self.region_count :]
        return _Placed(odds, grounded, over, ground)

    def _tied_to_building(self, keep: NDArray[np.bool_], points: Array, appearance: Array) -> Array:
        """How far regions may be the building although no point of it is near, 0..1, [regions].

        A sheet roof or a plain wall has points along its edges only. What looks like the building, and is tied to its
        points more than to those of other things, may be one surface with them.
        """
        own = self.options
        known = np.concatenate([self.sky[: self.region_count] > 0, keep | (points < own.other_below)])
        target = np.concatenate([np.zeros(self.region_count), keep])
        wanted = 1 / (1 + np.exp(-appearance))
        strength = own.tie_appearance_weight * np.abs(2 * wanted - 1) * ~known + 1e-4
        pull = own.click_weight * known
        tied = self._flow(pull + strength, pull * target + strength * wanted, None)[: self.region_count]
        low, high = own.tied
        return np.clip((tied - low) / (high - low), 0, 1)

    def _geometry(
        self, extent: BuildingExtent, index: int, tied: Array
    ) -> tuple[Array, NDArray[np.bool_], NDArray[np.int64]]:
        """Log-odds of a view's regions [S], which meet the ground first [S], and which points it sees within [P]."""
        place = extent.place(index)
        sure = 1 - tied[self.start[index] : self.start[index + 1]]
        odds, first = self._region_odds(place, self.regions[index], self.scene.views[index], sure)
        seen = self.visibility.owner[self.full.observations(index)][extent.within(index, place)]
        return odds, first, np.bincount(seen, minlength=len(self.full.points))[: self.point_count]

    def extent(
        self, keep: NDArray[np.bool_], ground: Ground | None, others: NDArray[np.bool_] | None = None
    ) -> BuildingExtent:
        """Return the extent of the building.

        Args:
            keep: of the full scene's points, those of the building.
            others: [P], points of other things that stand on the ground.
        """
        if others is not None:
            others = np.concatenate([others, np.zeros(len(keep) - len(others), bool)])
        return BuildingExtent(self.full, self.full_shape, keep, ground, self.visibility, others, self._extent_options)

    def _added(self, probability: Array) -> NDArray[np.bool_]:
        """Find the added points that are seen in regions of the building, bool [A]."""
        seen = np.bincount(self.added_owner, probability[self.added_observed], minlength=self.added_count)
        tracks = np.bincount(self.added_owner, minlength=self.added_count)
        return np.asarray(seen > self.options.building_above * tracks, bool)

    def _shows_added(self, values: Array) -> Array:
        """Mean over the added points that each region shows, 0 where it shows none, [regions]."""
        total = np.bincount(self.added_observed, values[self.added_owner], minlength=self.region_count)
        return np.asarray(total / np.maximum(np.bincount(self.added_observed, minlength=self.region_count), 1))

    def _sky(self, options: SkyOptions) -> NDArray[np.int64]:
        """Piece of sky of each node, 0 for none, [N]; numbers are shared by no two photos."""
        result = np.zeros(self.region_count + self.point_count, np.int64)
        for index, regions in enumerate(self.regions):
            part = slice(self.start[index], self.start[index + 1])
            observed = self.observed[self.scene.observations(index)] - self.start[index]
            sky = find_sky(regions, observed, options)
            result[part] = np.where(sky > 0, sky + result.max(), 0)
        return result

    def _unclicked_sky(self, prompts: Prompts) -> NDArray[np.bool_]:
        """Nodes that are sky, [N]; what a click calls building is none."""
        clicked = [self.regions[i].at(c.positive) + self.start[i] for i, c in prompts.items() if len(c.positive)]
        taken = self.sky[np.concatenate(clicked)] if clicked else np.zeros(0, np.int64)
        return (self.sky > 0) & ~np.isin(self.sky, taken)

    def _far_from(self, keep: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Points farther from all kept ones than a wall is from the roof on it, [P]."""
        gap = float(self.options.other_gap * np.median(self.shape.spacing[keep]))
        distance, _ = cKDTree(self.scene.points[keep]).query(
            self.scene.points, distance_upper_bound=np.nextafter(gap, np.inf), workers=self.threads
        )
        return np.asarray(distance > gap, bool)  # infinite beyond the bound

    def _clicked_points(self, prompts: Prompts) -> NDArray[np.int64]:
        """The sparse points nearest to the positive clicks, where any is near."""
        return np.concatenate([np.zeros(0, np.int64), *(self._points_at(i, c.positive) for i, c in prompts.items())])

    def _points_at(self, index: int, clicks: Array) -> NDArray[np.int64]:
        """The sparse point nearest to each click [K, 2] in view ``index``, where one is near."""
        here = self.scene.observations(index)
        if not len(clicks) or not len(here):
            return np.zeros(0, np.int64)
        away = np.linalg.norm(self.scene.track_uv[here] - clicks[:, None], axis=2)  # few clicks: no tree is worth it
        nearest = away.argmin(1)
        near = away.min(1) < self.options.click_radius * self.scene.views[index].width
        return self.scene.track_point[here][nearest[near]]

    def _clicks_reject(self, grounded: Array, prompts: Prompts) -> bool:
        """Tell whether the ground is background: more negative than positive clicks lie on it, or none at all.

        Nobody has to click beside the building: what stands on the ground is not the ground.
        """
        on_ground = grounded > 0.5
        negative = sum(int(on_ground[self._points_at(i, c.negative)].sum()) for i, c in prompts.items())
        positive = sum(int(on_ground[self._points_at(i, c.positive)].sum()) for i, c in prompts.items())
        return negative > positive or negative == positive == 0

    def _region_odds(
        self, place: ViewRegions, regions: Regions, view: View, sure: Array
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Log-odds of each region, and whether its ray meets the ground first, [S] each.

        Args:
            sure: how much it says that no point of the building is near, 0..1, [S].
        """
        h, w = place.core.shape
        x = np.clip((regions.centres[:, 0] * w / view.width).astype(int), 0, w - 1)
        y = np.clip((regions.centres[:, 1] * h / view.height).astype(int), 0, h - 1)
        sure = np.where(place.hull[y, x], sure, 1.0)
        clear = ~place.hidden & ~place.ground_first & ~place.behind
        own = self.options
        odds = own.core_odds * (place.core & clear)[y, x] + own.rim_odds * (place.reach & ~place.core & clear)[y, x]
        odds = odds + own.far_odds * sure * np.clip(place.away[y, x] - own.far_from, 0, own.far_limit)
        first = place.ground_first[y, x]
        odds += own.hidden_odds * place.hidden[y, x] + own.occluded_odds * (place.behind[y, x] & ~first)
        return odds + own.ground_first_odds * sure * first, first & (sure > 0.5)

    def click_pull(self, prompts: Prompts) -> tuple[Array, Array]:
        """Strength and wanted value of the clicks, [N] each."""
        count = self.region_count + self.point_count
        pull, wanted = np.zeros(count), np.zeros(count)
        around = np.array([[0, 0], [5, 0], [-5, 0], [0, 5], [0, -5]])
        for index, clicks in prompts.items():
            for points, value in ((clicks.positive, 1.0), (clicks.negative, 0.0)):
                for click in points:
                    nodes = self.regions[index].at(click + around) + self.start[index]
                    np.add.at(pull, nodes, self.options.click_weight)
                    np.add.at(wanted, nodes, self.options.click_weight * value)
        return pull, wanted / np.maximum(pull, 1e-12)

    def _first_guess(self, pull: Array, target: Array) -> tuple[Array, Array]:
        """Compare positive and negative clicks by fading random walks; returns which is nearer, and how reliably."""
        stiffness = pull + self.options.termination * np.maximum(self.degree, 0.1)
        wanted = target, 1.0 - target
        flows = parallel_map(lambda k: self._flow(stiffness, pull * wanted[k], None), range(2), self.threads)
        near = [np.maximum(flow, 1e-9) for flow in flows]
        trust = np.clip(np.log(np.maximum(near[0], near[1]) / 1e-4) / np.log(1e4), 0, 1)
        return near[0] / (near[0] + near[1]), trust

    def _flow(self, stiffness: Array, source: Array, start: Array | None) -> Array:
        """Solve (L + diag(stiffness)) x = source."""
        data = self.laplacian.data.copy()
        data[self._diagonal] += stiffness
        inverse = 1.0 / data[self._diagonal]
        matrix = sparse.csr_matrix((data, self.laplacian.indices, self.laplacian.indptr), self.laplacian.shape)
        scaled = LinearOperator(matrix.shape, matvec=lambda r: inverse * r, dtype=np.float64)
        result, _ = cg(matrix, source, x0=start, rtol=1e-4, maxiter=400, M=scaled)
        return np.clip(result, 0.0, 1.0)

    def _appearance(self, probability: Array, teach: Array, seed: int) -> Array:
        """Log-odds of "building" from appearance alone, [N]."""
        inside, outside = np.clip(2 * probability - 1.1, 0, 1) * teach, np.clip(0.9 - 2 * probability, 0, 1) * teach
        r = self.region_count
        kinds = (
            (self.features, self.area, slice(0, r), FEATURE_SCALE),
            (self.point_features, np.ones(self.point_count), slice(r, None), POINT_SCALE),
        )

        def fit(number: int) -> Mixture | None:
            features, area, part, scale = kinds[number // 2]
            weight, components = ((inside, 8), (outside, 10))[number % 2]
            own = weight[part] * area
            return fit_mixture(features, own / max(own.max(initial=0.0), 1e-12), components, seed, scale)

        models = list(parallel_map(fit, range(4), self.threads))
        ratios = [log_ratio(k[0], models[2 * n], models[2 * n + 1], k[3], self.threads) for n, k in enumerate(kinds)]
        return np.clip(np.concatenate(ratios) / 2, -self.options.appearance_limit, self.options.appearance_limit)

    def _observed_regions(self) -> NDArray[np.int64]:
        """The region node of each observation of the full scene, [T]."""
        result = np.empty(len(self.full.track_view), np.int64)
        for index, regions in enumerate(self.regions):
            here = self.full.observations(index)
            result[here] = regions.at(self.full.track_uv[here]) + self.start[index]
        return result

    def _laplacian(self, shape: PointFeatures) -> tuple[sparse.csr_matrix, Array]:
        first, second, weight = [], [], []
        for index, regions in enumerate(self.regions):
            mean_square = (regions.contrast**2 * regions.border).sum() / max(regions.border.sum(), 1e-9)
            alike = np.exp(-(regions.contrast**2) / max(mean_square, 1e-9))
            first.append(regions.pairs[:, 0] + self.start[index])
            second.append(regions.pairs[:, 1] + self.start[index])
            weight.append(regions.border / 8 * alike + 0.002)
        first += [self.observed, shape.pairs[:, 0] + self.region_count]
        second += [self.scene.track_point + self.region_count, shape.pairs[:, 1] + self.region_count]
        weight += [np.full(len(self.observed), self.options.track_weight), self.options.space_weight * shape.closeness]
        count = self.region_count + self.point_count
        ties = sparse.coo_matrix(
            (np.concatenate(weight), (np.concatenate(first), np.concatenate(second))), shape=(count, count)
        ).tocsr()
        ties = ties + ties.T
        degree = np.asarray(ties.sum(1)).ravel()
        return (sparse.diags(degree) - ties).tocsr(), degree

    def _point_features(self, shape: PointFeatures) -> Array:
        owner = self.scene.track_point
        mean = np.zeros((self.point_count, self.features.shape[1]))
        np.add.at(mean, owner, self.features[self.observed])
        mean /= np.maximum(np.diff(self.scene.track_start), 1)[:, None]
        upright = np.abs(shape.normals @ shape.up)
        return np.column_stack([mean, 6 * shape.flatness * upright, 4 * shape.flatness])

    def _split(self, probability: Array, appearance: Array, ground: Ground | None) -> BuildingProbability:
        cut = [slice(self.start[k], self.start[k + 1]) for k in range(len(self.regions))]
        return BuildingProbability(
            tuple(probability[c].astype(np.float32) for c in cut),
            probability[self.region_count :].astype(np.float32),
            tuple((1 / (1 + np.exp(-appearance[c]))).astype(np.float32) for c in cut),
            ground,
        )
