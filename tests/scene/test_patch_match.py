# SPDX-License-Identifier: GPL-3.0-or-later
"""PatchMatch stereo: the kernel against its reference, and what it finds on surfaces that are known."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from support.sideways import view_beside

from mgf_engine.errors import Cancelled
from mgf_engine.model.scene import Scene, Similarity, View
from mgf_engine.native import library
from mgf_engine.scene import patch_match
from mgf_engine.scene.depths import Depths
from mgf_engine.scene.kernel_photos import pixel_transfer
from mgf_engine.scene.neighbours import MatchingPoints, NeighbourOptions
from mgf_engine.scene.patch_match import PatchMatchOptions, PixelPlanes
from mgf_engine.scene.reference_patch_match import Neighbour, move_planes
from mgf_engine.scene.stereo import StereoPhoto

WIDTH, HEIGHT, DISTANCE, TILT = 96, 72, 5.0, 0.5
OPTIONS = PatchMatchOptions(rounds=2)


@pytest.fixture(params=library.runnable_variants())
def variant(request: pytest.FixtureRequest) -> Iterator[str]:
    library.use_variant(request.param)
    yield request.param
    library.use_variant("")


def view_at(x: float, turn: float) -> View:
    return view_beside(x, turn, (WIDTH, HEIGHT), (120.0, 124.0), (47.0, 37.0), DISTANCE)


def texture(points: np.ndarray) -> np.ndarray:
    """Sum of waves in many directions, 0 to 1."""
    generator, total = np.random.default_rng(5), 0.0
    for _ in range(12):
        total = total + np.sin(points[..., :2] @ generator.normal(0, 14, 2) + generator.uniform(0, 6))
    return 0.5 + total / 24


def photo_of(view: View, plain: bool = False) -> tuple[StereoPhoto, np.ndarray]:
    """A photo of the textured plane z = TILT * x, and its true depth."""
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    rays = np.stack([(x - view.cx) / view.fx, (y - view.cy) / view.fy, np.ones_like(x)], -1)
    towards, normal = rays @ view.rotation, np.array([TILT, 0.0, -1.0])
    depth = -(view.centre @ normal) / (towards @ normal)
    points = view.centre + depth[..., None] * towards
    grey = np.full(depth.shape, 0.5) if plain else texture(points)
    return StereoPhoto(view, np.rint(255 * grey).astype(np.uint8), np.ones(depth.shape, bool)), depth


VIEWS = [view_at(0.0, 0.0), view_at(0.7, -0.12), view_at(-0.6, 0.1), view_at(1.1, -0.2)]
PHOTOS, TRUTH = zip(*map(photo_of, VIEWS), strict=True)
BOUNDS = (float(1 / TRUTH[0].max()) * 0.8, float(1 / TRUTH[0].min()) * 1.2)


def at_random(photo: StereoPhoto, seed: int = 0) -> PixelPlanes:
    rim = np.zeros(photo.grey.shape, bool)
    rim[5:-5, 5:-5] = True
    pixels = np.flatnonzero(rim & photo.inside).astype(np.int32)
    values = np.zeros((4, len(pixels)), np.float32)
    values[0] = np.random.default_rng(seed).uniform(*BOUNDS, len(pixels))
    values[3] = -1
    return PixelPlanes(pixels, values, BOUNDS)


@pytest.mark.parametrize("consistent", [False, True])
def test_kernel_equals_its_reference(variant: str, consistent: bool) -> None:
    planes, photo, others = at_random(PHOTOS[0]), PHOTOS[0], PHOTOS[1:]
    held = [np.where(np.arange(WIDTH) < 60, t, 0).astype(np.float32) for t in TRUTH[1:]]
    fields = np.zeros((4, HEIGHT * WIDTH), np.float32)
    fields[:, planes.pixels] = planes.values
    even = (planes.pixels % WIDTH + planes.pixels // WIDTH) % 2 == 0
    chosen = np.ascontiguousarray(planes.pixels[even][::9])
    search = patch_match.search_struct(photo, BOUNDS, len(others), 1, 0, consistent, OPTIONS)
    expected = move_planes(
        chosen, photo.grey,
        [Neighbour(p.grey, d, pixel_transfer(VIEWS[0], p.view)) for p, d in zip(others, held, strict=True)], search[0],
        fields[:3].reshape(3, HEIGHT, WIDTH).astype(np.float64),
    ).reshape(4, -1)[:, chosen]  # fmt: skip
    first = patch_match.photo_struct(VIEWS[0], [(photo.quads, None, VIEWS[0])])
    other = patch_match.photo_struct(VIEWS[0], [(p.quads, d, p.view) for p, d in zip(others, held, strict=True)])
    library.parallel("mgf_patch_match", len(chosen), chosen, first, other, len(others), search, *fields)
    found = fields[:, chosen]
    # The sums are rounded otherwise, so that where two planes are as good, the other one may be kept.
    assert np.abs(found[3] - expected[3]).max() < 2e-3
    same = np.abs(found[:3] - expected[:3]).max(0) < 1e-5
    assert same.mean() > 0.98
    assert (expected[3] > 0.5).any() and (expected[3] < 0).any()


def search(photo: StereoPhoto, others: list[StereoPhoto], planes: PixelPlanes, rounds: int = 6) -> None:
    patch_match._search(photo, others, None, planes, range(rounds), OPTIONS)


def test_planes_are_found_from_nothing() -> None:
    planes = at_random(PHOTOS[0])
    search(PHOTOS[0], list(PHOTOS[1:]), planes)
    depth = planes.depth((HEIGHT, WIDTH), 0.7)
    known = depth > 0
    assert known[10:-10, 10:-10].mean() > 0.6
    assert np.median(np.abs(depth[known] / TRUTH[0][known] - 1)) < 0.002
    # The slope of a plane's inverse depth: n / (n . centre) per unit of the ray, which is 1 / fx per pixel.
    sure = planes.values[3] > 0.9
    slope = TILT / DISTANCE / VIEWS[0].fx
    assert abs(np.median(np.abs(planes.values[1, sure])) / slope - 1) < 0.1
    assert np.median(np.abs(planes.values[2, sure])) < 0.1 * slope


def test_result_does_not_depend_on_the_number_of_threads() -> None:
    results = []
    for count in (1, 3):
        library.set_threads(count)
        planes = at_random(PHOTOS[0])
        search(PHOTOS[0], list(PHOTOS[1:]), planes, 2)
        results.append(planes.values)
    library.set_threads(0)
    assert np.array_equal(*results)


def test_plain_walls_get_no_depth() -> None:
    photos = [photo_of(v, plain=True)[0] for v in VIEWS]
    planes = at_random(photos[0])
    search(photos[0], photos[1:], planes, 2)
    assert (planes.values[3] == -1).all()
    assert not planes.depth((HEIGHT, WIDTH), 0.3).any()


def test_what_lies_outside_the_search_is_not_kept() -> None:
    planes = replace(at_random(PHOTOS[0]), bounds=(BOUNDS[1] * 2, BOUNDS[1] * 3))
    search(PHOTOS[0], list(PHOTOS[1:]), planes, 2)
    assert (planes.values[3] == -1).all()


def test_a_depth_counts_when_it_is_sure_or_both_agree() -> None:
    pixels = np.arange(4, dtype=np.int32)
    values = np.zeros((4, 4), np.float32)
    values[0], values[3] = 0.5, [0.8, 0.5, 0.5, 0.1]
    planes = PixelPlanes(pixels, values, (0.1, 1.0))
    other = np.array([[9, 2.001, 2.1, 2.0]], np.float32)
    options = replace(OPTIONS, sure_score=0.7, unmatched_score=0.6)
    np.testing.assert_allclose(patch_match._choose(planes, other, (1, 4), 0.008, options), [[2, 2, 0, 0]])
    np.testing.assert_allclose(patch_match._choose(planes, None, (1, 4), 0.008, options), [[2, 0, 0, 0]])
    np.testing.assert_allclose(patch_match._choose(planes, other, (1, 4), 0.008, OPTIONS), [[0, 2, 0, 0]])


@pytest.fixture(scope="module")
def known(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """The four views with sparse points on the plane."""
    generator = np.random.default_rng(1)
    x, y = generator.uniform(-1.5, 1.5, 300), generator.uniform(-1.2, 1.2, 300)
    points = np.stack([x, y, TILT * x], 1)
    uv = np.stack([view.project(points)[0] for view in VIEWS], 1)
    inside = (uv > 0).all(2) & (uv < (WIDTH, HEIGHT)).all(2)
    return Scene(
        views=tuple(VIEWS), points=points, colors=np.zeros((300, 3), np.uint8), errors=np.zeros(300, np.float32),
        track_start=np.r_[0, np.cumsum(inside.sum(1))], track_view=np.nonzero(inside)[1].astype(np.int32),
        track_uv=uv[inside].astype(np.float32), to_normalised=Similarity(1.0, np.eye(3), np.zeros(3)), roots=(0,),
        held_out=(), folder=tmp_path_factory.mktemp("scene"),
    )  # fmt: skip


def all_points(scene: Scene) -> MatchingPoints:
    return MatchingPoints(scene, np.ones(len(scene.points), bool), range(len(scene.views)))


def poor_depths() -> Depths:
    generator = np.random.default_rng(2)
    maps = {}
    for i, truth in enumerate(TRUTH):
        wrong = generator.uniform(size=truth.shape) < 0.3
        maps[i] = np.where(wrong, truth * generator.uniform(0.9, 1.1, truth.shape), truth).astype(np.float32)
    return Depths(dict(enumerate(PHOTOS)), {i: [j for j in range(4) if j != i] for i in range(4)}, maps, 0.008)


def test_poor_depth_maps_become_better(known: Scene) -> None:
    before = poor_depths()
    choice = NeighbourOptions(angles=(1.0, 10.0, 40.0))
    after = patch_match.improve_depths(before, all_points(known), choice, OPTIONS, lambda: None)
    for i, truth in enumerate(TRUTH):
        inner = np.zeros(truth.shape, bool)
        inner[10:-10, 10:-10] = True
        wrong = [(np.abs(d.maps[i] / truth - 1) > 0.01)[inner & (d.maps[i] > 0)].mean() for d in (before, after)]
        assert wrong[1] < 0.3 * wrong[0]
        assert (after.maps[i] > 0)[inner].mean() > 0.2  # what the outermost photo shows, two others hardly do
    assert before.maps[0] is not after.maps[0]


def test_no_rounds_leave_the_depth_maps_alone(known: Scene) -> None:
    before = poor_depths()
    options = replace(OPTIONS, rounds=0)
    assert patch_match.improve_depths(before, all_points(known), NeighbourOptions(), options, lambda: None) is before


def test_photos_that_semi_global_matching_cannot_match_get_a_depth_map(known: Scene) -> None:
    """The others keep theirs, which rate its planes."""
    maps = {i: TRUTH[i].astype(np.float32) for i in (1, 2, 3)}
    before = replace(poor_depths(), maps=maps)
    choice, options = NeighbourOptions(angles=(1.0, 10.0, 40.0)), PatchMatchOptions(unmatched_share=0.25)
    after = patch_match.improve_depths(before, all_points(known), choice, options, lambda: None)
    assert all(after.maps[i] is before.maps[i] for i in (1, 2, 3))
    inner = np.zeros(TRUTH[0].shape, bool)
    inner[10:-10, 10:-10] = True
    found = inner & (after.maps[0] > 0)
    assert found.sum() > 0.6 * inner.sum()
    assert (np.abs(after.maps[0] / TRUTH[0] - 1) < 0.01)[found].mean() > 0.9
    for off in ({"unmatched_rounds": 0}, {"unmatched_share": 0.5}):
        least = replace(options, **off)
        assert patch_match.improve_depths(before, all_points(known), choice, least, lambda: None) is before


def test_it_can_be_cancelled(known: Scene) -> None:
    def stop() -> None:
        raise Cancelled

    with pytest.raises(Cancelled):
        patch_match.improve_depths(
            poor_depths(), all_points(known), NeighbourOptions(angles=(1.0, 10.0, 40.0)), OPTIONS, stop
        )
