# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of kernel times: every part of every variant is timed, and ratios to plain torch are given."""

from __future__ import annotations

import json

import pytest
import torch

from benchmarks import kernels, torch_tiles
from mgf_engine.field.synthetic import corner_view, synthetic_building
from mgf_engine.native import library
from mgf_engine.raster import cpu


def test_every_part_of_every_variant_is_timed(capsys: pytest.CaptureFixture[str]) -> None:
    sizes = ["--gaussians", "300", "--sizes", "96x64", "--outputs", "all"]
    assert kernels.main([*sizes, "--rounds", "1", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    (scene,) = found["scenes"]
    assert set(scene["variants"]) == set(library.runnable_variants())
    for clock in scene["variants"].values():
        assert set(clock["cpu"]) == set(kernels.PARTS) and min(clock["wall"].values()) > 0
    # Dozens on any processor.
    assert all(
        found[f"{name}ratio_to_{to}"] > 5
        for name, to in (("", "reference"), ("", "torch_tiles"), ("losses_", "reference"))
    )


def test_the_yardstick_in_torch_draws_what_the_kernels_draw() -> None:
    """Or the ratio would compare two different things; gradients as far as the sums over a list show them."""
    raw, camera = cpu.Parameters.of_field(synthetic_building(400, size=0.08)), corner_view(60, 44)
    lists = cpu.list_tiles(raw, camera, 1, None)
    image, hits = cpu.blend(lists, geometry=True)
    records = lists.records.clone().requires_grad_()
    drawn = torch_tiles.blend(lists, records, camera.near, camera.far)
    ours = torch.cat([image[0:5], image[6:10]])[:, : camera.height, : camera.width]
    assert float(image[3].max()) > 0.9 and float(image[9].max()) > 0
    for plane, (a, b) in enumerate(zip(ours, drawn.detach()[:, : camera.height, : camera.width], strict=True)):
        far = (a - b).abs() / a.abs().max()
        assert float(far.flatten().kthvalue(int(0.999 * far.numel())).values) < 1e-3, plane
    weights = torch.zeros_like(drawn)
    weights[0, : camera.height, : camera.width] = 1
    (drawn * weights).sum().backward()
    color = torch.zeros(3, camera.height, camera.width)
    color[0] = 1
    gradients = cpu.OutputGradients(color, None, None, None, None, None)
    back = cpu.project_backward(
        raw, 1, lists, hits, cpu.blend_backward(lists, image, hits, gradients, None, False), 0, None
    )
    shown = lists.tile_counts > 0
    # The gradient of the red constant harmonic is that of the record's red, times a number.
    red, harmonic = records.grad[shown, 14], back[4][shown, 0, 0]
    kept = (harmonic != 0) & (red.abs() > 1e-3)
    share = harmonic[kept] / red[kept]
    assert int(kept.sum()) > 50 and float((share - share.median()).abs().max()) < 1e-3
