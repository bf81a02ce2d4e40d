# SPDX-License-Identifier: GPL-3.0-or-later
"""A photo should observe what a camera beside it observed from the same side."""

from __future__ import annotations

import numpy as np
import pytest
from support.small_scene import make_scene, view

from mgf_engine.masks.geometry.point_features import PointFeatures
from mgf_engine.masks.geometry.point_visibility import PointVisibility, PointVisibilityOptions

#: Three points on a wall that faces the cameras, the last of them seen by the first camera alone.
POINTS = np.array([[0.0, 0, 5], [0.1, 0, 5], [0.2, 0, 5]])
TRACKS = [[(0, 10, 5), (1, 10, 5)], [(0, 10, 5), (1, 10, 5)], [(0, 10, 5)]]


def visibility(
    places: tuple[float, float] = (0.0, 0.4), normal: tuple[float, ...] = (0, 0, -1), sparse: int | None = None,
    options: PointVisibilityOptions = PointVisibilityOptions(),
) -> PointVisibility:  # fmt: skip
    scene = make_scene([view(str(k), x) for k, x in enumerate(places)], POINTS, TRACKS)
    zero = np.zeros(3)
    features = PointFeatures(
        np.array([0.0, -1, 0]), zero + 1, np.tile(normal, (3, 1)).astype(float), zero, zero, np.zeros((0, 2), np.int64),
        np.zeros(0), np.zeros(3, bool),
    )  # fmt: skip
    return PointVisibility(scene, features, sparse, options)


def test_what_a_photo_observed_is_what_its_tracks_say() -> None:
    assert visibility().observed(0).tolist() == [True, True, True]
    assert visibility().observed(1).tolist() == [True, True, False]


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({}, True),
        ({"places": (0.0, 4.0)}, False),  # seen from another side
        ({"normal": (1, 0, 0)}, False),  # seen edge on
        ({"sparse": 2}, False),  # no photo is expected to have a track of an added point
        ({"places": (0.0, 4.0), "options": PointVisibilityOptions(same_side=0.5)}, True),
        ({"normal": (1, 0, 0), "options": PointVisibilityOptions(steep=0.0)}, True),
    ],
)
def test_a_point_is_expected_from_the_same_side_and_face_on(given: dict, expected: bool) -> None:
    assert visibility(**given).expected(1).tolist() == ([0, 1, 2] if expected else [0, 1])
