# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of kernel times: every part of every variant is timed, and ratios to plain torch are given."""

from __future__ import annotations

import json

import pytest

from mgf_engine.bench import kernels
from mgf_engine.raster import library


def test_every_part_of_every_variant_is_timed(capsys: pytest.CaptureFixture[str]) -> None:
    sizes = ["--gaussians", "300", "--sizes", "96x64", "--heads", "all"]
    assert kernels.main([*sizes, "--rounds", "1", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    (scene,) = found["scenes"]
    assert set(scene["variants"]) == set(library.runnable_variants())
    for clock in scene["variants"].values():
        assert set(clock["cpu"]) == set(kernels.PARTS) and min(clock["wall"].values()) > 0
    assert found["ratio_to_twin"] > 5 and found["losses_ratio_to_twin"] > 5  # dozens on any processor
