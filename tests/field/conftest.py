# SPDX-License-Identifier: GPL-3.0-or-later
"""The textured wall of :mod:`tests.wall` for the tests of the field."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
from support import wall

from mgf_engine.model.masks import MaskSet
from mgf_engine.model.scene import Scene


@pytest.fixture
def make_wall(tmp_path: Path) -> Callable[..., tuple[Scene, MaskSet]]:
    """A function that makes the scene: ``make_wall(centres, rolls)``."""
    return partial(wall.make_wall, tmp_path)
