# SPDX-License-Identifier: GPL-3.0-or-later
"""Geometric evidence for the label propagation: log-odds of "building" from ground plane, extent and occlusion.

The points that probably belong to the building span a surface (:mod:`mgf_engine.masks.geometry.building_extent`).
Regions get log-odds by whether their rays hit it, miss it, or hit the ground first; points by whether they lie on the
ground plane, stand on the building, or are disconnected from every click.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mgf_engine.masks.geometry.building_extent import BuildingExtent, ExtentOptions, ViewRegions
from mgf_engine.masks.geometry.floaters import sky_behind
from mgf_engine.masks.geometry.ground_plane import GroundPlane, find_ground_plane
from mgf_engine.masks.geometry.point_features import clicked_groups, measure_point_features
from mgf_engine.masks.geometry.point_visibility import PointVisibility
from mgf_engine.masks.geometry.silhouette_consistency import Silhouette, silhouette_odds
from mgf_engine.masks.geometry.superstructures import find_superstructures
from mgf_engine.masks.prompts import Prompts
from mgf_engine.masks.propagation.label_graph import LabelGraph
from mgf_engine.masks.propagation.superpixels import Superpixels
from mgf_engine.model.pixels import pixel_at
from mgf_engine.model.scene import View
from mgf_engine.native.parallel import parallel_map

Array = NDArray[np.float64]


@dataclass(frozen=True)
class GeometricEvidence:
    """Geometric evidence of all nodes of the graph [N], regions first; only of the views that were evaluated.

    Attributes:
        odds: log-odds of "building".
        grounded: nodes that are ground.
        over: points that stand on the building.
        ground: the plane; None where there is none, or the clicks count it in.
    """

    odds: Array
    grounded: NDArray[np.bool_]
    over: NDArray[np.bool_]
    ground: GroundPlane | None

    @classmethod
    def nothing(cls, nodes: int) -> GeometricEvidence:
        """Return no evidence about any of the nodes."""
        return cls(np.zeros(nodes), np.zeros(nodes, bool), np.zeros(nodes, bool), None)


class GeometricOdds:
    """Evidence of where the building is.

    Args:
        graph: of the scene.
        extent: options of the building's extent in the photos.
    """

    def __init__(self, graph: LabelGraph, extent: ExtentOptions = ExtentOptions()) -> None:
        self.graph, self.options, self._extent_options = graph, graph.options, extent
        added = graph.full is not graph.scene
        self.full_features = graph.point_features
        if added:
            self.full_features = measure_point_features(graph.full, graph.point_features.up, self.options.features)
        self.visibility = PointVisibility(
            graph.full, self.full_features, len(graph.scene.points), self.options.visibility
        )
        pieces = np.split(graph.sky, graph.start[1:])
        photos = zip(graph.scene.views, graph.regions, pieces, strict=False)  # the last pieces are the points'
        self._sky_behind = sky_behind(graph.full.points, photos, self.options.floaters)

    def evaluate(
        self, probability: Array, appearance: Array, prompts: Prompts, seed: int, views: Sequence[int]
    ) -> GeometricEvidence:
        """Compute the odds that the geometry gives in these views.

        Args:
            probability: of "building" so far, of all nodes [N].
            appearance: log-odds of "building" by colour and texture, [N].
            prompts: clicks by view index.
            seed: of the search for the ground.
            views: indices of the views to look at.
        """
        graph, own, cut = self.graph, self.options, [self.graph.region_count]
        evidence = GeometricEvidence.nothing(len(probability))
        # Views of the same memory: what is written to the parts is written to the whole.
        region_odds, point_odds = np.split(evidence.odds, cut)
        region_grounded, point_grounded = np.split(evidence.grounded, cut)
        over = evidence.over[graph.region_count :]
        points = probability[graph.region_count :]
        ground = self._find_ground(points, prompts, seed)
        evidence = replace(evidence, ground=ground)
        held, added_ground = self._rate_ground(ground)
        point_odds[:] = own.ground_odds * held
        region_odds[:] = own.ground_odds * graph.shows_added(added_ground)
        point_grounded[:] = held > 0.5
        points = np.minimum(points, 1 - held)
        keep, apart = self._building_points(points, prompts)
        floaters = self.floaters(prompts)
        keep &= ~floaters[: graph.point_count]
        point_odds += own.apart_odds * apart
        if keep.sum() < 10:
            return evidence
        over[:] = find_superstructures(graph.scene.points, keep, graph.point_features, own.superstructures)
        evidence.odds[:] += own.over_odds * evidence.over
        keep |= over & (points > own.other_below)
        others = apart | ((points < own.other_below) & ~point_grounded & ~over & self._far_from(keep))
        added = graph.added_on_building(probability) & (added_ground < 0.5)
        extent = self._extent(np.concatenate([keep, added]) & ~floaters, ground, others)
        tied = self._tied_to_building(keep, points, appearance, graph.clicked_regions(prompts))
        odds, first, within = self._evidence_of_views(extent, tied, prompts, views)
        region_odds += odds
        region_grounded[:] = first & (ground is not None)
        point_odds += own.within_odds * within * ~point_grounded
        return evidence

    def _evidence_of_views(
        self, extent: BuildingExtent, tied: Array, prompts: Prompts, views: Sequence[int]
    ) -> tuple[Array, NDArray[np.bool_], Array]:
        """Compute what the extent of the building in some views says of regions and points.

        Args:
            extent: of the building.
            tied: how likely regions belong to the building although no point of it is near, 0..1, [regions].
            prompts: clicks by view index.
            views: indices of the views to look at.

        Returns:
            log-odds of the regions, 0 in other views [regions]; which regions' rays meet the ground first [regions];
            and the share of its observations in these views that see each point on the building or behind it, [P].
        """
        graph = self.graph
        positive = [i for i, clicks in prompts.items() if len(clicks.positive)]
        places = dict(parallel_map(lambda i: (i, extent.view_regions(i)), positive, graph.threads))
        clicked = self._clicks_beyond(places, prompts)
        geometry = parallel_map(lambda i: self._geometry(extent, i, places.get(i), tied, clicked), views, graph.threads)
        odds, first = np.zeros(graph.region_count), np.zeros(graph.region_count, bool)
        within = np.zeros(graph.point_count)
        for index, (own_odds, own_first, seen_within) in zip(views, geometry, strict=True):
            part = slice(graph.start[index], graph.start[index + 1])
            odds[part], first[part] = own_odds, own_first
            within += seen_within
        observed = graph.scene.track_point[np.isin(graph.scene.track_view, views)]
        return odds, first, within / np.maximum(np.bincount(observed, minlength=graph.point_count), 1)

    def _rate_ground(self, ground: GroundPlane | None) -> tuple[Array, Array]:
        """Rate how far each sparse point and each added one is ground, 0..1; 0 where there is none."""
        graph = self.graph
        if ground is None:
            return np.zeros(graph.point_count), np.zeros(graph.added_count)
        added = ground.membership(graph.full, self.full_features)[graph.point_count :]
        return ground.membership(graph.scene, graph.point_features), added

    def silhouettes(self, probability: Array, placed: GeometricEvidence, views: Sequence[int]) -> Array:
        """Compute the log-odds of regions by the silhouettes of all other photos, [N]; 0 for other nodes.

        Args:
            probability: of "building" so far, of all nodes [N].
            placed: evidence of :meth:`evaluate`.
            views: indices of the views to look at.
        """
        graph, own = self.graph, self.options.silhouettes
        points = probability[graph.region_count :] > self.options.building_above
        points &= ~placed.grounded[graph.region_count :]
        result = np.zeros(len(probability))
        if points.sum() < 10 or len(views) <= own.least_views:
            return result
        low, high = own.plants
        inside = np.clip((probability - 0.5) / own.softness + 0.5, 0, 1).astype(np.float32)
        weight = (1 - np.clip((graph.plants - low) / max(high - low, 1e-9), 0, 1)).astype(np.float32)
        parts = [slice(graph.start[i], graph.start[i + 1]) for i in views]
        silhouettes = [
            Silhouette(graph.scene.views[i], graph.regions[i], inside[part], weight[part])
            for i, part in zip(views, parts, strict=True)
        ]
        odds = silhouette_odds(silhouettes, graph.scene.points[points], placed.ground, graph.threads, own)
        for part, values in zip(parts, odds, strict=True):
            result[part] = values
        return result

    def _find_ground(self, points: Array, prompts: Prompts, seed: int) -> GroundPlane | None:
        """Find the ground plane, by the probability of "building" of the points [P]; None if the clicks count it in.

        Such a plane is a plinth that the clicks take for a part of the building: no evidence against it.
        """
        ground = find_ground_plane(self.graph.scene, self.graph.point_features, 1 - points, seed, self.options.ground)
        if ground is None or not self._clicks_reject(
            ground.membership(self.graph.scene, self.graph.point_features), prompts
        ):
            return None
        return ground

    def _building_points(self, points: Array, prompts: Prompts) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Find the points that are probably the building [P], and such points apart from every click [P]."""
        graph, probable = self.graph, points > self.options.building_above
        clicked = clicked_groups(
            graph.scene.points, probable, graph.clicked_points(prompts), graph.point_features, self.options.features
        )
        return probable & clicked, probable & ~clicked

    def _tied_to_building(
        self, keep: NDArray[np.bool_], points: Array, appearance: Array, clicked: NDArray[np.bool_]
    ) -> Array:
        """Rate how likely regions belong to the building although no point of it is near, 0..1, [regions].

        A sheet roof or a plain wall has points along its edges only. A region that resembles the building, and is
        connected to its points or positive clicks more than to others, may be the same surface.

        Args:
            keep: points of the building, bool [P].
            points: probability of "building" of the points, [P].
            appearance: log-odds of "building" by colour and texture, of all nodes [N].
            clicked: regions with a positive click, bool [regions].
        """
        own = self.options
        sky = self.graph.sky[: self.graph.region_count] > 0
        known = np.concatenate([sky | clicked, keep | (points < own.other_below)])
        target = np.concatenate([clicked, keep]).astype(np.float64)
        wanted = 1 / (1 + np.exp(-appearance))
        strength = own.tie_appearance_weight * np.abs(2 * wanted - 1) * ~known + 1e-4
        pull = own.click_weight * known
        tied = self.graph.solve(pull + strength, pull * target + strength * wanted, None)[: self.graph.region_count]
        low, high = own.tied
        return np.clip((tied - low) / (high - low), 0, 1)

    def _geometry(
        self, extent: BuildingExtent, index: int, place: ViewRegions | None, tied: Array, clicked: Array
    ) -> tuple[Array, NDArray[np.bool_], NDArray[np.int64]]:
        """Return the log-odds of a view's regions [S], which meet the ground first [S], and which points it sees within
        [P].

        Args:
            extent: of the building.
            index: of the view.
            place: the extent in this view; None computes it.
            tied: how likely regions belong to the building although no point of it is near, 0..1, [regions].
            clicked: places that were clicked beyond the building's points, normalised frame [N, 3].
        """
        place = extent.view_regions(index) if place is None else place
        sure = 1 - tied[self.graph.start[index] : self.graph.start[index + 1]]
        view = self.graph.scene.views[index]
        uv, _, inside = view.project_into_frame(clicked)
        if self._beyond(place, view, uv[inside]).any():
            # The building is larger in this photo than its points: their hull does not tell where it ends.
            place = replace(place, hull=np.ones_like(place.hull))
        odds, first = self._region_odds(place, self.graph.regions[index], view, sure)
        seen = self.visibility.owner[self.graph.full.observations(index)][extent.within(index, place)]
        return odds, first, np.bincount(seen, minlength=len(self.graph.full.points))[: self.graph.point_count]

    def _clicks_beyond(self, places: Mapping[int, ViewRegions], prompts: Prompts) -> Array:
        """Return where positive clicks lie that are well beyond the building's points, normalised frame [N, 3].

        They are taken to be as far from the camera as the building's surface next to them in the photo.

        Args:
            places: the extent in the views with positive clicks, by view index.
            prompts: clicks by view index.
        """
        points = [np.zeros((0, 3))]
        for index, place in places.items():
            view, positive = self.graph.scene.views[index], prompts[index].positive
            beyond = positive[self._beyond(place, view, positive)]
            surface = np.argwhere(np.isfinite(place.near))
            if len(beyond) and len(surface):
                _, nearest = cKDTree(surface).query(np.stack(self._map_pixels(place, view, beyond), 1))
                points.append(view.unproject(beyond, place.near[tuple(surface[nearest].T)]))
        return np.concatenate(points)

    def _beyond(self, place: ViewRegions, view: View, at: Array) -> NDArray[np.bool_]:
        """Tell which places in a photo, working pixels [N, 2], lie well beyond the building's points, [N]."""
        y, x = self._map_pixels(place, view, at)
        return np.asarray(~place.hull[y, x] & (place.away[y, x] > self.options.far_from), bool)

    @staticmethod
    def _map_pixels(place: ViewRegions, view: View, at: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return rows and columns of the map's pixels at places in a photo, working pixels [N, 2]."""
        h, w = place.hull.shape
        return pixel_at((h, w), at * (w / view.width, h / view.height))

    def extent(self, keep: NDArray[np.bool_], ground: GroundPlane | None, prompts: Prompts) -> BuildingExtent:
        """Return the extent of the building.

        Args:
            keep: of the full scene's points, those of the building; floaters among them are left out.
            ground: the plane under it, None without.
            prompts: clicks by view index.
        """
        return self._extent(keep & ~self.floaters(prompts), ground)

    def _extent(
        self, keep: NDArray[np.bool_], ground: GroundPlane | None, others: NDArray[np.bool_] | None = None
    ) -> BuildingExtent:
        """Return the extent of the building by its points, with ``others`` [P] of things beside it on the ground."""
        if others is not None:
            others = np.concatenate([others, np.zeros(len(keep) - len(others), bool)])
        return BuildingExtent(
            self.graph.full, self.full_features, keep, ground, self.visibility, others, self._extent_options
        )

    def floaters(self, prompts: Prompts) -> NDArray[np.bool_]:
        """Return points of the full scene behind which photos show sky that no click calls building, bool."""
        rows, pieces = self._sky_behind.T
        sky = np.unique(self.graph.sky[self.graph.unclicked_sky(prompts)])
        count = np.bincount(rows[np.isin(pieces, sky)], minlength=len(self.graph.full.points))
        return np.asarray(count >= self.options.floaters.photos, bool)

    def _far_from(self, keep: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return points farther from all kept ones than a wall is from the roof on it, [P]."""
        gap = float(self.options.other_gap * np.median(self.graph.point_features.spacing[keep]))
        distance, _ = cKDTree(self.graph.scene.points[keep]).query(
            self.graph.scene.points, distance_upper_bound=np.nextafter(gap, np.inf), workers=self.graph.threads
        )
        return np.asarray(distance > gap, bool)  # infinite beyond the bound

    def _clicks_reject(self, grounded: Array, prompts: Prompts) -> bool:
        """Tell whether the ground is background: more negative than positive clicks lie on it, or no clicks at all.

        Users need not click on the ground: by default it does not belong to the building.
        """
        on_ground = grounded > 0.5
        negative = sum(int(on_ground[self.graph.points_at(i, c.negative)].sum()) for i, c in prompts.items())
        positive = sum(int(on_ground[self.graph.points_at(i, c.positive)].sum()) for i, c in prompts.items())
        return negative > positive or negative == positive == 0

    def _region_odds(
        self, place: ViewRegions, regions: Superpixels, view: View, sure: Array
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Return the log-odds of each region, and whether its ray meets the ground first, [S] each.

        Args:
            sure: weight of the evidence that no point of the building is near, 0..1, [S].
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
