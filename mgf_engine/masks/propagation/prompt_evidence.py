# SPDX-License-Identifier: GPL-3.0-or-later
"""Find evidence against clicks on the building: what they lie on, and clicks beside the building on the same surface.

A colour that the clicks in other photos do not explain is no such evidence: it may be that of a part that is clicked
for the first time. What counts is sky, leaves or ground under the click, or that a random walk from the click along the
graph, which knows edges and points but no colour models, ends at clicks beside the building rather than on it.

Clicks on sky, leaves and ground say nothing of a part that hangs together with the building, although it may stand
nearer to them than to the first click on the building.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mgf_engine.masks.geometry.ground_plane import GroundPlane
from mgf_engine.masks.geometry.point_features import clicked_groups
from mgf_engine.masks.prompts import Clicks, Prompts
from mgf_engine.masks.propagation.prompt_outliers import OutlierPrompt, clicked_elsewhere, without_outliers
from mgf_engine.masks.propagation.random_walker import LabelPropagation
from mgf_engine.options.algorithms import parameter

EDGE_ARM = 10  # px that a click may lie over the edge


@dataclass(frozen=True)
class PromptEvidenceOptions:
    """Options of the evidence against a click on the building."""

    leafy: float = parameter(0.3, "Similarity to plants above which a region or point shows leaves", high=1)
    grounded: float = parameter(0.5, "Membership of the ground plane above which a point is ground", high=1)
    clear_of_ground: float = parameter(
        3.0, "Height above the ground, in thicknesses of its plane, from which points tie a part to the building"
    )
    least_walk: float = parameter(
        0.001, "Probability of ending at a click below which a fading random walk tells nothing", high=1
    )


class PromptEvidence:
    """Evidence for and against the clicks of a scene.

    Args:
        walker: label propagation of the scene.
        prompts: all clicks by view index.
        ground: plane that is no part of the building; None without.
        options: what leaves and ground are, and how far random walks tell anything.
    """

    def __init__(
        self,
        walker: LabelPropagation,
        prompts: Prompts,
        ground: GroundPlane | None,
        options: PromptEvidenceOptions = PromptEvidenceOptions(),
    ) -> None:
        self.walker, self.graph, self.prompts, self.options = walker, walker.graph, prompts, options
        self.grounded = np.zeros(self.graph.point_count, bool)
        self.solid = self.graph.plants[self.graph.region_count :] <= options.leafy
        if ground is not None:
            scene = self.graph.scene
            self.grounded = ground.membership(scene, self.graph.point_features) > options.grounded
            self.solid &= ground.height(scene.points) > options.clear_of_ground * ground.thickness

    def find_denied(self, suspects: Sequence[OutlierPrompt]) -> list[OutlierPrompt]:
        """Return the suspected clicks on the building that evidence denies; suspects themselves deny nothing.

        A photo may be clicked on another building: where all its clicks on the building are suspects, and one more
        click in it is, they are denied unless clicks in other photos support them.
        """
        on_building = [click for click in suspects if click.positive]
        if not on_building:
            return []
        others = without_outliers(self.prompts, suspects)
        attached = self._attached_points(others)
        walks = {True: self._walk(self._without_background(others)), False: self._walk(others)}
        denied = []
        for click in on_building:
            index, at = click.view, click.at(self.prompts)
            building, background = self._ends(
                click, *walks[bool(attached[self.graph.points_at(index, at[None])].any())]
            )
            more = sum(other.view == index for other in suspects) > 1
            elsewhere = more and clicked_elsewhere(index, suspects, self.prompts)
            supported = building > max(background, self.options.least_walk)
            opposed = background > max(building, self.options.least_walk)
            if opposed or (elsewhere and not supported) or self.on_background(index, at):
                denied.append(click)
        return denied

    def on_background(self, index: int, at: NDArray[np.float64]) -> bool:
        """Tell whether a place in a photo, working pixels [2], is sky, leaves or ground, also a few pixels away."""
        nodes = self.graph.regions[index].at_cross(at, EDGE_ARM) + self.graph.start[index]
        if ((self.graph.sky[nodes] > 0) | (self.graph.plants[nodes] > self.options.leafy)).all():
            return True
        return bool(self.grounded[self.graph.points_at(index, at[None])].any())

    def _without_background(self, prompts: Prompts) -> Prompts:
        """Return the clicks without those beside the building that lie on sky, leaves or ground."""
        result = {}
        for index, clicks in prompts.items():
            keep = [not self.on_background(index, at) for at in clicks.negative]
            result[index] = Clicks(clicks.positive, clicks.negative[np.array(keep, bool)], clicks.parts)
        return result

    def _attached_points(self, prompts: Prompts) -> NDArray[np.bool_]:
        """Find the points that hang together with clicks on the building, not by the ground or plants, bool [P]."""
        graph, clicked = self.graph, self.graph.clicked_points(prompts)
        if not self.solid[clicked].any():
            return np.zeros(len(self.solid), bool)
        return clicked_groups(graph.scene.points, self.solid, clicked, graph.point_features, graph.options.features)

    def _walk(self, prompts: Prompts) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        return self.walker.fading_walks(*self.graph.click_pull(prompts))

    def _ends(
        self, click: OutlierPrompt, building: NDArray[np.float64], background: NDArray[np.float64]
    ) -> tuple[float, float]:
        """Return the probabilities that a walk from a click ends on the building and beside it: the kindest."""
        graph = self.graph
        nodes = graph.regions[click.view].at_cross(click.at(self.prompts), EDGE_ARM) + graph.start[click.view]
        node = nodes[np.argmax(building[nodes] / np.maximum(building[nodes] + background[nodes], 1e-12))]
        return float(building[node]), float(background[node])
