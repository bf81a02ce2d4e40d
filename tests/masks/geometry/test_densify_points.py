# SPDX-License-Identifier: GPL-3.0-or-later
from pathlib import Path

import numpy as np
import pytest
from support.wall import make_wall

from benchmarks.synthetic.house import OFFSET, House
from mgf_engine.errors import Cancelled
from mgf_engine.masks.geometry.densify_points import DensifyOptions, densify_points
from mgf_engine.masks.prompts import read_prompts
from mgf_engine.masks.propagation.geometric_odds import GeometricOdds
from mgf_engine.masks.propagation.propagate import propagate
from mgf_engine.masks.segmenters.random_walker import RandomWalker
from mgf_engine.model.masks import building
from mgf_engine.model.scene import Scene
from mgf_engine.options.config import make_config
from mgf_engine.scene.validation import keep_points
from tests.masks.conftest import quiet

CENTRES = [[x, y, -3.0] for x in (-0.5, 0, 0.5) for y in (0, 0.4)]


def nowhere(index: int) -> np.ndarray:
    return np.zeros((4, 6), bool)


def go_on() -> None:
    pass


@pytest.fixture
def half(tmp_path: Path) -> Scene:
    """A wall whose right half (x > 0) structure from motion found nothing on."""
    scene, _ = make_wall(tmp_path, CENTRES)
    return keep_points(scene, scene.points[:, 0] < 0)


def test_bare_half_of_a_wall_gets_points_on_the_wall(half: Scene) -> None:
    full = densify_points(half, {}, nowhere, 1, go_on)
    count = len(half.points)
    new = full.points[count:]
    assert len(new) > 50
    assert np.abs(new[:, 2]).max() < 0.06  # 2 % of the distance
    assert (new[:, 0] > 0).mean() > 0.75  # where none were; the edges of the photos are bare, too
    assert np.array_equal(full.points[:count], half.points)
    assert np.array_equal(full.track_uv[: len(half.track_uv)], half.track_uv)
    assert len(full.colors) == len(full.errors) == len(full.points) == len(full.track_start) - 1


def test_tracks_go_through_photos_that_show_the_point(half: Scene) -> None:
    full = densify_points(half, {}, nowhere, 2, go_on)
    count = len(half.points)
    assert np.diff(full.track_start)[count:].min() >= DensifyOptions().confirmed
    for row in range(len(half.track_view), len(full.track_view)):
        view = full.views[full.track_view[row]]
        uv = view.project(full.points[full.track_point[row]][None])[0][0]
        assert np.abs(uv - full.track_uv[row]).max() < 0.1
        assert (full.track_uv[row] >= 0).all() and (full.track_uv[row] < (view.width, view.height)).all()


def test_no_points_among_leaves(half: Scene) -> None:
    everywhere = densify_points(half, {}, lambda i: np.ones((100, 100), bool), 1, go_on)
    assert len(everywhere.points) == len(half.points)


def test_photos_that_do_not_match_give_no_points(tmp_path: Path) -> None:
    scene, _ = make_wall(tmp_path, [[0, 0, -3.0], [0.01, 0, -3.0]])
    assert densify_points(scene, {}, nowhere, 1, go_on) is scene


def test_it_can_be_cancelled(half: Scene) -> None:
    def stop() -> None:
        raise Cancelled

    with pytest.raises(Cancelled):
        densify_points(half, {}, nowhere, 1, stop)


def test_a_clicked_roof_without_points_is_in_the_masks(
    scene: Scene, house: House, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    height = scene.to_normalised.invert(scene.points)[:, 2] - OFFSET[2]
    bald = keep_points(scene, height < 0.6 * height.max())

    def mean_iou() -> float:
        config = make_config({"segmenter": "random_walker", "device": "cpu"})
        masks = propagate(bald, read_prompts(house.prompts, bald), RandomWalker(), config, quiet()).masks
        pairs = [(building(m), house.masks[v.name]) for m, v in zip(masks.labels, bald.views, strict=True)]
        return float(np.mean([(a & b).sum() / (a | b).sum() for a, b in pairs]))

    # Points of its own put it there, and so do clicks that are placed beyond the others; one of the two is enough.
    with monkeypatch.context() as patch:
        patch.setattr("mgf_engine.masks.propagation.propagate.densify_points", lambda scene, *rest: scene)
        assert mean_iou() > 0.97
    monkeypatch.setattr(GeometricOdds, "_clicks_beyond", lambda *_: np.zeros((0, 3)))
    assert mean_iou() > 0.97
    monkeypatch.setattr("mgf_engine.masks.propagation.propagate.densify_points", lambda scene, *rest: scene)
    assert mean_iou() < 0.93
