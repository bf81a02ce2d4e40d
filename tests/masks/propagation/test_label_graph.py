# SPDX-License-Identifier: GPL-3.0-or-later
"""The random walker on graphs so small that their answers are known: resistors in a row, photos joined by a point."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mgf_engine.masks.geometry.building_extent import ViewRegions
from mgf_engine.masks.geometry.point_features import PointFeatures
from mgf_engine.masks.prompts import Clicks
from mgf_engine.masks.propagation.label_graph import LabelGraph
from mgf_engine.masks.propagation.random_walker import LabelPropagation
from mgf_engine.masks.propagation.random_walker_options import RandomWalkerOptions
from mgf_engine.masks.propagation.superpixels import Superpixels
from mgf_engine.model.scene import Scene, Similarity, View

SIDE = 20  # px; every region is a column of SIDE x SIDE pixels
BORDER = 8.0  # the length of border at which a tie without contrast weighs 1
SMALL = 0.002  # what every tie weighs more
NONE = np.zeros((0, 2))
HOLD = 10.0
OPTIONS = RandomWalkerOptions()


def strip(contrast: Sequence[float], features: Sequence[Sequence[float]] | None = None) -> Superpixels:
    """A photo of columns in a row, with these colour steps between them."""
    count = len(contrast) + 1
    labels = np.repeat(np.arange(count, dtype=np.int32), SIDE)[None].repeat(SIDE, 0)
    return Superpixels(
        labels=labels,
        scale=(1.0, 1.0),
        features=np.zeros((count, 6), np.float32) if features is None else np.array(features, np.float32),
        centres=np.stack([(np.arange(count) + 0.5) * SIDE, np.full(count, SIDE / 2)], 1).astype(np.float32),
        area=np.full(count, 1 / count, np.float32),
        top=np.zeros(count, np.float32),
        pairs=np.stack([np.arange(count - 1), np.arange(1, count)], 1).astype(np.int32),
        border=np.full(count - 1, BORDER, np.float32),
        contrast=np.array(contrast, np.float32),
    )


def graph_of(
    photos: Sequence[Superpixels],
    tracks: Sequence[Sequence[tuple[int, int]]] = (),
    pairs: Sequence[tuple[int, int]] = (),
) -> LabelPropagation:
    """A graph of photos and points.

    Args:
        tracks: of each point, the (photo, column) pairs that observed it.
        pairs: points that are neighbours in space, at closeness 1.
    """
    views = tuple(
        View(f"{k}.jpg", f"{k}.jpg", p.labels.shape[1], SIDE, 100, 100, p.labels.shape[1] / 2, SIDE / 2, np.eye(3),
             np.array([0.0, 0.0, 5.0 + k]), p.labels.shape[1], SIDE)
        for k, p in enumerate(photos)
    )  # fmt: skip
    count = len(tracks)
    seen = [(view, column) for track in tracks for view, column in track]
    scene = Scene(
        views, np.arange(3 * count, dtype=float).reshape(-1, 3), np.zeros((count, 3), np.uint8),
        np.zeros(count, np.float32), np.cumsum([0, *map(len, tracks)]).astype(np.int64),
        np.array([view for view, _ in seen], np.int32),
        np.array([((column + 0.5) * SIDE, SIDE / 2) for _, column in seen], np.float32).reshape(-1, 2),
        Similarity(1.0, np.eye(3), np.zeros(3)), (0,), (), Path(),
    )  # fmt: skip
    features = PointFeatures(
        np.array([0.0, -1.0, 0.0]), np.ones(count), np.tile([0.0, 0.0, 1.0], (count, 1)), np.zeros(count),
        np.zeros(count), np.array(pairs, np.int64).reshape(-1, 2), np.ones(len(pairs)), np.zeros(count, bool),
    )  # fmt: skip
    return LabelPropagation(LabelGraph(scene, photos, features))


def joined(walker: LabelPropagation, values: dict[int, float]) -> np.ndarray:
    """The share of building at each node where some are tied to a value, with HOLD, and the others are free."""
    stiffness, source = np.full(len(walker.graph.degree), 1e-9), np.zeros(len(walker.graph.degree))
    for node, value in values.items():
        stiffness[node], source[node] = HOLD, HOLD * value
    return walker.graph.solve(stiffness, source, None)


def row_of_resistors(ties: Sequence[float]) -> np.ndarray:
    """Potentials between the ties of a row from potential 1 to 0."""
    resistance = 1 / np.array(ties)
    return 1 - np.cumsum(resistance)[:-1] / resistance.sum()


def clicks_at(columns: Sequence[int]) -> np.ndarray:
    return np.array([((c + 0.5) * SIDE, SIDE / 2) for c in columns]).reshape(-1, 2)


def test_between_two_clicks_the_probability_falls_evenly() -> None:
    wanted = row_of_resistors([HOLD, *[1 + SMALL] * 4, HOLD])
    assert joined(graph_of([strip([0.0] * 4)]), {0: 1.0, 4: 0.0}) == pytest.approx(wanted, abs=1e-3)
    assert np.diff(wanted) == pytest.approx([(wanted[-1] - wanted[0]) / 4] * 4)


def test_an_edge_in_the_photo_is_a_weak_tie() -> None:
    """Two resistors in a row: the contrast of the second is twice the mean square, so its tie weighs exp(-2)."""
    walker = graph_of([strip([0.0, 30.0])])
    first, second = 1 + SMALL, np.exp(-2) + SMALL
    assert joined(walker, {0: 1.0, 2: 0.0}) == pytest.approx(row_of_resistors([HOLD, first, second, HOLD]), abs=1e-3)


def test_ties_are_symmetric_and_the_laplacian_holds_back_nothing() -> None:
    walker = graph_of([strip([0.0, 5.0]), strip([3.0])], [[(0, 0), (1, 1)], [(0, 2)]], [(0, 1)])
    dense = walker.graph.laplacian.toarray()
    assert np.allclose(dense, dense.T) and np.allclose(dense.sum(0), 0)
    assert np.allclose(np.diag(dense), walker.graph.degree)
    assert dense[5, 0] == dense[5, 4] == -OPTIONS.track_weight == dense[6, 2]  # points to the regions that saw them
    assert dense[5, 6] == -OPTIONS.space_weight and dense[0, 3] == 0  # and to each other; photos meet in points alone


def test_points_have_the_mean_features_of_their_regions_and_those_of_their_surface() -> None:
    """One on a roof, seen in regions of features 2 and 4, and one on a slope that is half as flat."""
    photos = [strip([0.0], [[0.0] * 6, [2.0] * 6]), strip([], [[4.0] * 6])]
    graph = graph_of(photos, [[(0, 1), (1, 0)], [(0, 0)]]).graph
    normals = np.array([[0, 1.0, 0], [0.8, -0.6, 0]])  # up is -y; a normal may point down
    features = replace(graph.point_features, normals=normals, flatness=np.array([1.0, 0.5]))
    found = LabelGraph(graph.scene, photos, features).point_appearance
    assert found == pytest.approx(np.array([[3.0] * 6 + [6, 4], [0.0] * 6 + [6 * 0.5 * 0.6, 2]]))


def test_a_point_carries_a_click_from_one_photo_to_another() -> None:
    """Region, point, region in a row with ties of 1, each node losing LEAK times its ties."""
    walker = graph_of([strip([]), strip([])], [[(0, 0), (1, 0)]])
    pull, target = walker.graph.click_pull({0: Clicks(clicks_at([0]), NONE)})
    first, _, point = walker.graph.solve(pull + OPTIONS.termination * walker.graph.degree, pull * target, None)[
        [0, 1, 2]
    ]
    second = walker.graph.solve(pull + OPTIONS.termination * walker.graph.degree, pull * target, None)[1]
    loss = 1 + OPTIONS.termination
    assert point / second == pytest.approx(loss, rel=1e-3)
    assert first / second == pytest.approx(2 * loss * loss - 1, rel=1e-3)
    probability, trust = walker._first_guess(pull, target)
    assert probability[1] > 0.999 and trust[0] > trust[2] > trust[1] > 0


def test_a_click_pulls_at_five_places() -> None:
    walker = graph_of([strip([0.0, 0.0])])
    pull, target = walker.graph.click_pull(
        {0: Clicks(np.array([[22.0, 5.0]]), NONE)}
    )  # 5 px to the left is the next column
    assert pull.tolist() == [OPTIONS.click_weight, 4 * OPTIONS.click_weight, 0] and target.tolist() == [1, 1, 0]


def test_clicks_of_both_kinds_in_one_region_cancel() -> None:
    walker = graph_of([strip([0.0])])
    pull, target = walker.graph.click_pull({0: Clicks(clicks_at([0, 1]), clicks_at([0]))})
    assert target == pytest.approx([0.5, 1.0]) and pull[0] == 2 * pull[1] == 10 * OPTIONS.click_weight


def test_both_kinds_of_clicks_are_treated_alike() -> None:
    walker = graph_of([strip([0.0, 4.0, 1.0, 0.0])])
    one, other = Clicks(clicks_at([0]), clicks_at([3])), Clicks(clicks_at([3]), clicks_at([0]))
    (probability, trust), (mirrored, same) = (
        walker._first_guess(*walker.graph.click_pull({0: c})) for c in (one, other)
    )
    assert mirrored == pytest.approx(1 - probability, abs=1e-3) and same == pytest.approx(trust, abs=1e-2)
    assert (np.diff(probability[:4]) < 0).all()


def test_what_no_click_reaches_stays_unknown() -> None:
    walker = graph_of([strip([0.0]), strip([0.0])])
    probability, trust = walker._first_guess(*walker.graph.click_pull({0: Clicks(clicks_at([0]), NONE)}))
    assert probability[2:] == pytest.approx([0.5, 0.5]) and trust[2:] == pytest.approx([0, 0])
    assert probability[0] > 0.99 and trust[0] > 0.5


BRICK, LAWN = (45.0, 25.0, 20.0, 0.5, 0.5, 0.5), (60.0, -4.0, 2.0, 2.0, 2.0, 2.0)


def test_color_reaches_a_photo_without_clicks_and_ties() -> None:
    rng = np.random.default_rng(0)

    def two_materials() -> Superpixels:
        scatter = np.array([1.5, 0.6, 0.6, 0.05, 0.05, 0.05])
        features = [np.array(BRICK if k < 12 else LAWN) + rng.normal(0, scatter) for k in range(24)]
        return strip([1.0] * 11 + [40.0] + [1.0] * 11, features)

    walker = graph_of([two_materials(), two_materials()], [[(0, 3)], [(0, 20)]])
    probability = walker.solve({0: Clicks(clicks_at([2, 7]), clicks_at([15, 21]))}, rounds=1)
    clicked, other = probability.regions
    assert clicked[:12].min() > 0.9 and clicked[12:].max() < 0.1
    assert other[:12].min() > 0.7 and other[12:].max() < 0.3
    assert probability.points[0] > 0.8 and probability.points[1] < 0.2 and probability.ground is None
    assert (probability.appearance[1][:12] > 0.9).all() and (probability.appearance[1][12:] < 0.1).all()


def test_sky_is_given_up_piece_by_piece_where_it_is_clicked() -> None:
    walker = graph_of([strip([0.0, 0.0]), strip([0.0])])
    walker.graph.sky = np.array([1, 1, 2, 3, 0])
    assert walker.graph.unclicked_sky({}).tolist() == [True, True, True, True, False]
    left = walker.graph.unclicked_sky({0: Clicks(clicks_at([1]), clicks_at([2]))})
    assert left.tolist() == [False, False, True, True, False]


def test_a_click_is_on_the_nearest_point_that_its_own_photo_saw() -> None:
    walker = graph_of([strip([0.0] * 9), strip([0.0] * 9)], [[(0, 2)], [(0, 5)], [(1, 3)]])
    near, middle = OPTIONS.click_radius * 10 * SIDE, SIDE / 2
    uv = np.array([[50 + 0.9 * near, middle], [50 + 1.1 * near, middle], [70.0, middle], [110.0, middle]])
    assert walker.graph.points_at(0, uv).tolist() == [0, 1]
    assert walker.graph.points_at(1, uv[2:]).tolist() == [2] and walker.graph.points_at(0, NONE).tolist() == []


def test_evidence_of_where_the_building_is() -> None:
    """One region for each case: on the building, at its rim, far away, hidden, behind the ground, behind others."""
    names = ("core", "reach", "hidden", "ground_first", "behind", "hull")
    maps = {name: np.zeros((1, 6), bool) for name in names}
    maps["core"][0, [0, 4]] = maps["reach"][0, [0, 1, 4]] = True
    maps["hidden"][0, 3] = maps["ground_first"][0, 4] = maps["behind"][0, 5] = True
    away = np.array([[0, 1, 3.2, 0, 0, 0]], np.float32)
    place = ViewRegions(**maps, away=away, near=np.ones((1, 6), np.float32))
    regions = strip([0.0] * 5)
    walker = graph_of([regions])
    odds, first = walker.geometry._region_odds(place, regions, walker.graph.scene.views[0], np.ones(6))
    o = OPTIONS
    wanted = [o.core_odds, o.rim_odds, 2 * o.far_odds, o.hidden_odds, o.ground_first_odds, o.occluded_odds]
    assert odds == pytest.approx(wanted) and first.tolist() == [False] * 4 + [True, False]


def test_a_region_without_points_is_tied_to_the_building_or_to_the_ground() -> None:
    """A roof between two points of the building, an edge, and a lawn with a point."""
    walker = graph_of([strip([0.0] * 4 + [40.0] + [0.0] * 2)], [[(0, 0)], [(0, 4)], [(0, 7)]])
    building, probability = np.array([True, True, False]), np.array([1.0, 1.0, 0.0])
    unclicked, lawn = np.zeros(8, bool), np.r_[np.zeros(1), np.full(3, -OPTIONS.appearance_limit), np.zeros(7)]
    tied = walker.geometry._tied_to_building(building, probability, np.zeros(len(lawn)), unclicked)
    assert tied == pytest.approx([1, 1, 1, 1, 1, 0, 0, 0], abs=1e-6)
    courtyard = walker.geometry._tied_to_building(building, probability, lawn, unclicked)
    assert (courtyard[1:4] < 0.5).all()  # of another colour
    clicked = walker.geometry._tied_to_building(building, probability, lawn, np.arange(8) == 2)
    assert clicked[2] == 1 and clicked[7] == 0


def test_missing_points_say_nothing_of_a_tied_region_within_the_building() -> None:
    """Four regions that the geometry calls ground or far away: only what is tied and in the convex hull is spared."""
    none = np.zeros((1, 4), bool)
    maps = dict.fromkeys(("core", "reach", "hidden", "behind"), none)
    first, hull = none.copy(), none.copy()
    first[0, :3], hull[0, [0, 2]] = True, True
    away = np.array([[3.2, 3.2, 3.2, 3.2]], np.float32)
    place = ViewRegions(**maps, ground_first=first, hull=hull, away=away, near=np.ones((1, 4), np.float32))
    regions = strip([0.0] * 3)
    walker = graph_of([regions])
    odds, ground = walker.geometry._region_odds(
        place, regions, walker.graph.scene.views[0], np.array([0.0, 0.0, 1.0, 0.0])
    )
    far, below = 2 * OPTIONS.far_odds, OPTIONS.ground_first_odds
    assert odds == pytest.approx([0, far + below, far + below, far]) and ground.tolist() == [False, True, True, False]
