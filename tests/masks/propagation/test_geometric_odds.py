# SPDX-License-Identifier: GPL-3.0-or-later
"""Evidence of the ground, of what stands on the building and of what is apart from every click."""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.synthetic.house import OFFSET
from mgf_engine.masks.geometry.point_features import measure_point_features
from mgf_engine.masks.prompts import Clicks
from mgf_engine.masks.propagation.geometric_odds import GeometricEvidence, GeometricOdds
from mgf_engine.masks.propagation.label_graph import LabelGraph
from mgf_engine.masks.propagation.superpixels import cut_regions
from mgf_engine.model.scene import Scene
from mgf_engine.scene.validation import keep_points

VIEWS = (3, 4)


@pytest.fixture(scope="module")
def graph(scene: Scene) -> LabelGraph:
    regions = [cut_regions(scene.photo(i)) for i in range(len(scene.views))]
    return LabelGraph(scene, regions, measure_point_features(scene))


@pytest.fixture
def geometry(graph: LabelGraph) -> GeometricOdds:
    return GeometricOdds(graph)


def heights(scene: Scene) -> np.ndarray:
    """Of the points over the lawn, in the units of the house, [P]."""
    return np.asarray(scene.to_normalised.invert(scene.points)[:, 2] - OFFSET[2])


