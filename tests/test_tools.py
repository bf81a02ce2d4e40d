# SPDX-License-Identifier: GPL-3.0-or-later
"""The scripts under ``tools`` agree with the packages they speak of."""

from __future__ import annotations

import runpy
from pathlib import Path

from mgf_engine.raster.build import TARGETS


def test_the_extension_carries_the_engine_for_every_target() -> None:
    script = runpy.run_path(str(Path(__file__).parents[1] / "tools" / "build_extension.py"), run_name="tools")
    assert set(script["ALL_TARGETS"]) == set(TARGETS)
