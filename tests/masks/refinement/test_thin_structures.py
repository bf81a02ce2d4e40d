# SPDX-License-Identifier: GPL-3.0-or-later
"""Steelwork against the sky: silhouettes to the pixel, their hull, and which clicks ask for it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mast import HEIGHT, LEGS, TOP, UP, WIDTH, look, make_scene, photograph
from numpy.typing import NDArray

from mgf_engine.masks.geometry.elevation import over_horizon
from mgf_engine.masks.geometry.ground_plane import GroundPlane
from mgf_engine.masks.image_ops import rgb_to_lab
from mgf_engine.masks.prompts import Clicks, Prompts
from mgf_engine.masks.refinement.ground_homography import GroundPixels
from mgf_engine.masks.refinement.silhouette_hull import SilhouetteHull, carve_silhouette_hull
from mgf_engine.masks.refinement.sky_silhouette import SilhouetteOptions, SkySilhouette, find_silhouette
from mgf_engine.masks.refinement.thin_structures import SceneContext, ThinStructures, find_thin_structures
from mgf_engine.model.masks import BACKGROUND, BUILDING, IGNORE
from mgf_engine.model.scene import Scene, View

VIEWS = [look(angle, 0.3) for angle in np.linspace(0, 2 * np.pi, 12, endpoint=False)]
#: Two cameras higher than the mast, which see it against the ground alone.
HIGH = [look(0.3, 2.4), look(2.2, 2.4)]
NONE = np.zeros((0, 2))
GROUND = GroundPlane(UP, 0.0, 0.02)


def sky_of(view: View) -> NDArray[np.bool_]:
    """Large regions of sky: nothing between bars and near them."""
    _, hut, mast = photograph(view)
    result = over_horizon(view, UP, SilhouetteOptions.horizon) & ~hut
    ys, xs = np.nonzero(mast)
    result[max(0, ys.min() - 3) : ys.max() + 3, max(0, xs.min() - 3) : xs.max() + 3] = False
    return result


def click_on_mast(view: View, row: int = 0) -> NDArray[np.float64]:
    """On a leg near the top."""
    return view.project(np.array([[*LEGS[row], 0.95 * TOP]]))[0]


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return make_scene(tmp_path_factory.mktemp("mast"), VIEWS + HIGH)


def search(
    scene: Scene, prompts: Prompts, leafy: float = 0.0, ground: GroundPlane | None = None
) -> tuple[ThinStructures | None, list[NDArray[np.uint8]]]:
    labels = [photograph(view)[1].astype(np.uint8) for view in scene.views]

    def leaves(index: int) -> NDArray[np.float32]:
        return np.full((HEIGHT, WIDTH), leafy, np.float32)

    def sky(index: int) -> NDArray[np.bool_]:
        return sky_of(scene.views[index])

    everything = np.ones(len(scene.points), bool)
    return find_thin_structures(SceneContext(scene, everything, UP, ground, sky, leaves), prompts, labels), labels


def draw(found: ThinStructures, scene: Scene, labels: list[NDArray[np.uint8]]) -> None:
    for index, view in enumerate(scene.views):
        found.draw(index, view, labels[index], None)


def test_bars_before_the_sky_are_told_from_it_to_the_pixel() -> None:
    view = VIEWS[1]
    photo, hut, mast = photograph(view)
    found = find_silhouette(rgb_to_lab(photo), sky_of(view), view, UP)
    over = over_horizon(view, UP, SilhouetteOptions.horizon)
    assert (found.solid[over] == (hut | mast)[over]).all()
    assert (found.empty[over] == ~(hut | mast)[over]).all()
    assert not found.solid[~over].any() and not found.empty[~over].any()


def test_a_photo_without_sky_tells_nothing() -> None:
    found = find_silhouette(rgb_to_lab(photograph(VIEWS[0])[0]), np.zeros((HEIGHT, WIDTH), bool), VIEWS[0], UP)
    assert not found.empty.any() and not found.solid.any()


def test_a_mast_clicked_in_two_photos_is_drawn_in_all(scene: Scene) -> None:
    prompts = {1: Clicks(click_on_mast(VIEWS[1]), NONE), 5: Clicks(click_on_mast(VIEWS[5], 2), NONE)}
    found, labels = search(scene, prompts)
    assert found is not None and found.explained == {(1, 0), (5, 0)}
    draw(found, scene, labels)
    for view, shown in zip(VIEWS, labels, strict=False):
        _, hut, mast = photograph(view)
        over, drawn = over_horizon(view, UP, SilhouetteOptions.horizon), shown == BUILDING
        there = mast & over & ~hut
        assert (drawn & there).sum() > 0.9 * there.sum()
        assert not (drawn & over & ~mast & ~hut).any()
    for view, shown in zip(HIGH, labels[len(VIEWS) :], strict=True):
        _, hut, mast = photograph(view)
        top = mast & ~hut & (shown != BACKGROUND)
        assert (shown[top] == IGNORE).all() and top.sum() > 0.4 * mast.sum()
        assert (shown == IGNORE).mean() < 0.25


def test_what_is_below_the_horizon_stands_on_the_ground(scene: Scene) -> None:
    prompts = {1: Clicks(click_on_mast(VIEWS[1]), NONE), 5: Clicks(click_on_mast(VIEWS[5], 2), NONE)}
    found, labels = search(scene, prompts, ground=GROUND)
    assert found is not None
    draw(found, scene, labels)
    for view, shown in zip(VIEWS, labels, strict=False):
        _, hut, mast = photograph(view)
        legs = mast & ~hut & ~over_horizon(view, UP, SilhouetteOptions.horizon)
        assert (shown[legs] != BACKGROUND).sum() >= 0.95 * legs.sum()
        assert (shown != photograph(view)[1]).mean() < 0.25


def test_columns_stand_below_the_lowest_cells_down_to_the_ground_and_no_farther() -> None:
    places = np.array([(0, 0, z) for z in range(4, 8)] + [(3, 0, z) for z in range(6, 8)])
    hull = SilhouetteHull(places, np.array([0.0, 0.0, 0.5]), 0.5)
    standing = {tuple(place) for place in hull.standing(GROUND).places.tolist()}
    below = standing - {tuple(place) for place in places.tolist()}
    assert below == {(0, 0, z) for z in range(-1, 4)}  # the ground is at place -1


def test_ground_that_others_confirm_is_none_of_it_and_what_stands_out_from_it_is(scene: Scene) -> None:
    view, shown = VIEWS[0], np.zeros((HEIGHT, WIDTH), np.uint8)
    hull = SilhouetteHull(np.argwhere(np.ones((12, 12, 12), bool)), np.array([0.5, -0.6, -0.6]), 0.1)
    nothing = np.zeros((HEIGHT, WIDTH), bool)
    rows = hull.cover(view).nonzero()[0]
    top, low = rows.min(), rows.max()

    class LowerHalf:
        """Ground in the lower half of the hull, but for a bar in it; beside the bar a doubtful column."""

        def find_ground_pixels(self, index: int, mask: NDArray[np.bool_]) -> GroundPixels:
            certain, possible = mask.copy(), np.zeros_like(mask)
            certain[: (top + low) // 2] = False
            certain[:, 118:122], possible[:, 118] = False, True
            return GroundPixels(certain & mask, possible & mask)

    ThinStructures(hull, [SkySilhouette(nothing, nothing)], set()).draw(0, view, shown, LowerHalf())  # type: ignore[arg-type]
    covered = hull.cover(view)
    assert (shown[~covered] == BACKGROUND).all()
    assert (shown[low - 5, 119:122] == BUILDING).all() and shown[low - 5, 118] == IGNORE
    assert shown[low - 5, 110] == BACKGROUND
    assert (shown[top + 2][covered[top + 2]] == IGNORE).all()


def test_clicks_in_one_photo_or_on_air_are_slips(scene: Scene) -> None:
    assert search(scene, {1: Clicks(np.concatenate([click_on_mast(VIEWS[1], i) for i in range(3)]), NONE)})[0] is None
    air = {i: Clicks(np.array([[10.0, 10.0]]), NONE) for i in (1, 4, 7)}
    assert search(scene, air)[0] is None


def test_clicks_that_the_masks_explain_ask_for_nothing(scene: Scene) -> None:
    on_hut = {i: Clicks(VIEWS[i].project(np.array([[0.0, 0.0, 0.4]]))[0], NONE) for i in (1, 5)}
    assert search(scene, on_hut)[0] is None


def test_leaves_are_never_steel(scene: Scene) -> None:
    prompts = {1: Clicks(click_on_mast(VIEWS[1]), NONE), 5: Clicks(click_on_mast(VIEWS[5], 2), NONE)}
    assert search(scene, prompts, leafy=1.0)[0] is None


def test_the_hull_holds_the_mast_and_little_else(scene: Scene) -> None:
    prompts = {1: Clicks(click_on_mast(VIEWS[1]), NONE), 5: Clicks(click_on_mast(VIEWS[5], 2), NONE)}
    found, _ = search(scene, prompts)
    assert found is not None
    x, y, z = found.hull.centres.T
    assert z.max() == pytest.approx(TOP, abs=0.1)
    beside = np.hypot(x - 1.05, y) > 0.5
    assert beside[z > 0.7].mean() < 0.1


def test_parts_are_cells_that_touch() -> None:
    places = np.array([(0, 0, 0), (1, 1, 1), (3, 3, 3), (5, 0, 0), (5, 0, 1), (4, 1, 0)])
    parts = SilhouetteHull(places, np.zeros(3), 1.0).parts()
    assert parts[0] == parts[1] and parts[3] == parts[4] == parts[5]
    assert len(set(parts.tolist())) == 3
    assert len(SilhouetteHull(places[:0], np.zeros(3), 1.0).parts()) == 0


def test_far_too_few_points_tell_no_place(scene: Scene, tmp_path: Path) -> None:
    prompts = {1: Clicks(click_on_mast(VIEWS[1]), NONE), 5: Clicks(click_on_mast(VIEWS[5], 2), NONE)}
    labels = [photograph(view)[1].astype(np.uint8) for view in scene.views]
    nothing = np.zeros(len(scene.points), bool)
    leafy = lambda i: np.zeros((1, 1))  # noqa: E731
    known = SceneContext(scene, nothing, UP, None, lambda i: sky_of(scene.views[i]), leafy)
    assert find_thin_structures(known, prompts, labels) is None


@pytest.mark.parametrize(("sky", "kept"), [(0, True), (1, True), (2, False)])
def test_two_photos_that_see_sky_empty_a_cell(sky: int, kept: bool) -> None:
    """Six of eight photos see something there; one photo's sky may be wrong, two photos' is not."""
    view = VIEWS[0]
    centre = view.rotation.T @ (np.array([0.0, 0.0, 5.0]) - view.translation)
    full = np.ones((HEIGHT, WIDTH), bool)
    outlines = [SkySilhouette(full, ~full)] * sky + [SkySilhouette(~full, full)] * (8 - sky)
    for outline in outlines[:sky]:
        outline.solid[0, 0] = True  # photos without anything solid have no say
    hull = carve_silhouette_hull([view] * 8, outlines, centre - 0.05, 0.1, 0.2)
    assert bool(len(hull.places)) is kept
