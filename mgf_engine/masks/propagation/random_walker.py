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
from numpy.typing import NDArray

from mgf_engine.masks.geometry.building_extent import ExtentOptions
from mgf_engine.masks.geometry.ground_plane import GroundPlane
from mgf_engine.masks.prompts import Prompts
from mgf_engine.masks.propagation.appearance import FEATURE_SCALE, Mixture, fit_mixture, log_ratio
from mgf_engine.masks.propagation.geometric_odds import GeometricEvidence, GeometricOdds
from mgf_engine.masks.propagation.label_graph import LabelGraph
from mgf_engine.native.parallel import parallel_map

Array = NDArray[np.float64]

#: Features of points: those of the regions that observed them, verticality of their surface, and flatness.
POINT_SCALE = np.concatenate([FEATURE_SCALE, [1.0, 1.0]])


@dataclass(frozen=True)
class BuildingProbability:
    """Probability of "building", 0..1: per photo for its regions, and for the sparse points."""

    regions: tuple[NDArray[np.float32], ...]  # V arrays [S_v]
    points: NDArray[np.float32]  # [P]
    appearance: tuple[NDArray[np.float32], ...]  # V arrays [S_v], the part of colour and texture alone
    ground: GroundPlane | None  # that the building stands on; None where there is none or the clicks count it in


class LabelPropagation:
    """The graph of a scene and the random walk on it; built once, asked with different clicks.

    Attributes:
        graph: nodes and edges.
        geometry: evidence of where the building is.
    """

    def __init__(self, graph: LabelGraph, extent: ExtentOptions = ExtentOptions()) -> None:
        self.graph, self.options = graph, graph.options
        self.geometry = GeometricOdds(graph, extent)
        counts = [graph.region_count, graph.point_count]
        self.evidence_weight = np.repeat([self.options.evidence_weight, self.options.point_evidence_weight], counts)

    def solve(
        self, prompts: Prompts, seed: int = 0, rounds: int | None = None, views: Sequence[int] | None = None
    ) -> BuildingProbability:
        """Return the probability that follows from the clicks.

        Args:
            prompts: the user's clicks.
            seed: of the mixtures of appearance.
            rounds: number of rounds; None for that of the options.
            views: where the geometry is looked at; None for all. With some, the probability holds for these alone.
        """
        looked_at = range(len(self.graph.regions)) if views is None else views
        pull, target = self.graph.click_pull(prompts)
        sky = self.graph.unclicked_sky(prompts)
        # Without a click beside the building, the sky takes their place in the first guess.
        unclicked = not any(len(c.negative) for c in prompts.values())
        weight = self.evidence_weight
        probability, trust = self._first_guess(pull + self.options.click_weight * (sky & unclicked), target)
        appearance, odds, teach = np.zeros(len(probability)), np.zeros(len(probability)), trust
        placed = GeometricEvidence.nothing(len(probability))
        for round_ in range(self.options.rounds if rounds is None else rounds):
            appearance = self._appearance(probability, teach, seed)
            odds = appearance + self.options.plant_odds * self.graph.plants + self.options.sky_odds * sky
            if round_ > 0:
                placed = self.geometry.evaluate(probability, appearance, prompts, seed, looked_at)
                odds += placed.odds
                tied = np.maximum(self.evidence_weight, self.options.over_weight * self.graph.degree)
                weight = np.where(placed.over, tied, self.evidence_weight)
                teach = np.where(placed.grounded, self.options.ground_training_weight, 1.0)
            else:
                teach = np.ones(len(probability))
            probability = self._walk(pull, target, odds, weight, probability)
        for _ in range(self.options.silhouette_rounds if rounds is None else 0):
            seen = self.geometry.silhouettes(probability, placed, looked_at)
            if not seen.any():
                break
            probability = self._walk(pull, target, odds + seen, weight, probability)
        return self._split(probability, appearance, placed.ground)

    def _walk(self, pull: Array, target: Array, odds: Array, weight: Array, probability: Array) -> Array:
        """Solve the random walk by the pull of the clicks and the odds, from the probability so far; [N] each."""
        wanted = 1.0 / (1.0 + np.exp(-odds))
        strength = weight * np.abs(2 * wanted - 1) + 1e-4
        return self.graph.solve(pull + strength, pull * target + strength * wanted, probability)

    def fading_walks(self, pull: Array, target: Array) -> tuple[Array, Array]:
        """Return the probability that a random walk from each node that may end at every step ends at clicks on the
        building, and that it ends at clicks beside it, [N] each; both are 0 where no click is near.

        Args:
            pull: strength of the clicks, [N].
            target: what they say, 0..1, [N].
        """
        stiffness = pull + self.options.termination * np.maximum(self.graph.degree, 0.1)
        wanted = target, 1.0 - target
        building, background = parallel_map(
            lambda k: self.graph.solve(stiffness, pull * wanted[k], None), range(2), self.graph.threads
        )
        return building, background

    def _first_guess(self, pull: Array, target: Array) -> tuple[Array, Array]:
        """Compare positive and negative clicks by fading random walks; returns which is nearer, and how reliably."""
        near = [np.maximum(walk, 1e-9) for walk in self.fading_walks(pull, target)]
        trust = np.clip(np.log(np.maximum(near[0], near[1]) / 1e-4) / np.log(1e4), 0, 1)
        return near[0] / (near[0] + near[1]), trust

    def _appearance(self, probability: Array, teach: Array, seed: int) -> Array:
        """Return the log-odds of "building" from appearance alone, [N]."""
        inside, outside = np.clip(2 * probability - 1.1, 0, 1) * teach, np.clip(0.9 - 2 * probability, 0, 1) * teach
        r, options = self.graph.region_count, self.options.appearance
        kinds = (
            (self.graph.features, self.graph.area, slice(0, r), FEATURE_SCALE),
            (self.graph.point_appearance, np.ones(self.graph.point_count), slice(r, None), POINT_SCALE),
        )

        def fit(number: int) -> Mixture | None:
            features, area, part, scale = kinds[number // 2]
            weight, components = ((inside, options.building), (outside, options.background))[number % 2]
            own = weight[part] * area
            return fit_mixture(features, own / max(own.max(initial=0.0), 1e-12), components, seed, scale, options)

        models = list(parallel_map(fit, range(4), self.graph.threads))
        ratios = [
            log_ratio(k[0], models[2 * n], models[2 * n + 1], k[3], self.graph.threads, options)
            for n, k in enumerate(kinds)
        ]
        return np.clip(np.concatenate(ratios) / 2, -self.options.appearance_limit, self.options.appearance_limit)

    def _split(self, probability: Array, appearance: Array, ground: GroundPlane | None) -> BuildingProbability:
        cut = [slice(self.graph.start[k], self.graph.start[k + 1]) for k in range(len(self.graph.regions))]
        return BuildingProbability(
            tuple(probability[c].astype(np.float32) for c in cut),
            probability[self.graph.region_count :].astype(np.float32),
            tuple((1 / (1 + np.exp(-appearance[c]))).astype(np.float32) for c in cut),
            ground,
        )
