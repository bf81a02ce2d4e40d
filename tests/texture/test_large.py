# SPDX-License-Identifier: GPL-3.0-or-later
"""The texture of photos of 24 megapixels stays below 3 GB however many there are (docs/scale.md has 500)."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest


def measured(photos: int) -> dict[str, float]:
    """What ``benchmarks.stability_texture`` prints, in a process of its own."""
    command = [sys.executable, "-m", "benchmarks.stability_texture", "--photos", str(photos), "--rounds", "5"]
    run = subprocess.run(command, capture_output=True, text=True, check=True, timeout=1800)
    return json.loads(run.stdout.splitlines()[-1])


def test_memory_does_not_grow_with_the_number_of_photos() -> None:
    few, many = measured(12), measured(36)
    assert many["painted"] > 0.8 * 36 and few["painted"] > 0.8 * 12
    assert many["peak"] < 3e9
    # A photo of 24 megapixels is 72 MB, and 24 more of them are opened; what may grow are masks and working photos.
    assert many["peak"] - few["peak"] < 24 * 72e6 / 4


@pytest.mark.slow
def test_five_hundred_photos_stay_below_3_gb() -> None:
    found = measured(500)
    assert found["painted"] > 200  # the others show nothing that these do not show
    assert found["peak"] < 3e9
