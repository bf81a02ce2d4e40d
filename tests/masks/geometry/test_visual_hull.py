# SPDX-License-Identifier: GPL-3.0-or-later
"""Masks that no sparse point tests are tested by the other photos' masks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.synthetic.plain_house import PlainHouse, make_plain_house
from mgf_engine.masks.geometry.hull_agreement import hull_agreement
from mgf_engine.masks.geometry.visual_hull import MaskHullOptions, hull_cells, with_hull_points
from mgf_engine.masks.validation.mask_flags import flag_by_masks
from mgf_engine.model.masks import MaskSet
from mgf_engine.model.scene import Scene, Similarity, View

PROJECT = View.project


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> PlainHouse:
    return make_plain_house(tmp_path_factory.mktemp("plain") / "scene")


def with_wrong_mask(plain: PlainHouse) -> MaskSet:
    """The true masks, but for the fourth, which is of the sky."""
    labels = [label.copy() for label in plain.masks.labels]
    labels[3] = np.zeros_like(labels[3])
    labels[3][:60, :60] = 1
    return replace(plain.masks, labels=tuple(labels))


def test_true_masks_agree_with_the_hull_of_the_others_and_wrong_ones_do_not(plain: PlainHouse) -> None:
    masks = with_wrong_mask(plain)
    right, wrong = hull_agreement(plain.scene, masks, range(16), [0, 3])
    assert right is not None and wrong is not None and right > 0.75 and wrong < 0.1
    unused = hull_agreement(plain.scene, masks, [i for i in range(16) if i != 3], [3])
    assert unused[0] is not None and unused[0] < 0.1
    assert hull_agreement(plain.scene, masks, [], [0, 3]) == [None, None]
    assert hull_agreement(plain.scene, masks, [0, 1], [0]) == [None]  # one mask has no hull


@pytest.mark.parametrize("views", [range(0, 16, 4), range(16)])
def test_masks_agree_as_with_a_hull_carved_without_them(plain: PlainHouse, views: range) -> None:
    found = hull_agreement(plain.scene, plain.masks, views, views)
    for index, share in zip(views, found, strict=True):
        alone = hull_agreement(plain.scene, plain.masks, [i for i in views if i != index], [index])[0]
        assert share == pytest.approx(alone, abs=0.06)  # the cells of the two grids differ


def test_the_hull_is_carved_once_for_all_masks(plain: PlainHouse, monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []
    monkeypatch.setattr(View, "project", lambda view, points: calls.append(view) or PROJECT(view, points))
    hull_agreement(plain.scene, plain.masks, range(16), range(16))
    rounds = MaskHullOptions().rounds
    assert len(calls) == 16 * (rounds + 2)  # its own votes, and the hull in its frame


def test_without_points_only_a_contradiction_leaves_a_mask_out(plain: PlainHouse) -> None:
    masks = with_wrong_mask(plain)
    weak = "mask and points agree only to 0%"
    reasons = ["", weak, weak, ""] + [""] * 12
    tested = np.ones(16, bool)
    tested[[1, 3]] = False  # points test the third photo's mask
    used = np.array([not r for r in reasons])
    found = flag_by_masks(plain.scene, replace(masks, used=used), reasons, tested)
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


def make_monument(photos: int = 40) -> tuple[Scene, MaskSet]:
    """A block of 1 m on a square, photographed all around by a long lens, with sparse points on the houses 60 m off."""
    corners = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3), -1).reshape(-1, 3)
    views, labels = [], []
    for k in range(photos):
        angle = 2 * np.pi * k / photos
        outward = np.array([np.cos(angle), np.sin(angle), 0.0])
        rotation = np.stack([np.cross(outward, [0, 0, -1]), [0, 0, -1], -outward])
        views.append(
            View(
                f"{k}.png", f"{k}.png", 80, 120, 180.0, 180.0, 40.0, 60.0, rotation, np.array([0.0, 0.0, 4.0]), 80, 120
            )
        )
        label = np.zeros((120, 80), np.uint8)
        outline = cv2.convexHull(views[-1].project(corners)[0].round().astype(np.int32))
        labels.append(cv2.fillConvexPoly(label, outline, 1))
    rng = np.random.default_rng(0)
    direction = rng.uniform(0, 2 * np.pi, 150)
    houses = 60 * np.c_[np.cos(direction), np.sin(direction), 0.2 * rng.uniform(0, 1, 150)]
    points = np.concatenate([rng.uniform(-0.5, 0.5, (150, 3)), houses])
    count = len(points)
    scene = Scene(
        tuple(views), points, np.zeros((count, 3), np.uint8), np.zeros(count, np.float32),
        np.zeros(count + 1, np.int64), np.zeros(0, np.int32), np.zeros((0, 2), np.float32),
        Similarity(1.0, np.eye(3), np.zeros(3)), (0,), (), Path(),
    )  # fmt: skip
    return scene, MaskSet(tuple(labels), np.ones(photos, bool), np.ones(photos, np.float32), np.arange(count) < 150)


def test_the_hull_does_not_reach_to_what_lies_far_behind_the_building() -> None:
    scene, masks = make_monument()
    cells, size = hull_cells(scene, masks, range(len(scene.views)))
    assert np.abs(cells).max() < 2.0
    assert size < 0.1
    inside = (np.abs(cells) < 0.5).all(1).sum() * size**3
    assert inside == pytest.approx(1, rel=0.1)  # the whole block is in it
