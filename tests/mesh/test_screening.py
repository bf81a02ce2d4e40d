# SPDX-License-Identifier: GPL-3.0-or-later
from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from support.analytic import ball, discs, joined, ring, scene_of, sphere
from support.mesh_stage import mesh_options

from mgf_engine.errors import BadInput
from mgf_engine.masks.points import count_votes, votes_of_views
from mgf_engine.mesh.screening import screen, vetoes, voting_views
from mgf_engine.model.scene import View

PRINTED = {"vote_tolerance": 0.0, "votes.few": 0}  # eq. 22 without tolerance, which names photos


def test_voting_views_leave_out_what_is_held_out_or_unused():
    scene, masks = scene_of(ring(6), ball())
    held = replace(scene, held_out=(1, 3))
    used = replace(masks, used=np.array([True, True, False, True, True, True]))
    assert voting_views(held, used) == [0, 4, 5]
    assert voting_views(replace(scene, held_out=tuple(range(6))), masks) == list(range(6))


def test_root_masks_of_the_screening_are_those_that_were_clicked():
    """A photo that was suggested and never clicked has no root mask, so what a tree hides in it stays."""
    scene, masks = scene_of(ring(8), ball())
    suggested = replace(scene, roots=(0,))
    hidden = replace(masks, labels=(np.zeros_like(masks.labels[0]), *masks.labels[1:]))
    clicked = replace(hidden, clicks=tuple(np.full((int(i in (2, 5)), 2), 9, np.float32) for i in range(8)))
    options = mesh_options({"voters": "roots", "vote_tolerance": 0.0, "votes.few": 0}).screening
    field = sphere(100)
    assert len(screen(field, suggested, clicked, options)) == 100
    with pytest.raises(BadInput, match="vote against every Gaussian"):
        screen(field, suggested, hidden, options)


def test_a_photo_whose_mask_alone_removes_much_is_named():
    """A tree before one root photo takes half of the building away by eq. 22; bushes take little."""
    scene, masks = scene_of(ring(8), ball())
    options = mesh_options({"vote_tolerance": 0.0, "votes.few": 0}).screening

    def said(covered: float) -> list[str]:
        tree = masks.labels[3].copy()
        tree[:, : int(covered * tree.shape[1])] = 0
        labels = (*masks.labels[:3], tree, *masks.labels[4:])
        texts: list[str] = []
        assert len(screen(sphere(400), scene, replace(masks, labels=labels), options, texts.append)) < 400
        return texts

    (text,) = said(0.5)
    assert f"'{scene.views[3].name}' alone removes 49%" in text and "255" in text
    assert said(0.28) == []
    loose: list[str] = []
    screen(sphere(400), scene, masks, mesh_options({}).screening, loose.append)
    assert loose == []


def test_screening_follows_its_switches():
    scene, masks = scene_of(ring(8), ball())
    field = joined(sphere(100), discs([[0.0, 1.9, 0], [1.8, 0, 0.3]], [[0.0, 0, 1]] * 2, 0.1))
    assert len(screen(field, scene, masks, mesh_options({}).screening)) == 100
    assert len(screen(field, scene, masks, mesh_options({"screening": False}).screening)) == 102
    assert len(screen(field, scene, masks, mesh_options({"use_masks": False}).screening)) == 102


@pytest.mark.parametrize("options", [{}, PRINTED])
def test_each_photo_projects_the_gaussians_once(options, monkeypatch):
    scene, masks = scene_of(ring(8), ball())
    calls: Counter[str] = Counter()
    project = View.project_into_frame

    def counted(view, points):
        calls[view.name] += 1
        return project(view, points)

    monkeypatch.setattr(View, "project_into_frame", counted)
    screen(sphere(100), scene, masks, mesh_options(options).screening)
    assert calls == Counter(view.name for view in scene.views)


def test_what_a_photo_removes_alone_is_what_stays_without_it():
    """Counted in one go and by leaving out one photo after another."""
    scene, _ = scene_of(ring(5), ball())
    random = np.random.default_rng(1)
    labels = [(random.random((view.height, view.width)) < 0.8).astype(np.uint8) for view in scene.views]
    centres = sphere(500).positions.double().numpy()
    cast = list(votes_of_views(centres, scene, labels, range(5), 0))

    def left(views: list[int]) -> int:
        votes = count_votes(500, [cast[i] for i in views])
        return int(((votes.inside > 0) & (votes.outside == 0)).sum())

    without = [left([i for i in range(5) if i != view]) for view in range(5)]
    expected = [(w - left(list(range(5)))) / w for w in without]
    assert 0.05 < min(expected) < max(expected) < 0.9
    np.testing.assert_allclose(vetoes(count_votes(500, cast), cast), expected)
