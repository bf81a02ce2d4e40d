# SPDX-License-Identifier: GPL-3.0-or-later
"""The texture of photos of 24 megapixels stays below 3 GB however many there are (docs/scale.md has 500)."""

from __future__ import annotations

import json
import subprocess
import sys


def measured(photos: int) -> dict[str, float]:
    """What ``benchmarks.stability_texture`` prints, in a process of its own."""
    command = [sys.executable, "-m", "benchmarks.stability_texture", "--photos", str(photos), "--rounds", "5"]
    run = subprocess.run(command, capture_output=True, text=True, check=True, timeout=600)
    return json.loads(run.stdout.splitlines()[-1])


def test_memory_does_not_grow_with_the_number_of_photos() -> None:
    few, many = measured(12), measured(36)
    assert many["painted"] > 0.8 * 36 and few["painted"] > 0.8 * 12
    assert many["peak"] < 3e9
    # A photo of 24 megapixels is 72 MB, and 24 more of them are opened; what may grow are masks and working photos.
    assert many["peak"] - few["peak"] < 24 * 72e6 / 4
