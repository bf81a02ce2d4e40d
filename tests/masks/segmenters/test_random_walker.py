# SPDX-License-Identifier: GPL-3.0-or-later
import cv2
import numpy as np
from support.segmenters import hints

from mgf_engine.masks.segmenters.base import agreement
from mgf_engine.masks.segmenters.random_walker import RandomWalker, clean, follow_points, to_edges

SHAPE = (160, 240)


def square() -> np.ndarray:
    mask = np.zeros(SHAPE, bool)
    mask[40:120, 60:180] = True
    return mask


def photo() -> np.ndarray:
    image = np.full((*SHAPE, 3), (90, 140, 200), np.uint8)
    image[square()] = (180, 90, 70)
    return image


def lab() -> np.ndarray:
    return cv2.cvtColor(photo(), cv2.COLOR_RGB2LAB)


def test_a_blurred_probability_snaps_to_the_edges():
    shifted = np.roll(square(), (2, 3), (0, 1)).astype(np.float32)
    probability = cv2.GaussianBlur(shifted, (0, 0), 3.0)
    before = (probability > 0.5) ^ square()
    after = (to_edges(lab(), probability) > 0.5) ^ square()
    assert after.sum() < 0.35 * before.sum()


def test_holes_are_filled_unless_points_say_otherwise():
    mask = square()
    mask[60:68, 80:88] = mask[60:68, 120:128] = False
    pole = np.array([[124.0, 64.0]] * 3)
    result = clean(mask, hints(SHAPE, rejected=pole))
    assert result[64, 84] and not result[64, 124]
    clicked = clean(mask, hints(SHAPE, negative=np.array([[84.0, 64.0]])))
    assert not clicked[64, 84] and clicked[64, 124]


def test_specks_are_dropped_unless_points_say_otherwise():
    mask = square()
    mask[5:11, 5:11] = mask[5:11, 200:206] = True
    result = clean(mask, hints(SHAPE, accepted=np.array([[203.0, 8.0]] * 3)))
    assert not result[8, 8] and result[8, 203] and result[80, 120]


def test_a_second_attempt_follows_the_points():
    probability = np.zeros(SHAPE, np.float32)
    ys, xs = np.mgrid[42:118:4, 62:178:4]
    accepted = np.stack([xs.ravel(), ys.ravel()], 1).astype(float)
    given = hints(SHAPE, accepted=accepted, probability=probability)
    assert follow_points(lab(), given).shape == SHAPE
    first, second = RandomWalker().segment(photo(), given), RandomWalker().segment(photo(), given, attempt=1)
    assert first.score == 0 and second.score > 0.9
    assert (second.mask & square()).sum() / (second.mask | square()).sum() > 0.8


def test_in_a_second_attempt_the_labels_of_points_stop_at_edges():
    ys, xs = np.mgrid[42:118:3, 62:178:3]  # up to the roof, and no point in the sky contradicts
    accepted = np.stack([xs.ravel(), ys.ravel()], 1).astype(float)
    given = hints(SHAPE, accepted=accepted, probability=0.3 * square().astype(np.float32))
    second = RandomWalker().segment(photo(), given, attempt=1).mask
    assert (second & ~square()).sum() < 0.02 * square().sum()
    assert (second & square()).sum() > 0.95 * square().sum()


def test_agreement():
    inside, outside = np.array([[100.0, 80.0]]), np.array([[10.0, 10.0]])
    good = hints(SHAPE, accepted=inside.repeat(20, 0), rejected=outside.repeat(20, 0))
    assert agreement(square(), good) == 1.0
    assert agreement(~square(), good) == 0.0
    leaking = hints(SHAPE, accepted=inside.repeat(20, 0), rejected=inside.repeat(20, 0))
    assert agreement(square(), leaking) == 1 - 20 / 30  # ten imagined points keep few rejected ones from ruling
    assert agreement(square(), hints(SHAPE)) == 0.0
