# SPDX-License-Identifier: GPL-3.0-or-later
"""The margin of background that is trained along with the building, and what it is kept out of."""

from __future__ import annotations

import numpy as np
import pytest

from mgf_engine.field.targets import Target, TargetOptions, make_target, margin_around
from mgf_engine.model.masks import BACKGROUND, BUILDING, IGNORE, building
from mgf_engine.model.scene import View


def labels() -> np.ndarray:
    result = np.full((40, 60), BACKGROUND, np.uint8)
    result[10:30, 20:40] = BUILDING
    result[12:15, 22:25] = 254
    result[10:30, 40:50] = IGNORE
    return result


def target(
    labels: np.ndarray,
    photo: np.ndarray | None = None,
    margin: float = 0.05,
    masked: bool = True,
    background_lambda: float = 0.02,
) -> Target:
    """What a photo with these labels is compared with; the box begins at the frame's corner."""
    height, width = labels.shape
    view = View(
        name="a", file="a.jpg", width=width, height=height, fx=50.0, fy=50.0, cx=width / 2, cy=height / 2,
        rotation=np.eye(3), translation=np.zeros(3), original_width=width, original_height=height,
    )  # fmt: skip
    if photo is None:
        photo = np.full((height, width, 3), 128, np.uint8)
    options = TargetOptions(margin=margin, masked_images=masked, background_lambda=background_lambda)
    made = make_target(photo, labels, view, 1, options)
    assert made is not None and made.box[0] == made.box[2] == 0
    return made


def whole(made: Target, labels: np.ndarray) -> np.ndarray:
    return labels[: made.box[1], : made.box[3]]


def test_the_rim_lies_around_the_building() -> None:
    margin = margin_around(labels(), 3.0)
    assert margin[10:30, 17:20].all() and not margin[10:30, :17].any()
    assert (labels()[margin] == BACKGROUND).all()  # what hides the building stays unknown


def test_no_highlighted_pixel_lies_on_background() -> None:
    """Eq. 12 is of the masks, which end at the building; outside of them it is 1 where a margin is trained."""
    made = target(labels())
    own = building(whole(made, labels()))
    margin = (made.labels.numpy() > made.elements) & ~own
    weight = made.pixels().edge_weight.numpy()
    assert margin.sum() > 50 and (weight[margin] == 1).all()
    assert np.count_nonzero((weight > 1) & ~own) == 0
    assert np.count_nonzero(made.edges.numpy() & ~own) == 0
    outline = own.copy()
    outline[11:29, 21:39] = False  # the outermost pixels of the building, and its element's own boundary
    assert (weight[outline] == 10).all() and (weight[12:15, 22] == 10).all()


def test_weights_follow_equation_12() -> None:
    """Ten on both sides of a boundary of the building, also before what hides it; one inside, nothing outside."""
    rows = np.tile(np.array([[BACKGROUND, 1, 1, 1, 2, IGNORE]], np.uint8), (4, 1))
    assert (target(rows, margin=0.0).pixels().edge_weight.numpy() == [0, 10, 1, 10, 10, 0]).all()


@pytest.mark.parametrize("margin", [0.0, 0.05])
def test_the_masks_of_equation_19_are_the_building_and_its_elements(margin) -> None:
    made = target(labels(), margin=margin)
    margin = 1 if margin else 0
    assert (made.elements, made.count) == (2, 2 + margin)
    share = made.label_weight.numpy()
    assert share[1] == 0 and (share[3:] == 0).all()  # the rest of the building is no mask, and neither is the margin
    # A photo of one colour has one delta, so areas alone weigh: 400 px of the building, 9 of its element.
    np.testing.assert_allclose(share[[0, 2]], np.array([400, 9]) / 409, rtol=1e-6)


def test_delta_is_of_the_masks_alone() -> None:
    """A plain building before a patterned background weighs as it does without a margin."""
    photo = np.full((40, 60, 3), 128, np.uint8)
    photo[:, ::2] = 255
    photo[10:30, 20:40] = 128
    photo[12:15, 22:25] = np.arange(9).reshape(3, 3, 1) * 20
    with_rim, without = (target(labels(), photo, margin).label_weight.numpy() for margin in (0.05, 0.0))
    assert np.array_equal(with_rim[:3], without[:3])
    assert without[2] / without[0] < 9 / 400  # the element is patterned, so it weighs less than its area


def test_an_element_over_the_whole_building_leaves_no_rest() -> None:
    full = labels()
    full[full == BUILDING] = 7
    made = target(full)
    assert made.elements == 3 and not (made.labels == 1).any()
    assert made.label_weight.sum() == pytest.approx(1.0) and made.label_weight[0] == pytest.approx(0.5)


def test_bars_and_gaps_have_no_rim() -> None:
    """Between the bars of a frame everything would be margin, and be trained on what is behind."""
    frame = np.full((120, 200), BACKGROUND, np.uint8)
    frame[20:100, 20:80] = BUILDING
    frame[40:50, 40:50] = BACKGROUND  # a gap in a wall
    frame[20:100, 120:124] = frame[20:100, 150:154] = frame[60:64, 120:154] = BUILDING
    margin = margin_around(frame, 3.0)
    assert margin[30:90, 80:83].all()  # beside the wall
    assert not margin[40:50, 40:50].any() and not margin[:, 110:].any()


@pytest.mark.parametrize("width", [0.0, 0.5])
def test_no_width_no_rim(width) -> None:
    assert not margin_around(labels(), width).any()


def test_whole_photos_are_trained_beside_the_same_masks() -> None:
    """Ablation (a): every pixel is compared, and what is no building is none of the masks and has no boundary."""
    masked, whole_photo = target(labels()), target(labels(), masked=False)
    pixels = whole_photo.pixels()
    assert whole_photo.box == (0, 40, 0, 60) and (pixels.inside == 1).all() and whole_photo.tile_mask.all()
    assert not pixels.background_band.any()  # nothing is background that is to be kept empty
    assert (pixels.edge_weight.numpy()[~building(labels())] == 1).all()
    assert np.array_equal(whole_photo.edges.numpy(), whole(whole_photo, masked.edges.numpy()))
    assert np.array_equal(whole_photo.label_weight.numpy(), masked.label_weight.numpy())


def test_without_a_background_loss_no_rays_are_cast_beside_the_masks() -> None:
    """Eq. 14: what lies outside of the masks is left out; tiles that hold a pixel of the building are rendered."""
    with_loss, without = (target(labels(), margin=0.0, background_lambda=value) for value in (0.02, 0.0))
    rendered = np.kron(without.tile_mask.numpy(), np.ones((16, 16), bool))[:40, :60]
    assert with_loss.background_band.any() and not without.background_band.any()
    assert with_loss.tile_mask.all() and rendered[building(labels())].all()
    assert np.array_equal(without.tile_mask.numpy(), [[0, 1, 1, 0]] * 2 + [[0, 0, 0, 0]])
    # The comparison is the same, also where windows of eq. 18 reach over the outline.
    assert without.box == with_loss.box and np.array_equal(without.edges.numpy(), with_loss.edges.numpy())
    assert np.array_equal(without.label_weight.numpy(), with_loss.label_weight.numpy())


def test_every_id_taken() -> None:
    full = labels()
    full[10, 20:40] = BUILDING
    full[15:28, 20:40] = (np.arange(13 * 20) % 253 + 2).reshape(13, 20)
    full[full == BUILDING] = 2
    full[10, 20] = BUILDING
    made = target(full, margin=2 / 60)
    assert (made.elements, made.count) == (254, 255)
    assert (made.labels.numpy()[8:10, 25:35] == 255).all()
