# SPDX-License-Identifier: GPL-3.0-or-later
"""The records that projection hands to the blending kernels, and the lists of the tiles."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from rendered import camera, gaussians
from support.tile_lists import check_lists
from torch import Tensor

from mgf_engine.raster import reference
from mgf_engine.raster.api import build_lists


def answer(records: Tensor, pixels: Tensor) -> tuple[Tensor, Tensor]:
    """Response before clamping and depth of every record [N, 32] at pixels [P, 2], by the formulas of records.h."""
    r = records.double().T[:, :, None]
    dx, dy = pixels[:, 0] - r[0], pixels[:, 1] - r[1]
    q = r[2] * dx**2 + 2 * r[3] * dx * dy + r[4] * dy**2
    a = 1 + r[5] * dx + r[6] * dy + r[7] * dx**2 + 2 * r[8] * dx * dy + r[9] * dy**2
    b = r[10] + r[11] * dx + r[12] * dy
    return r[13] * torch.exp(-0.5 * q / a), b / a


def test_records_answer_like_the_covariance(variant: str) -> None:
    field, view = gaussians(200, seed=3), camera()
    lists = build_lists(field, view, 3)
    seen = reference.project(field, view, 3)
    listed = lists.tile_counts > 0
    assert 100 < listed.sum() < 200
    records = lists.records[listed]
    pixels = torch.rand(300, 2, dtype=torch.float64) * torch.tensor([45.0, 35.0])
    response = reference.respond(seen, view, pixels)
    place = torch.empty_like(response.order)
    place[response.order] = torch.arange(200)
    free, t = answer(records, pixels)
    shows = free > 1 / 255
    assert shows.sum() > 1000
    assert torch.allclose(free[shows], response.free[place[listed]][shows], rtol=2e-4, atol=1e-6)
    assert torch.allclose(t[shows], response.t[place[listed]][shows], rtol=1e-5)
    for columns, expected in (
        (slice(0, 2), seen.pixel),
        (slice(13, 14), seen.opacity[:, None]),
        (slice(14, 17), seen.rgb),
        (slice(17, 20), seen.normal),
        (slice(22, 23), -torch.log2(255 * seen.opacity)[:, None]),
    ):
        assert torch.allclose(records[:, columns].double(), expected[listed], rtol=1e-4, atol=1e-5), columns
    ray = seen.centre / seen.depth[:, None]
    ray2 = torch.einsum("ni,nij,nj->n", ray, seen.precision, ray)
    assert torch.allclose(records[:, 23].double(), ray2[listed], rtol=1e-4)


def test_normal_of_a_flat_gaussian_is_its_short_axis(variant: str) -> None:
    field, view = gaussians(50, seed=1), camera()
    field.log_scales[:] = torch.tensor([-2.0, -2.0, -9.0])
    field.filter_3d[:] = 0.0
    lists = build_lists(field, view)
    listed = lists.tile_counts > 0
    axes = torch.as_tensor(view.rotation) @ reference.rotation_matrices(field.rotations.double())[:, :, 2, None]
    cosine = (lists.records[:, 17:20].double() * axes[:, :, 0]).sum(1)[listed].abs()
    assert cosine.min() > 0.999
    centres = reference.project(field, view, 0).centre[listed]
    assert ((lists.records[listed, 17:20].double() * centres).sum(1) < 0).all(), "a normal looks away from the camera"


@settings(max_examples=20)
@given(seed=st.integers(0, 10_000), log_scale=st.floats(-4, 0.5), flat=st.floats(0, 4), mask=st.integers(0, 2**12 - 1))
def test_lists_hold_all_that_shows(seed: int, log_scale: float, flat: float, mask: int) -> None:
    field, view = gaussians(80, seed, log_scale=log_scale), camera(61, 40, seed=seed)
    field.log_scales[:, 2] -= flat
    tile_mask = torch.tensor([mask >> i & 1 for i in range(12)]).view(3, 4)
    lists = build_lists(field, view, 0, tile_mask)
    touched = reference.touched_tiles(field, view)
    check_lists(lists, touched, tile_mask)


def test_lists_hold_little_more_than_shows(variant: str) -> None:
    """Footprints are exact: of Gaussians wider than a pixel hardly any entry is in vain."""
    field, view = gaussians(200, log_scale=-1.5, log_spread=0.4), camera(61, 40)
    lists = build_lists(field, view)
    touched = reference.touched_tiles(field, view)
    listed = check_lists(lists, touched, torch.ones(view.tiles))
    ellipse = (lists.records[:, 24] > -1e7) & (lists.tile_counts > 0)
    extra = (listed & ~touched.flatten(1))[ellipse].sum()
    assert extra <= 0.02 * listed[ellipse].sum()


def test_no_ellipse_is_listed_everywhere(variant: str) -> None:
    field, view = gaussians(1), camera()
    field.positions[:], field.log_scales[:], field.opacity_logits[:] = 0.0, 2.0, 3.0
    lists = build_lists(field, view)
    assert lists.tile_counts.tolist() == [9] and lists.entries == 9
    assert lists.records[0, 26] == pytest.approx(0.5 * math.hypot(45, 35))


def test_many_gaussians_are_sorted_over_all_chunks(variant: str) -> None:
    field = gaussians(5000, seed=2, log_scale=-3.5)
    view = camera(100, 80, focal=90.0)
    lists = build_lists(field, view)
    check_lists(lists, torch.zeros(5000, *view.tiles, dtype=torch.bool), torch.ones(view.tiles))
    assert len(np.unique(lists.gid.numpy())) > 3000
