# SPDX-License-Identifier: GPL-3.0-or-later
"""Masks that no sparse point tests are tested by the other photos' masks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.synthetic.plain_house import PlainHouse, make_plain_house
from mgf_engine.masks.geometry.visual_hull import hull_agreement, with_hull_points
from mgf_engine.masks.validation.mask_flags import flag_by_masks
from mgf_engine.model.masks import MaskSet
from mgf_engine.model.scene import Scene


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> PlainHouse:
    return make_plain_house(tmp_path_factory.mktemp("plain") / "scene")


def test_true_masks_agree_with_the_hull_of_the_others_and_wrong_ones_do_not(plain: PlainHouse) -> None:
    labels = [label.copy() for label in plain.masks.labels]
    labels[3] = np.zeros_like(labels[3])
    labels[3][:60, :60] = 1  # sky
    masks = replace(plain.masks, labels=tuple(labels))
    others = [i for i in range(16) if i != 3]
    assert hull_agreement(plain.scene, masks, others[1:], 0) > 0.75
    assert hull_agreement(plain.scene, masks, others, 3) < 0.1
    assert hull_agreement(plain.scene, masks, [], 0) is None


def test_without_points_only_a_contradiction_leaves_a_mask_out(plain: PlainHouse) -> None:
    labels = [label.copy() for label in plain.masks.labels]
    labels[3] = np.zeros_like(labels[3])
    labels[3][:60, :60] = 1
    weak = "mask and points agree only to 0%"
    reasons = ["", weak, weak, ""] + [""] * 12
    tested = np.ones(16, bool)
    tested[[1, 3]] = False  # points test the third photo's mask
    used = np.array([not r for r in reasons])
    found = flag_by_masks(plain.scene, replace(plain.masks, labels=tuple(labels), used=used), reasons, tested)
    assert found[1] == "" and found[2] == weak
    assert found[3].startswith("the other photos' masks agree with it only to")
    assert not any(found[4:])


def with_points(plain: PlainHouse, together: int) -> tuple[Scene, MaskSet]:
    """The house with 160 sparse points on it; as many neighbouring photos see each."""
    count, views = 160, len(plain.scene.views)
    rng = np.random.default_rng(0)
    points = rng.uniform([-2, -1.5, 0], [2, 1.5, 2], (count, 3))
    view = (np.arange(count)[:, None] + np.arange(together)) % views
    uv = np.array(
        [plain.scene.views[v].project(p[None])[0][0] for p, row in zip(points, view, strict=True) for v in row]
    )
    scene = replace(
        plain.scene, points=points, colors=np.zeros((count, 3), np.uint8), errors=np.zeros(count, np.float32),
        track_start=np.arange(count + 1) * together, track_view=view.ravel().astype(np.int32),
        track_uv=uv.astype(np.float32),
    )  # fmt: skip
    return scene, replace(plain.masks, point_mask=np.ones(count, bool))


def test_the_hull_stands_in_for_many_points_that_hardly_two_photos_share(plain: PlainHouse) -> None:
    scene, masks = with_points(plain, together=2)  # ten for each pair of neighbours
    hull = with_hull_points(scene, masks, range(16))
    assert len(hull.scene.points) == len(hull.kept) != 160 and hull.kept.all()
    scene, masks = with_points(plain, together=6)  # fifty
    assert with_hull_points(scene, masks, range(16)).scene is scene