def click(scene: Scene, wanted: np.ndarray) -> Clicks:
    """A click on a point of the first view that is wanted, bool [P]."""
    here = scene.observations(VIEWS[0])
    on = scene.track_uv[here][wanted[scene.track_point[here]]]
    return Clicks(on[len(on) // 2][None].astype(float), np.zeros((0, 2)))


def place(
    geometry: GeometricOdds, points: np.ndarray, prompts: dict[int, Clicks], regions: float = 0.5
) -> tuple[GeometricEvidence, np.ndarray]:
    """The evidence by the probability of points [P] and of all regions; what the building's extent was made of, [P]."""
    count = geometry.graph.region_count
    probability = np.concatenate([np.full(count, regions), points])
    used = []
    found = geometry._extent

    def extent(keep, *rest):
        used.append(keep)
        return found(keep, *rest)

    geometry._extent = extent  # type: ignore[method-assign]
    evidence = geometry.evaluate(probability, np.zeros(len(probability)), prompts, 0, VIEWS)
    return evidence, used[0] if used else np.zeros(len(points), bool)


def test_ground_is_held_back_from_the_building_however_probable(scene: Scene, geometry: GeometricOdds) -> None:
    """Clicks on the wall only: lawn that looks like the house (probability 0.9) is neither building nor tied to it."""
    height = heights(scene)
    lawn, wall = height < 0.01, height > 1.0
    probability = np.where(wall, 0.95, 0.9)
    probability[np.flatnonzero(lawn)[::2]] = 0.4  # enough of it looks like ground to be found
    evidence, used = place(geometry, probability, {VIEWS[0]: click(scene, wall)})
    assert evidence.ground is not None
    assert used[wall].mean() > 0.95 and used[lawn].mean() < 0.05
    odds, grounded = (a[geometry.graph.region_count :] for a in (evidence.odds, evidence.grounded))
    assert grounded[lawn].mean() > 0.95 and not grounded[wall].any()
    assert np.median(odds[lawn]) < 0.8 * geometry.options.ground_odds < 0


def test_a_clicked_lawn_is_no_ground(scene: Scene, geometry: GeometricOdds) -> None:
    height = heights(scene)
    lawn = height < 0.01
    probability = np.where(lawn, 0.4, 0.95)
    evidence, _ = place(geometry, probability, {VIEWS[0]: click(scene, lawn)})
    assert evidence.ground is None and not evidence.grounded.any()


def joined(scene: Scene, added: Scene) -> Scene:
    """A scene with the points of another behind its own."""
    return replace(
        scene,
        points=np.concatenate([scene.points, added.points]),
        colors=np.concatenate([scene.colors, added.colors]),
        errors=np.concatenate([scene.errors, added.errors]),
        track_start=np.concatenate([scene.track_start, scene.track_start[-1] + added.track_start[1:]]),
        track_view=np.concatenate([scene.track_view, added.track_view]),
        track_uv=np.concatenate([scene.track_uv, added.track_uv]),
    )


def test_added_points_belong_to_the_extent_where_regions_are_the_building_and_no_ground(
    scene: Scene, graph: LabelGraph
) -> None:
    """Every fourth point is an added one; all regions look like the building, the lawn's too."""
    chosen = np.arange(len(scene.points)) % 4 == 0
    few, added = keep_points(scene, ~chosen), keep_points(scene, chosen)
    own = LabelGraph(few, graph.regions, measure_point_features(few), full=joined(few, added))
    lawn, wall = heights(few) < 0.01, heights(few) > 1.0
    probability = np.where(wall, 0.95, 0.9)
    probability[np.flatnonzero(lawn)[::2]] = 0.4  # enough of it looks like ground to be found
    for regions, expected in ((0.95, 1.0), (0.3, 0.0)):
        evidence, used = place(GeometricOdds(own), probability, {VIEWS[0]: click(few, wall)}, regions)
        assert evidence.ground is not None and len(used) == len(scene.points)
        of_added = used[len(few.points) :]
        assert of_added[heights(added) > 1.0].mean() == pytest.approx(expected, abs=0.05)
        assert of_added[heights(added) < 0.01].mean() < 0.1


def test_a_building_across_the_street_is_apart(scene: Scene, graph: LabelGraph) -> None:
    """Half of the scene moved far away: as probable as the clicked half, and no part of it."""
    far = scene.points[:, 0] > np.median(scene.points[:, 0])
    moved = replace(scene, points=scene.points + 40.0 * far[:, None] * np.array([1.0, 0, 0]))
    geometry = GeometricOdds(replace_scene(graph, moved))
    prompts = {VIEWS[0]: click(scene, ~far & (heights(scene) > 1.0))}
    evidence, used = place(geometry, np.full(len(far), 0.95), prompts)
    odds = evidence.odds[graph.region_count :]
    assert not used[far].any() and used[~far].any()
    assert np.median(odds[far]) == geometry.options.apart_odds < 0 < np.median(odds[~far])


def test_points_before_the_sky_are_no_part_of_the_extent(scene: Scene, graph: LabelGraph) -> None:
    """A mismatch high above the roof, as probable as the wall: both photos show sky at its place."""
    wall = heights(scene) > 1.0
    wrong = np.flatnonzero(wall)[:3]
    points = scene.points.copy()
    up = graph.point_features.up
    points[wrong] = points[wall].mean(0) + 0.9 * np.ptp(points[wall] @ up) * up
    moved = replace_scene(graph, replace(scene, points=points))
    prompts = {VIEWS[0]: click(scene, wall)}
    floaters = GeometricOdds(moved).floaters(prompts)
    assert floaters[wrong].all() and floaters.sum() == len(wrong)
    extent = GeometricOdds(moved).extent(wall, None, prompts)
    assert not extent.keep[wrong].any() and extent.keep.any()


def test_improbable_points_away_from_the_building_are_of_other_things(scene: Scene, graph: LabelGraph) -> None:
    """Half of the scene moved far away and improbable: it may hide the building, and no point near that may."""
    far = scene.points[:, 0] > np.median(scene.points[:, 0])
    moved = replace(scene, points=scene.points + 40.0 * far[:, None] * np.array([1.0, 0, 0]))
    geometry = GeometricOdds(replace_scene(graph, moved))
    found, others = geometry._extent, []
    geometry._extent = lambda *given: others.append(given[-1]) or found(*given)  # type: ignore[method-assign]
    probability = np.concatenate([np.full(graph.region_count, 0.5), np.where(far, 0.05, 0.95)])
    prompts = {VIEWS[0]: click(scene, ~far & (heights(scene) > 1.0))}
    evidence = geometry.evaluate(probability, np.zeros(len(probability)), prompts, 0, VIEWS)
    raised = far & ~evidence.grounded[graph.region_count :]
    assert raised.any() and others[0][raised].all() and not others[0][~far].any()


@pytest.mark.parametrize("view", VIEWS)
def test_a_click_beyond_the_points_widens_the_building_in_all_photos(
    scene: Scene, graph: LabelGraph, view: int
) -> None:
    """Without points on the roof, its regions are far from the building, unless it is clicked in some photo."""
    height = heights(scene)
    bare = replace_scene(graph, keep_points(scene, height < 0.5 * height.max()))
    geometry, here = GeometricOdds(bare), scene.observations(VIEWS[0])
    high = scene.track_uv[here][height[scene.track_point[here]] > 0.9 * height.max()].astype(float)
    here = scene.observations(view)
    shown = scene.track_uv[here][height[scene.track_point[here]] > 0.9 * height.max()].astype(float)
    roof = np.unique(bare.regions[view].at(shown)) + bare.start[view]
    wall = click(bare.scene, heights(bare.scene) > 0.4 * height.max())
    clicked = Clicks(np.vstack([wall.positive, high[:1]]), wall.negative)
    probability = np.r_[np.full(bare.region_count, 0.5), np.full(bare.point_count, 0.95)]
    alike = np.zeros(len(probability))
    alike[roof] = 3.0  # in colour and texture
    far, held = (geometry.evaluate(probability, alike, {VIEWS[0]: c}, 0, VIEWS).odds[roof] for c in (wall, clicked))
    assert np.median(far) < -1
    assert np.median(held) > 0.5 * np.median(far)


def replace_scene(graph: LabelGraph, scene: Scene) -> LabelGraph:
    """A graph of the same photos with other points."""
    return LabelGraph(scene, graph.regions, measure_point_features(scene))


def test_silhouettes_count_less_where_plants_may_hide_the_building(
    scene: Scene, graph: LabelGraph, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Similarity to plants from 0 to 1, and probabilities from 0 to 1, over the regions of a photo."""
    green = copy(graph)
    green.plants = np.resize(np.linspace(0, 1, 11), len(graph.plants))
    probability, asked = np.resize(np.linspace(1, 0, 7), len(graph.plants)), []
    probability[graph.region_count :] = 0.95

    def odds(said, points, *rest):
        asked.extend(said)
        return [np.full(len(silhouette.inside), 0.5) for silhouette in said]

    monkeypatch.setattr("mgf_engine.masks.propagation.geometric_odds.silhouette_odds", odds)
    views = (1, 2, 3, 4)
    nothing = GeometricEvidence.nothing(len(probability))
    found = GeometricOdds(green).silhouettes(probability, nothing, views)
    parts = [slice(graph.start[i], graph.start[i + 1]) for i in views]
    looked_at = np.concatenate([np.arange(part.start, part.stop) for part in parts])
    assert (found[looked_at] == 0.5).all() and not np.delete(found, looked_at).any()
    options = green.options.silhouettes
    weight = np.interp(green.plants, options.plants, (1, 0))
    inside = np.interp(probability, 0.5 + 0.5 * options.softness * np.array([-1, 1]), (0, 1))
    for silhouette, part in zip(asked, parts, strict=True):
        assert silhouette.weight == pytest.approx(weight[part], abs=1e-6)
        assert silhouette.inside == pytest.approx(inside[part], abs=1e-6)
    assert weight[looked_at].min() < 0.5 < weight[looked_at].max()


def test_silhouettes_of_few_photos_are_not_asked(scene: Scene, geometry: GeometricOdds) -> None:
    probability = np.full(len(geometry.graph.sky), 0.95)
    few = range(geometry.options.silhouettes.least_views)
    assert not geometry.silhouettes(probability, GeometricEvidence.nothing(len(probability)), few).any()


def test_too_few_points_say_nothing_of_the_extent(scene: Scene, geometry: GeometricOdds) -> None:
    evidence, used = place(geometry, np.full(len(scene.points), 0.2), {VIEWS[0]: click(scene, heights(scene) > 1.0)})
    assert not used.any() and not evidence.over.any()
