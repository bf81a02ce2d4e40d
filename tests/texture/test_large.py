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


@pytest.mark.slow
def test_five_hundred_photos_stay_below_3_gb() -> None:
    """A photo of 24 megapixels is 72 MB: memory that grows by a tenth of the opened ones would be too much."""
    found = measured(500)
    assert found["painted"] > 200  # the others show nothing that these do not show
    assert found["peak"] < 3e9
