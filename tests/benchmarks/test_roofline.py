# SPDX-License-Identifier: GPL-3.0-or-later
"""The roofline: limits are measured, kernels stay below them, and counted pairs are pairs that were blended."""

from __future__ import annotations

import json

import numpy as np
import pytest

from benchmarks import roofline
from mgf_engine.field.synthetic import corner_view, synthetic_building
from mgf_engine.native import library
from mgf_engine.raster import cpu


def test_kernels_stay_below_what_the_processor_can_do() -> None:
    found = roofline.measure(2000, 96, 64, rounds=2)
    assert found.variant == library.variant()
    assert found.peak > 1 and found.bandwidth > 0.1
    assert [kernel.name for kernel in found.kernels] == list(roofline.OPERATIONS)
    for kernel in found.kernels:
        assert 0 < kernel.share < 1
        assert kernel.operations == roofline.OPERATIONS[kernel.name] * kernel.pairs


def test_pairs_hold_every_pixel_that_took_a_gaussian() -> None:
    field, camera = synthetic_building(300), corner_view(96, 64)
    raw = cpu.Parameters.of_field(field)
    image, _ = cpu.blend(cpu.list_tiles(raw, camera, 2, None), geometry=True)
    covered = int((image[3] > 0).sum())
    pairs = roofline.measure(300, 96, 64, rounds=1).kernels[0].pairs
    assert covered <= pairs <= 300 * 96 * 64


@pytest.mark.parametrize("variant", library.runnable_variants())
def test_the_peak_of_wider_vectors_is_measured_with_the_variant_itself(variant: str) -> None:
    library.use_variant(variant)
    try:
        result = np.zeros(1, np.float32)
        library.parallel("mgf_peak", 2, result)
        # x -> 0.9999 x + 1e-4 leaves 1 where it is and draws every chain towards it.
        chains = library.call("mgf_peak_operations") >> 21
        assert result[0] == pytest.approx(chains, rel=0.01)
    finally:
        library.use_variant("")


def test_the_command_prints_plain_figures(capsys: pytest.CaptureFixture[str]) -> None:
    assert roofline.main(["--gaussians", "200", "--size", "64x48", "--rounds", "1", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert {entry["variant"] for entry in found} == set(library.runnable_variants())
