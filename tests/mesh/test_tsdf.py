# SPDX-License-Identifier: GPL-3.0-or-later
"""What many depth maps of a wall say together, when some of them say otherwise."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from support.analytic import HEIGHT, WIDTH, camera, ring

from mgf_engine.mesh import depth_maps
from mgf_engine.mesh.depth_maps import DepthMap, ViewSurfaces, make_depth_maps
from mgf_engine.mesh.fusion_options import TsdfOptions
from mgf_engine.mesh.isosurface import FREE, SOLID
from mgf_engine.mesh.photometric import RenderedSurface
from mgf_engine.mesh.tsdf import TsdfField
from mgf_engine.model.scene import View
from mgf_engine.raster.points import INSIDE, NEAR, OUTSIDE

COUNT = 24
DEEPER = 10.0  # pixels


def wall_views() -> list[View]:
    """Cameras in front of the wall y = 0."""
    return [camera((0.1 * (i - COUNT / 2), -4.0, 0.3), target=(0.1 * (i - COUNT / 2), 0.0, 0.3)) for i in range(COUNT)]


def wall_surfaces(deeper: int) -> ViewSurfaces:
    """A wall in which ``deeper`` of the views see a hole of some pixels around the origin."""
    views = wall_views()

    def show(number: int) -> RenderedSurface:
        view = views[number]
        depth = np.full((HEIGHT, WIDTH), 4.0, np.float32)
        if number < deeper:
            column, row = view.project(np.zeros((1, 3)))[0][0]
            rows, columns = np.indices(depth.shape)
            depth[(abs(rows - row) < 6) & (abs(columns - column) < 6)] += DEEPER * 4 / view.fx
        normal = np.zeros((HEIGHT, WIDTH, 3), np.float32)
        normal[..., 2] = -1
        return RenderedSurface(view, np.zeros(depth.shape, np.uint8), depth, normal, np.zeros(depth.shape, bool))

    return ViewSurfaces(show)


def wall_field(deeper: int, masks: list[np.ndarray] | None = None) -> TsdfField:
    """The depth maps of a wall, fused."""
    return TsdfField(make_depth_maps(wall_surfaces(deeper), masks or [np.ones((HEIGHT, WIDTH), np.uint8)] * COUNT))


def behind(pixels: float) -> np.ndarray:
    return np.array([[0.0, pixels * 4 / wall_views()[0].fx, 0.0]])


def test_the_share_of_the_views_done_is_told() -> None:
    shares: list[float] = []
    make_depth_maps(wall_surfaces(0), [np.ones((HEIGHT, WIDTH), np.uint8)] * COUNT, progress=shares.append)
    assert shares == pytest.approx(np.arange(COUNT) / COUNT)


@pytest.mark.parametrize("pixels", [3, 5, 7])
def test_one_view_digs_no_hole_where_many_see_a_wall(pixels):
    assert wall_field(0).classify(behind(pixels))[0] == SOLID
    assert wall_field(1).classify(behind(pixels))[0] == SOLID
    assert wall_field(2).classify(behind(pixels))[0] == SOLID


def test_a_niche_that_a_few_views_look_into_stays_open():
    assert wall_field(6).classify(behind(5))[0] == FREE
    assert wall_field(6).classify(behind(DEEPER + 3))[0] == SOLID


def test_far_behind_a_surface_it_has_no_say():
    """What stands in front of a courtyard does not fill it, however many views see only that."""
    assert wall_field(0).classify(np.array([[0.0, -0.5, 0.0]]))[0] == FREE
    field = wall_field(1)
    field.maps[0].pixels[..., 0] = 8.0
    assert field.classify(np.array([[0.0, 2.0, 0.0]]))[0] == FREE


def blobs(seed: int) -> np.ndarray:
    """A mask in several pieces, at the frame's edge too, with rows that are empty."""
    random = np.random.default_rng(seed)
    mask = random.choice([0, 2], (HEIGHT, WIDTH)).astype(np.uint8)
    for _ in range(5):
        y, x = random.integers(-5, HEIGHT), random.integers(-5, WIDTH)
        mask[max(y, 0) : y + random.integers(1, 14), max(x, 0) : x + random.integers(1, 14)] = INSIDE
    return mask


