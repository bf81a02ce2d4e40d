# SPDX-License-Identifier: GPL-3.0-or-later
"""Ground between bars is cut out of a mask; a wall that stands on it keeps its foot, and closed buildings stay."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from mast import UP, make_scene
from numpy.typing import NDArray

from mgf_engine.masks.geometry.ground_plane import GroundPlane
from mgf_engine.masks.refinement.ground_homography import GroundFinder
from mgf_engine.masks.refinement.lab_photos import LabPhotos
from mgf_engine.masks.refinement.mirrored_ground import MirroredGroundOptions, MirrorTest
from mgf_engine.model.scene import View

WIDTH, HEIGHT, FOCAL = 300, 240, 500.0
GROUND = GroundPlane(UP, 0.0, 0.01)
#: A wall or a lattice in the plane x = 0, half as wide and as high as this; bars and what is from one to the next.
HALF, TOP, BAR, STEP = 1.0, 1.6, 0.06, 0.4


def look_down(angle: float, height: float) -> View:
    """A camera on an arc before the plane x = 0 that looks at its middle from above."""
    centre = np.array([7 * np.cos(angle), 7 * np.sin(angle), height])
    forward = np.array([0.0, 0.0, TOP / 2]) - centre
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, UP)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    name = f"{angle:.2f}-{height:.1f}.png"
    return View(name, name, WIDTH, HEIGHT, FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2, rotation, -rotation @ centre,
                WIDTH, HEIGHT)  # fmt: skip


VIEWS = [look_down(angle, 3.0 + 1.5 * (k % 3)) for k, angle in enumerate(np.linspace(-0.7, 0.7, 13))]
MIDDLE = 6
TEXTURES = [
    cv2.GaussianBlur(np.random.default_rng(seed).uniform(0, 255, (512, 512)).astype(np.float32), (0, 0), 1.5)
    for seed in range(2)
]


def texture(number: int, place: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Mottled grey at places [..., 2] of a surface, [..., 3]; coarse (0) or fine (1)."""
    uv = (place / (0.03, 0.012)[number] + 256).astype(np.float32)
    grey = cv2.remap(TEXTURES[number], uv[..., 0], uv[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    return np.clip(100 + 60 * number + (np.nan_to_num(grey) - 128), 0, 255).astype(np.uint8)[..., None].repeat(3, 2)


def photograph(
    view: View, lattice: bool, boards: bool = False, mirror: bool = False
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """The photo, and the pixels of the wall or of its bars; of boards, nothing changes along the ground."""
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5 - view.cx, np.arange(HEIGHT) + 0.5 - view.cy)
    rays = np.stack([x / view.fx, y / view.fy, np.ones_like(x)], -1) @ view.rotation
    wall = view.centre + rays * (-view.centre[0] / rays[..., 0])[..., None]
    solid = (np.abs(wall[..., 1]) < HALF) & (wall[..., 2] > 0) & (wall[..., 2] < TOP)
    if lattice:
        solid &= (np.mod(wall[..., 1:] + BAR / 2, STEP) < BAR).any(-1)
    ground = view.centre + rays * GROUND.depth(view, HEIGHT, WIDTH)[..., None]
    front = texture(1, wall[..., 1:] * (0 if boards else 1, 1))
    if mirror:  # the ray that is thrown back meets the ground where the ray that passes would, on this side
        front = texture(0, ground[..., :2] * (-1, 1))
    return np.where(solid[..., None], front, texture(0, ground[..., :2])), solid


def seen_in(
    folder: Path, lattice: bool, views: list[View] = VIEWS, boards: bool = False, mirror: bool = False
) -> GroundFinder:
    scene = make_scene(folder, views)
    for view in views:
        cv2.imwrite(str(folder / view.file), photograph(view, lattice, boards, mirror)[0])
    return GroundFinder(LabPhotos(replace(scene, folder=folder)), GROUND)


@pytest.fixture(scope="module")
def frame(tmp_path_factory: pytest.TempPathFactory) -> GroundFinder:
    return seen_in(tmp_path_factory.mktemp("frame"), True)


@pytest.fixture(scope="module")
def wall(tmp_path_factory: pytest.TempPathFactory) -> GroundFinder:
    return seen_in(tmp_path_factory.mktemp("wall"), False)


def grown(mask: NDArray[np.bool_], pixels: int) -> NDArray[np.bool_]:
    kernel = np.ones((2 * abs(pixels) + 1,) * 2, np.uint8)
    return (cv2.dilate if pixels > 0 else cv2.erode)(mask.astype(np.uint8), kernel) > 0


def test_ground_between_bars_is_found_and_bars_are_not(frame: GroundFinder) -> None:
    _, bars = photograph(VIEWS[MIDDLE], True)
    _, mask = photograph(VIEWS[MIDDLE], False)
    found = frame.find_ground_pixels(MIDDLE, mask)
    between = mask & ~bars
    assert (found.certain & between).sum() > 0.6 * between.sum()
    assert (found.certain & bars).sum() < 0.1 * bars.sum()  # one bar lies on the ground
    assert not (found.possible & found.certain).any()
    assert not ((found.possible | found.certain) & ~mask).any()


def test_the_foot_of_a_wall_is_not_taken_for_ground(wall: GroundFinder) -> None:
    """Near its foot the ground fits nearly as well as the wall does."""
    _, mask = photograph(VIEWS[MIDDLE], False)
    found = wall.confirmed_ground(MIDDLE, grown(mask, 12))
    assert (found & grown(mask, -2)).sum() < 0.005 * mask.sum()
    assert (found & ~mask).sum() > 0.6 * (grown(mask, 12) & ~mask).sum()


def test_only_what_is_open_is_cut(frame: GroundFinder, wall: GroundFinder) -> None:
    def mask_of(index: int) -> NDArray[np.bool_]:
        return photograph(VIEWS[index], False)[1]

    assert frame.is_open_structure(range(len(VIEWS)), mask_of)
    assert not wall.is_open_structure(range(len(VIEWS)), mask_of)
    assert not frame.is_open_structure([], mask_of)


def test_ground_below_a_canopy_is_cut_from_a_closed_building_and_feet_of_walls_are_not(wall: GroundFinder) -> None:
    """The mask takes in a wide piece of paving beside the wall, and a strip along its foot."""
    _, solid = photograph(VIEWS[MIDDLE], False)
    rows, columns = np.nonzero(solid)
    foot, left = rows.max(), columns.min()
    paving = np.zeros_like(solid)
    paving[foot - 30 : foot + 10, left - 45 : left] = True
    paving &= ~solid
    strip = grown(solid, 4) & ~solid & ~grown(paving, 12)
    found = wall.find_wide_pieces(MIDDLE, solid | paving | strip)
    assert (found.certain & paving).sum() > 0.6 * paving.sum()
    assert (found.certain & solid).sum() < 0.003 * solid.sum()
    assert not (found.certain & strip).any()
    assert not wall.find_wide_pieces(MIDDLE, solid | strip).certain.any()


def test_boards_along_the_ground_are_none(tmp_path: Path) -> None:
    """From the street, the ground and planes over it fit the foot of a wall of boards alike."""
    street = [look_down(angle, 0.9) for angle in np.linspace(-0.7, 0.7, 13)]
    boards = seen_in(tmp_path, False, street, boards=True)
    mask = photograph(street[MIDDLE], False)[1]
    assert boards.confirmed_ground(MIDDLE, mask).sum() < 0.015 * mask.sum()
    blind = replace(boards.options, distinct=-2.0)
    assert GroundFinder(boards.photos, GROUND, blind).confirmed_ground(MIDDLE, mask).sum() > 0.1 * mask.sum()


@pytest.mark.parametrize("mirror", [False, True])
def test_ground_that_a_pane_mirrors_is_none(tmp_path: Path, mirror: bool) -> None:
    """All photos that look into the pane agree on the ground behind it, those from the other side do not."""
    around = [look_down(angle, 3.0 + 1.5 * (k % 3)) for k, angle in enumerate(np.arange(0.1, 2 * np.pi, 0.15))]
    plain = seen_in(tmp_path, not mirror, around, mirror=mirror)
    masks = [photograph(view, False)[1] for view in around]
    test = MirrorTest(plain.photos, GROUND, [mask.astype(np.uint8) for mask in masks])
    finder = GroundFinder(plain.photos, GROUND, confirmed=test.confirmed)
    before, after = plain.confirmed_ground(2, grown(masks[2], 12)), finder.confirmed_ground(2, grown(masks[2], 12))
    assert not (after & ~before).any() and (before & masks[2]).sum() > 0.4 * masks[2].sum()
    kept = (after & masks[2]).sum() / (before & masks[2]).sum()
    assert kept < 0.15 if mirror else kept > 0.95
    facing = range(4)
    assert plain.is_open_structure(facing, lambda i: masks[i])
    assert mirror or finder.is_open_structure(facing, lambda i: masks[i])


def test_photos_from_the_other_side_confirm_ground_that_none_sees_beside_the_building(tmp_path: Path) -> None:
    around = [look_down(angle, 3.0 + 1.5 * (k % 3)) for k, angle in enumerate(np.arange(0.1, 2 * np.pi, 0.15))]
    photos = seen_in(tmp_path, True, around).photos
    everything = [np.ones((HEIGHT, WIDTH), np.uint8) for _ in around]
    ground = photograph(around[2], False)[1] & ~photograph(around[2], True)[1]
    for opposite, least in ((100.0, 0.3), (180.0, 0.0)):
        test = MirrorTest(photos, GROUND, everything, MirroredGroundOptions(opposite=opposite))
        share = (test.confirmed(2, ground) & ground).sum() / ground.sum()
        assert share > least if least else share == 0


def test_what_no_photo_sees_from_another_side_is_not_confirmed(frame: GroundFinder) -> None:
    mask = photograph(VIEWS[MIDDLE], False)[1]
    found = frame.confirmed_ground(MIDDLE, mask)
    everywhere = MirrorTest(frame.photos, GROUND, [np.ones_like(mask, np.uint8) for _ in VIEWS])
    assert found.any() and not everywhere.confirmed(MIDDLE, found).any()
    assert not everywhere.confirmed(MIDDLE, np.zeros_like(mask)).any()


def test_too_few_photos_tell_nothing(frame: GroundFinder) -> None:
    few = GroundFinder(LabPhotos(replace(frame.scene, views=frame.scene.views[:3])), GROUND)
    assert not few.confirmed_ground(1, np.ones((HEIGHT, WIDTH), bool)).any()
    assert not frame.confirmed_ground(MIDDLE, np.zeros((HEIGHT, WIDTH), bool)).any()
