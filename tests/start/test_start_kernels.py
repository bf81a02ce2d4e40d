# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernels of the starting surface against their references."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.synthetic.plain_house import PlainHouse
from mgf_engine.geometry.delaunay import delaunay
from mgf_engine.native import library
from mgf_engine.native.library import parallel
from mgf_engine.start import reference
from mgf_engine.start.lines import choose_neighbours, fit_segments, match_segments
from mgf_engine.start.options import OutsideOptions, SegmentOptions, ViewOptions
from mgf_engine.start.samples import poisson_disk_subset
from mgf_engine.start.segments import Segments, find_segments
from mgf_engine.start.tetrahedra import Tetrahedra, orient_positive
from mgf_engine.start.views import Silhouettes, StartViews, find_outside, pixel_rays, start_views


@pytest.fixture(scope="module")
def views(plain_house: PlainHouse) -> StartViews:
    return start_views(plain_house.scene, plain_house.masks, range(16), ViewOptions())


@pytest.fixture(scope="module")
def segments(views: StartViews) -> Segments:
    return find_segments(views, SegmentOptions(), 2)


@pytest.fixture(params=library.runnable_variants())
def variant(request: pytest.FixtureRequest):
    library.use_variant(request.param)
    yield
    library.use_variant("")


def test_matching_is_that_of_the_reference(segments: Segments, variant: None) -> None:
    neighbours = choose_neighbours(segments)
    lines, score = match_segments(segments, neighbours)
    assert np.count_nonzero(score > 2) > 20
    for n in range(0, len(score), 7):
        line, best = reference.match_segment(segments, n, neighbours)
        assert score[n] == pytest.approx(best, rel=1e-6, abs=1e-9)
        if best > 0:
            np.testing.assert_allclose(lines[n], line, atol=1e-6)


def test_segments_of_a_known_line_are_fitted_to_it(views: StartViews, variant: None) -> None:
    truth = np.array([[-1.2, -1.5, 0.8], [1.0, -1.5, 1.1]])
    front = [n for n, view in enumerate(views.views) if view.centre[1] < -3]
    ends = np.array([np.concatenate([views.views[n].project(truth)[0][k] for k in (0, 1)]) for n in front])
    ends += np.random.default_rng(0).normal(0, 0.05, ends.shape)
    number = np.array(front, np.int32)
    first = np.searchsorted(number, np.arange(len(views.views) + 1)).astype(np.int32)
    rays = np.stack([pixel_rays(views, number, ends[:, 2 * e : 2 * e + 2]) for e in range(2)], 1)
    sides = np.zeros((len(ends), 2, 3), np.float32)
    made = Segments(ends, sides, np.ascontiguousarray(rays), number, first, views, SegmentOptions())
    moved = truth + np.array([[0.0, 0.02, 0.02], [0.0, -0.01, 0.02]])
    lines, rows, residuals, shown = fit_segments(made, np.zeros(1, np.int32), moved[None])
    d = (truth[1] - truth[0]) / np.linalg.norm(truth[1] - truth[0])
    off = (lines[0] - truth[0]) - ((lines[0] - truth[0]) @ d)[:, None] * d
    assert np.linalg.norm(off, axis=1).max() < 0.01
    assert (rows[0, front] == np.arange(len(front))).all() and (np.delete(rows[0], front) == -1).all()
    assert residuals[0, front].max() < 0.3
    long = np.linalg.norm(truth[1] - truth[0])
    np.testing.assert_allclose(shown[0, front, 1] - shown[0, front, 0], long, atol=0.05)


@pytest.mark.parametrize("options", [OutsideOptions(1, 0.0), OutsideOptions(2, 0.12), OutsideOptions(1, 0.5, 0.5)])
def test_points_outside_of_masks_are_those_of_the_reference(
    views: StartViews, options: OutsideOptions, variant: None
) -> None:
    points = np.random.default_rng(1).uniform(-3, 3, (200, 3))
    got = find_outside(points, views.silhouettes, options)
    np.testing.assert_array_equal(got, reference.find_outside(points, views.silhouettes, options))
    assert 10 < got.sum() < 190


def test_a_few_bad_masks_cut_nothing_off(views: StartViews, variant: None) -> None:
    points = np.random.default_rng(2).uniform([-1.9, -1.4, 0.1], [1.9, 1.4, 1.4], (100, 3))
    assert not find_outside(points, views.silhouettes, OutsideOptions()).any()
    bad = replace(views.silhouettes, outside=views.silhouettes.outside.copy())
    bad.outside[[3, 11]] = 255
    assert find_outside(points, bad, OutsideOptions(share=0)).mean() > 0.9
    assert not find_outside(points, bad, OutsideOptions(share=0.2)).any()
    assert not find_outside(points, bad.without([3]), OutsideOptions(share=0)).any()


def test_beyond_the_frame_of_a_smaller_photo_nothing_is_asked(variant: None) -> None:
    camera = np.array([[[100.0, 0, 50, 0], [0, 100, 50, 0], [0, 0, 1, 0]]])
    outside = np.zeros((2, 100, 100), np.uint8)
    outside[0] = 255
    sizes = np.array([[100, 100], [40, 40]], np.int32)
    silhouettes = Silhouettes(np.repeat(camera, 2, 0), outside, sizes)
    within, beyond = [-0.4, -0.4, 1.0], [0.3, 0.3, 1.0]
    found = find_outside(np.array([within, beyond]), silhouettes, OutsideOptions(least_views=1, share=0.6))
    assert found.tolist() == [False, True]


