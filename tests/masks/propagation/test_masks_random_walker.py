# SPDX-License-Identifier: GPL-3.0-or-later
"""When clicks let the ground be background."""

import numpy as np
import pytest

from benchmarks.synthetic.house import OFFSET
from mgf_engine.masks.geometry.point_features import measure_point_features
from mgf_engine.masks.prompts import Clicks
from mgf_engine.masks.propagation.label_graph import LabelGraph
from mgf_engine.masks.propagation.random_walker import LabelPropagation
from mgf_engine.masks.propagation.superpixels import cut_regions
from mgf_engine.model.scene import Scene

VIEW = 3


@pytest.fixture(scope="module")
def walker(scene: Scene) -> LabelPropagation:
    regions = [cut_regions(scene.photo(i)) for i in range(len(scene.views))]
    return LabelPropagation(LabelGraph(scene, regions, measure_point_features(scene)))


@pytest.mark.parametrize(
    "positive, negative, rejected",
    [("wall", "sky", True), ("wall", "", True), ("wall", "lawn", True), ("lawn", "", False), ("lawn", "lawn", False)],
)
def test_the_ground_is_background_unless_clicked_otherwise(
    walker: LabelPropagation, scene: Scene, positive: str, negative: str, rejected: bool
):
    height = scene.to_normalised.invert(scene.points)[:, 2] - OFFSET[2]
    grounded = (height < 0.01).astype(float)
    here = scene.track_view == VIEW
    of = height[walker.geometry.visibility.owner[here]]
    uv = scene.track_uv[here]
    spots = {"wall": uv[of.argmax()], "lawn": uv[np.flatnonzero(of < 0.01)[0]], "sky": np.array([3.0, 3.0])}

    def clicks(where: str) -> np.ndarray:
        return np.array([spots[where]]) if where else np.zeros((0, 2))

    prompts = {VIEW: Clicks(clicks(positive), clicks(negative))}
    assert walker.geometry._clicks_reject(grounded, prompts) is rejected


def test_sky_without_a_click_is_background(walker: LabelPropagation, scene: Scene):
    """Only the wall was clicked, in one photo."""
    height = scene.to_normalised.invert(scene.points)[:, 2]
    here = scene.track_view == VIEW
    wall = scene.track_uv[here][height[walker.geometry.visibility.owner[here]].argmax()]
    prompts = {VIEW: Clicks(wall[None], np.zeros((0, 2)))}
    found = walker.solve(prompts, rounds=1)
    sky = walker.graph.unclicked_sky(prompts)[: walker.graph.region_count]
    assert sky.sum() > 100
    assert np.concatenate(found.regions)[sky].mean() < 0.05