def test_maps_cut_to_their_masks_answer_as_whole_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    masks = [blobs(seed) for seed in range(COUNT)]
    points = np.random.default_rng(0).uniform((-1.5, -0.1, -0.7), (1.5, 0.1, 1.3), (4000, 3))
    cut = wall_field(5, masks)
    with monkeypatch.context() as patch:
        whole_rows = np.arange(HEIGHT) * WIDTH
        patch.setattr(depth_maps, "_spans", lambda inside: (whole_rows, np.ones_like(inside)))
        whole = wall_field(5, masks)
    assert sum(m.pixels.nbytes for m in cut.maps) < 0.8 * sum(m.pixels.nbytes for m in whole.maps)
    np.testing.assert_array_equal(cut.distance(points), whole.distance(points))
    np.testing.assert_array_equal(cut.classify(points), whole.classify(points))
    for a, b in zip(cut.observations(points).values(), whole.observations(points).values(), strict=True):
        np.testing.assert_array_equal(a, b)
    assert np.isfinite(cut.distance(points)).sum() > 500


@pytest.mark.parametrize("seed", range(5))
def test_spans_hold_what_is_inside_and_its_neighbours(seed: int) -> None:
    inside = blobs(seed) == INSIDE
    rows, kept = depth_maps._spans(inside)
    assert (kept | ~cv2.dilate(inside.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)).all()
    y, x = np.nonzero(kept)
    assert (rows[y] + x == np.arange(len(y))).all()


def test_a_mask_without_an_inside_needs_no_map() -> None:
    assert not depth_maps._spans(np.zeros((4, 5), bool))[1].any()


def plain_samples(
    points: np.ndarray, views: list[View], maps: list[np.ndarray], mask: np.ndarray, band: float
) -> list[dict[str, float]]:
    """What ``native/csrc/mesh/tsdf.c`` does, point by point: a dict per point."""
    result = []
    for point in points:
        said = dict.fromkeys(("weight", "sum", "covered", "outside", "seen", "near", "fused", "behind"), 0.0)
        for view, pixels in zip(views, maps, strict=True):
            x, y, z = view.rotation @ point + view.translation
            u, v = x / z * view.fx + view.cx, y / z * view.fy + view.cy
            if not (z > NEAR and 0 <= u < view.width and 0 <= v < view.height):
                continue
            said["outside"] += mask[int(v), int(u)] == OUTSIDE
            if mask[int(v), int(u)] != INSIDE:
                continue
            said["seen"] += 1
            here, left, top = pixels[int(v), int(u)], int(np.floor(u - 0.5)), int(np.floor(v - 0.5))
            if here[2] > 0 and left >= 0 and top >= 0 and left + 1 < view.width and top + 1 < view.height:
                four, a, b = pixels[top : top + 2, left : left + 2], u - 0.5 - left, v - 0.5 - top
                if (four[..., 2] > 0).all() and (np.abs(four[..., 0] - here[0]) <= TsdfOptions.jump * here[0]).all():
                    here = np.einsum("i,j,ijk->k", [1 - b, b], [1 - a, a], four)
            if not here[2] > 0:
                continue
            s = (here[0] - z) * here[1] / (band / view.fx * here[0])
            said["near"] += abs(s) < 0.5
            said["covered"] += s < -1
            said["behind"] += -4 < s < -1
            if s >= -1:
                said["fused"] += 1
                said["weight"] += here[2]
                said["sum"] += here[2] * min(s, 1.0)
        result.append(said)
    return result


def test_samples_are_those_of_the_plain_sum_over_views() -> None:
    rng = np.random.default_rng(4)
    views, shape = ring(5), (HEIGHT, WIDTH)
    mask = rng.choice(np.array([INSIDE, INSIDE, INSIDE, OUTSIDE, 2], np.uint8), shape)
    maps = []
    for view in views:
        depth = np.linalg.norm(view.centre) * (0.85 + 0.2 * (rng.random(shape) < 0.1) + 0.004 * rng.random(shape))
        slope, weight = (
            rng.uniform(TsdfOptions.least_slope, 1, shape),
            rng.uniform(0.5, 1, shape) * (rng.random(shape) < 0.9),
        )
        maps.append(np.stack([depth, slope, weight, np.zeros(shape)], -1).astype(np.float32))
    rows = np.arange(HEIGHT, dtype=np.int64) * WIDTH
    field = TsdfField([DepthMap(view, mask, rows, m.reshape(-1, 4)) for view, m in zip(views, maps, strict=True)])
    points = rng.uniform(-1, 1, (3000, 3)).astype(np.float32).astype(np.float64)
    found = np.concatenate(list(field._sample(points, lambda sample: sample)))
    expected = plain_samples(points, views, maps, mask, field.band)
    for name in ("covered", "outside", "seen", "near", "fused", "behind"):
        assert found[name].sum() > 50
        np.testing.assert_array_equal(found[name], [said[name] for said in expected])
    for name in ("weight", "sum"):
        np.testing.assert_allclose(found[name], [said[name] for said in expected], rtol=1e-4, atol=1e-4)
