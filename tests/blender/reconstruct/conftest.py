# SPDX-License-Identifier: GPL-3.0-or-later
"""A scene that is ready for its job."""

from __future__ import annotations

import bpy
import pytest


@pytest.fixture
def ready(addon, engine, house):
    """An imported house with one click, and an engine whose result is the finished job."""
    engine("ok", FAKE_RESULT=house.job)
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    addon.job_folder = str(house.folder.parent / "new job")
    click = addon.photos[0].clicks.add()
    click.uv = (100.5, 80.25)
    return addon
