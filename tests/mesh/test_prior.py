# SPDX-License-Identifier: GPL-3.0-or-later
"""The starting surface beside the field: which of both a pixel takes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.sideways import view_beside

from mgf_engine.mesh.depth_maps import depth_map
from mgf_engine.mesh.fusion_options import TsdfOptions
from mgf_engine.mesh.photometric import Matched, MatchOptions, RenderedSurface, match_surface
from mgf_engine.mesh.prior import Prior, PriorOptions, RenderedPrior, choose_depths, combine_surfaces
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.scene import View
from mgf_engine.raster.points import INSIDE

AT, BESIDE = 5.0, 5.5
SIZE = 64
NOTHING = np.zeros((SIZE, SIZE), np.float32)


def view(x: float) -> View:
    return view_beside(x, 0.0, (SIZE, SIZE), (80.0, 84.0), (31.0, 33.0), AT)


def surface(depth: float) -> RenderedSurface:
    normal = np.zeros((SIZE, SIZE, 3), np.float32)
    normal[..., 2] = -1
    return RenderedSurface(
        view(0.0), np.full((SIZE, SIZE), 90, np.uint8), NOTHING + np.float32(depth), normal, NOTHING > 0
    )


def likes(depth: float):
    """A matching by which photos confirm surfaces at one depth only."""

    def match(first: RenderedSurface, others: object, search: object) -> Matched:
        correlation = np.where(np.abs(first.depth - depth) < 0.01, 0.9, 0).astype(np.float32)
        return Matched(first.depth, correlation, correlation, NOTHING + np.float32(1 / view(0.0).fx))

    return match


def decide(field: float, prior: float, confidence: float, confirmed: float) -> tuple[RenderedSurface, Matched]:
    match = likes(confirmed)
    known = RenderedPrior(surface(prior), NOTHING + np.float32(confidence))
    both = combine_surfaces(surface(field), known)
    return choose_depths(both, known, match(both, [], MatchOptions()), [], MatchOptions(), match)


@pytest.mark.parametrize(("confirmed", "taken"), [(AT, AT), (BESIDE, BESIDE), (9.0, BESIDE)])
def test_what_photos_confirm_wins_and_else_the_prior(confirmed: float, taken: float) -> None:
    _, matched = decide(AT, BESIDE, 1.0, confirmed)
    np.testing.assert_allclose(matched.depth, taken)


def test_the_prior_fills_what_the_field_does_not_show() -> None:
    shown, matched = decide(0.0, AT, 0.0, 9.0)
    np.testing.assert_allclose(matched.depth, AT)
    assert not shown.free_space.any()


def test_a_sure_plane_stands_for_a_field_that_lies_almost_on_it() -> None:
    near = AT * (1 + 1.0 / view(0.0).fx)
    for confidence, taken in ((1.0, AT), (0.0, near)):
        both = combine_surfaces(surface(near), RenderedPrior(surface(AT), NOTHING + np.float32(confidence)))
        np.testing.assert_allclose(both.depth, taken, rtol=1e-6)


def test_what_no_photo_confirms_weighs_by_how_sure_its_plane_is() -> None:
    mask = np.full((SIZE, SIZE), INSIDE, np.uint8)
    weights = []
    for sure in (0.0, 1.0):
        shown, matched = decide(AT, AT, sure, 9.0)
        weights.append(depth_map(shown, mask, matched).pixels[..., 2].mean())
    assert weights[1] / weights[0] == pytest.approx(
        (PriorOptions.unmatched_weight[0] + PriorOptions.unmatched_weight[1]) / PriorOptions.unmatched_weight[0],
        rel=1e-4,
    )
    assert PriorOptions.unmatched_weight[0] == TsdfOptions.unmatched


def test_a_view_shows_the_prior_from_the_front_only() -> None:
    seen = view(0.0)
    square = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    front = Mesh(square, np.array([[0, 2, 1], [0, 3, 2]], np.int32), np.zeros((4, 3), np.uint8))
    sure = np.array([0.3, 0.7], np.float32)
    known = Prior(front, sure).seen_from(seen, np.zeros((SIZE, SIZE), np.uint8))
    assert set(np.unique(known.confidence)) == {np.float32(0), np.float32(0.3), np.float32(0.7)}
    assert (known.surface.depth[known.confidence > 0] > 4.5).all()
    back = replace(front, faces=front.faces[:, ::-1].copy())
    assert not Prior(back, sure).seen_from(seen, np.zeros((SIZE, SIZE), np.uint8)).surface.depth.any()


def test_matching_without_neighbours_leaves_the_prior_alone() -> None:
    assert match_surface(surface(AT), [], MatchOptions()).correlation.max() == 0


def test_where_nothing_is_confirmed_the_nearer_surface_is_taken() -> None:
    """A field shows what is behind where its Gaussians leave gaps; an unsure prior behind it proves nothing."""
    np.testing.assert_allclose(decide(BESIDE, AT, 0.0, 9.0)[1].depth, AT)
    np.testing.assert_allclose(decide(AT, BESIDE, 0.0, 9.0)[1].depth, AT)


def test_pixels_beside_a_step_in_depth_weigh_a_tenth() -> None:
    flat, ones = surface(AT), np.ones((SIZE, SIZE), np.float32)
    stepped = flat.depth.copy()
    stepped[:, SIZE // 2 :] *= 2

    def weights(depth: np.ndarray) -> np.ndarray:
        matched = Matched(depth, ones, ones, ones)
        return depth_map(flat, np.full((SIZE, SIZE), INSIDE, np.uint8), matched).pixels[:, 2].reshape(SIZE, SIZE)

    left = (weights(stepped) / weights(flat.depth))[:, : SIZE // 2]
    assert left[:, :-1] == pytest.approx(1) and left[:, -1] == pytest.approx(0.1)