@pytest.fixture(scope="module")
def tetrahedra() -> Tetrahedra:
    points = np.random.default_rng(2).random((40, 3))
    return Tetrahedra(points, orient_positive(points, delaunay(points)))


def test_the_tables_are_those_of_the_reference(variant: None) -> None:
    points = np.random.default_rng(3).random((3000, 3))
    tetrahedra = Tetrahedra(points, delaunay(points))
    first, listed = tetrahedra.around()
    for point in range(0, len(points), 37):
        assert np.array_equal(listed[first[point] : first[point + 1]], reference.around(tetrahedra, point))
    assert len(listed) == first[-1] == 4 * len(tetrahedra.corners)
    assert np.array_equal(tetrahedra.neighbours, reference.tetrahedron_neighbours(tetrahedra.corners))


def test_neighbours_share_three_corners(tetrahedra: Tetrahedra) -> None:
    for cell, row in enumerate(tetrahedra.neighbours):
        for k, other in enumerate(row):
            corners = set(np.delete(tetrahedra.corners[cell], k))
            holders = [c for c, tetra in enumerate(tetrahedra.corners) if corners <= set(tetra) and c != cell]
            assert holders == ([] if other < 0 else [other])


def test_rays_pass_the_cells_that_the_reference_finds(tetrahedra: Tetrahedra, variant: None) -> None:
    centres = np.array([[0.5, 0.5, 3.0], [-2.0, 0.4, 0.3]])
    inner = np.argsort(np.abs(tetrahedra.points - 0.5).max(1))[:8].astype(np.int32)  # none at the rim
    for number, centre in enumerate(centres):
        for point in inner:
            free, solid = np.zeros(len(tetrahedra.corners), np.int32), np.zeros(len(tetrahedra.corners), np.int32)
            face = np.zeros((len(tetrahedra.corners), 4), np.int32)
            one = np.ones(1, np.float32)
            with tetrahedra.kernel_table(from_points=True) as table:
                parallel(
                    "mgf_tetra_rays", 1, table, np.array([point], np.int32), np.array([number], np.int32),
                    centres, one, 0 * one, 0.1, 0.2, free, solid, face,
                )  # fmt: skip
            cell, passed = reference.cast_ray(tetrahedra, int(point), centre, 0.1)
            assert free[cell] == 1024 and free.sum() == 1024 and not solid.any()
            want = np.zeros_like(face)
            for c, k, weight in passed:
                want[c, k] += round(weight * 1024)
            assert np.abs(face - want).max() <= 1


def test_what_lies_behind_a_point_is_inside(tetrahedra: Tetrahedra, variant: None) -> None:
    point = int(np.argmin(np.abs(tetrahedra.points - 0.5).max(1)))
    centre = np.array([[0.5, 0.5, 3.0]])
    d = tetrahedra.points[point] - centre[0]
    behind = tetrahedra.points[point] + 0.05 * d / np.linalg.norm(d)
    solid, face = np.zeros(len(tetrahedra.corners), np.int32), np.zeros((len(tetrahedra.corners), 4), np.int32)
    one = np.ones(1, np.float32)
    with tetrahedra.kernel_table(from_points=True) as table:
        parallel(
            "mgf_tetra_rays", 1, table, np.array([point], np.int32), np.zeros(1, np.int32), centre, one, one,
            0.1, 0.05, np.zeros_like(solid), solid, face,
        )  # fmt: skip
    planes = reference.face_planes(tetrahedra)
    holds = (np.einsum("tkj,j->tk", planes[..., :3], behind) + planes[..., 3] <= 1e-9).all(1)
    assert (np.flatnonzero(solid) == np.flatnonzero(holds)).all() and solid.sum() == 1024


def test_pulled_rays_share_their_weight_by_length(tetrahedra: Tetrahedra, variant: None) -> None:
    start = np.array([[0.5, 0.5, 0.5]])
    direction = np.array([[0.36, 0.48, 0.8]])
    shut = np.zeros(len(tetrahedra.corners), np.uint8)
    long, short = np.zeros(len(shut), np.int32), np.zeros(len(shut), np.int32)
    outside = np.zeros(len(shut), np.int32)
    with tetrahedra.kernel_table() as table:
        parallel("mgf_tetra_pull", 1, table, start, direction, shut, 0.5, 10.0, long)
        parallel("mgf_tetra_pull", 1, table, start, direction, shut, 0.5, 1e-3, short)
        parallel("mgf_tetra_pull", 1, table, start + 9, direction, shut, 0.5, 10.0, outside)
    assert abs(int(long.sum()) - 512) < 4
    assert short.sum() < 4
    assert not outside.any()


@pytest.mark.parametrize("scale", [1.0, 1e4])
def test_points_are_chosen_as_by_the_reference(scale: float, variant: None) -> None:
    points = np.random.default_rng(0).uniform(-scale, scale, (2000, 3)) * (1, 1, 0.01) + 5 * scale
    chosen = poisson_disk_subset(points, 0.05 * scale)
    assert 300 < len(chosen) < 1500
    np.testing.assert_array_equal(chosen, reference.poisson_disk_subset(points, 0.05 * scale))
