# SPDX-License-Identifier: GPL-3.0-or-later
"""Which photos are matched with which: those that share points, under an angle that shows depth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.synthetic.colmap_scene import load, reconstruction, write_scene
from mgf_engine.model.scene import Scene
from mgf_engine.scene import neighbours
from mgf_engine.scene.neighbours import MatchingPoints


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    """Five photos; each of 300 points was observed by some of them, one point twice by the same photo."""
    found = load(write_scene(reconstruction(), tmp_path / "scene"), tmp_path / "job")
    rng = np.random.default_rng(0)
    points = found.points.mean(0) + rng.normal(0, 0.2, (300, 3))
    tracks = [np.flatnonzero(rng.random(len(found.views)) < 0.5) for _ in points]
    tracks[0] = np.array([1, 1, 3])
    count, seen = np.cumsum([0, *map(len, tracks)]), np.concatenate(tracks).astype(np.int32)
    return replace(
        found, points=points, colors=np.zeros((300, 3), np.uint8), errors=np.zeros(300, np.float32),
        track_start=count.astype(np.int64), track_view=seen, track_uv=np.ones((len(seen), 2), np.float32),
    )  # fmt: skip


def test_overlap_is_that_of_the_points_both_photos_observed(scene: Scene) -> None:
    kept = np.random.default_rng(1).random(300) < 0.8
    views = [0, 1, 3, 4]
    shared, angle = neighbours._overlap(MatchingPoints(scene, kept, views), 20)
    for a, i in enumerate(views):
        for b, j in enumerate(views):
            both = set(scene.track_point[scene.observations(i)]) & set(scene.track_point[scene.observations(j)])
            common = sorted(p for p in both if kept[p])
            assert shared[a, b] == (len(common) if i != j else 0)
            if i != j:
                rays = [scene.points[common] - scene.views[k].centre for k in (i, j)]
                cosine = (rays[0] * rays[1]).sum(1) / np.prod([np.linalg.norm(r, axis=1) for r in rays], axis=0)
                assert angle[a, b] == pytest.approx(np.degrees(np.median(np.arccos(cosine))), abs=0.05)


def test_medians_are_those_of_numpy() -> None:
    rng = np.random.default_rng(0)
    group, values = rng.integers(0, 900, 20_000), np.cos(rng.random(20_000) * 0.01)
    found, middle = neighbours._medians(group, values)
    assert np.array_equal(found, np.unique(group))
    assert np.array_equal(middle, [np.median(values[group == g]) for g in found])
    assert [len(part) for part in neighbours._medians(group[:0], values[:0])] == [0, 0]


@pytest.mark.parametrize("views", [[], [2]])
def test_a_photo_alone_has_no_neighbours(scene: Scene, views: list[int]) -> None:
    assert MatchingPoints(scene, np.ones(300, bool), views).neighbours(3) == {i: [] for i in views}
    assert MatchingPoints(scene, np.zeros(300, bool), views).neighbours(3) == {i: [] for i in views}


def test_too_few_shared_points_make_no_pair(scene: Scene) -> None:
    options = neighbours.NeighbourOptions(angles=(0.0, 10.0, 180.0), least_score=0.0)
    views, everything = list(range(len(scene.views))), np.ones(300, bool)
    found = MatchingPoints(scene, everything, views).neighbours(2, options)
    assert all(len(found[i]) == 2 and i not in found[i] for i in views)
    few = np.arange(300) < 30  # any two photos share about a quarter of them
    assert not any(MatchingPoints(scene, few, views).neighbours(2, options).values())


def test_the_overlap_of_views_is_computed_once_for_each_number_of_shared_points(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked, overlap = list[int](), neighbours._overlap
    monkeypatch.setattr(neighbours, "_overlap", lambda points, least: asked.append(least) or overlap(points, least))
    points = MatchingPoints(scene, np.ones(300, bool), range(len(scene.views)))
    one, two = points.neighbours(1), points.neighbours(2)
    assert asked == [20] and all(two[i][: len(one[i])] == one[i] for i in one)
    assert not any(points.neighbours(2, neighbours.NeighbourOptions(least_shared=301)).values())
    assert asked == [20, 301]


def test_neighbours_that_fit_far_worse_than_the_best_are_left_out() -> None:
    shared, angle = np.array([400.0, 400.0, 400.0, 40.0]), np.array([10.0, 12.0, 30.0, 10.0])
    best = lambda *pair: neighbours._best(*pair, 4, neighbours.NeighbourOptions()).tolist()  # noqa: E731
    assert best(shared, angle) == [0, 1]
    assert best(shared[2:], angle[2:]) == [1, 0]  # where there are none that fit better
    assert best(shared, angle + 30) == []
