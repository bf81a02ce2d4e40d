# SPDX-License-Identifier: GPL-3.0-or-later

import numpy as np
import pytest
from support.small_scene import make_scene, view

from mgf_engine.masks.points import VoteOptions, Votes, choose_voters, decide, project_votes, track_votes, vote
from mgf_engine.model.masks import BUILDING, IGNORE, MaskSet
from mgf_engine.model.scene import Scene

OPTIONS = VoteOptions(dilation=0)


@pytest.fixture
def pair() -> Scene:
    points = np.array([[0, 0, 1.0], [0.55, 0, 1.0], [0, 0, -1.0], [5, 0, 1.0]])
    tracks = [[(0, 10, 5), (1, 10, 5)], [(1, 2.5, 5.5)], [], []]
    return make_scene([view("a", 0), view("b", 0)], points, tracks)


def left_half() -> np.ndarray:
    labels = np.zeros((10, 20), np.uint8)
    labels[:, :11] = BUILDING
    return labels


def test_projection_counts_only_points_in_front_and_in_frame(pair: Scene):
    votes = project_votes(pair.points, pair, [left_half(), left_half()], [0, 1], 0)
    assert votes.inside.tolist() == [2, 0, 0, 0]
    assert votes.outside.tolist() == [0, 2, 0, 0]


def test_track_votes_use_the_observed_keypoint(pair: Scene):
    # Point 1 projects outside the mask, but was observed inside it.
    votes = track_votes(pair, [left_half(), left_half()], [0, 1], 0)
    assert votes.inside.tolist() == [2, 1, 0, 0]
    kept = vote(pair.points, pair, [left_half(), left_half()], [0, 1], OPTIONS, np.arange(4))
    assert kept.tolist() == [True, True, False, False]
    assert vote(pair.points, pair, [left_half(), left_half()], [0, 1], OPTIONS).tolist() == [True, False, False, False]


def test_a_track_whose_photos_disagree_is_not_asked_again_by_projection(pair: Scene):
    """One photo observed the point inside the mask and one outside; its projection lies inside in both."""
    tied = make_scene(list(pair.views), pair.points[:1], [[(0, 10, 5), (1, 15, 5)]])
    masks = [left_half(), left_half()]
    assert vote(tied.points, tied, masks, [0, 1], OPTIONS).tolist() == [True]
    assert vote(tied.points, tied, masks, [0, 1], OPTIONS, np.arange(1)).tolist() == [False]


def test_unknown_pixels_abstain(pair: Scene):
    hidden = np.full((10, 20), IGNORE, np.uint8)
    votes = project_votes(pair.points[:1], pair, [left_half(), hidden], [0, 1], 0)
    assert (votes.inside[0], votes.outside[0]) == (1, 0)


def test_dilation_reaches_exactly_so_far(pair: Scene):
    # Point 1 falls on column 15; the mask ends with column 10.
    for dilation, hits in ((4, 0), (5, 1)):
        assert project_votes(pair.points[1:2], pair, [left_half()], [0], dilation).inside[0] == hits


def test_votes_are_the_same_on_every_number_of_threads():
    random = np.random.default_rng(0)
    views = [view(str(i), x) for i, x in enumerate(random.normal(size=7))]
    scene = make_scene(views, random.normal(size=(900, 3)), [[] for _ in range(900)])
    labels = [random.choice([0, BUILDING, IGNORE], (10, 20)).astype(np.uint8) for _ in views]
    one, many = (project_votes(scene.points, scene, labels, range(7), 1, threads) for threads in (1, 3))
    assert one.inside.max() > 1 and one.outside.max() > 1
    assert (one.inside == many.inside).all() and (one.outside == many.outside).all()


def test_a_photo_votes_as_often_as_a_track_holds_it(pair: Scene):
    twice = make_scene(list(pair.views), pair.points[:1], [[(0, 10, 5), (0, 10, 5), (1, 10, 5)]])
    assert track_votes(twice, [left_half(), left_half()], [0, 1], 0).inside.tolist() == [3]


def test_strict_asks_every_view(pair: Scene):
    strict = VoteOptions(dilation=0, strict=True)
    full, half = np.ones((10, 20), np.uint8), left_half()
    assert vote(pair.points, pair, [full, half], [0, 1], strict).tolist() == [True, False, False, False]
    # Point 3 is outside both frames: the literal rule drops it, as it drops nearly all points of a real scene.
    assert not vote(pair.points[3:], pair, [full, full], [0, 1], strict)[0]


@pytest.mark.parametrize(
    ("inside", "outside", "kept"),
    [(0, 0, False), (1, 0, True), (1, 1, False), (2, 1, True), (8, 4, True), (8, 5, False), (90, 10, True), (90, 11, False)],  # noqa: E501
)  # fmt: skip
def test_tolerance(inside: int, outside: int, kept: bool):
    votes = Votes(np.array([inside], np.int32), np.array([outside], np.int32))
    assert decide(votes, VoteOptions(), 9)[0] == kept


def test_few_votes_against_are_an_option() -> None:
    votes = Votes(np.array([8], np.int32), np.array([4], np.int32))
    assert decide(votes, VoteOptions(few=4), 12)[0] and not decide(votes, VoteOptions(few=3), 12)[0]


def test_accepts_a_mask_set(pair: Scene):
    labels = (left_half(), left_half())
    masks = MaskSet(labels, np.ones(2, bool), np.ones(2, np.float32), np.ones(4, bool))
    assert vote(pair.points, pair, masks, [0, 1], OPTIONS).tolist() == [True, False, False, False]


def test_no_points_no_views(pair: Scene):
    assert vote(np.zeros((0, 3)), pair, [left_half()] * 2, [0, 1], OPTIONS).shape == (0,)
    assert not vote(pair.points, pair, [left_half()] * 2, [], OPTIONS).any()


def test_the_clicked_photos_are_the_root_images_whichever_were_suggested(pair: Scene):
    # Photo 0 was suggested, photo 1 was clicked: its mask is the root mask of eq. 3 and 22.
    assert pair.roots == (0,)
    roots = VoteOptions(dilation=0, voters="roots", tolerance=0.0, few=0)
    clicks = (np.zeros((0, 2), np.float32), np.array([[10, 5]], np.float32))
    masks = MaskSet(
        (left_half(), np.ones((10, 20), np.uint8)), np.ones(2, bool), np.ones(2, np.float32), np.ones(4, bool), clicks
    )
    assert masks.clicked == [1]
    voters = choose_voters(pair, [0, 1], masks.clicked, roots)
    assert voters == [1]
    assert vote(pair.points, pair, masks, voters, roots).tolist() == [True, True, False, False]
    assert choose_voters(pair, [0, 1], [], roots) == [0]  # masks of another origin
    assert choose_voters(pair, [0], masks.clicked, roots) == [0]  # no root may vote
    assert choose_voters(pair, [0, 1], masks.clicked, VoteOptions()) == [0, 1]
