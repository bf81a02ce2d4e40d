# SPDX-License-Identifier: GPL-3.0-or-later
"""The environment these tests need."""

from __future__ import annotations

import pytest

bpy = pytest.importorskip("bpy", reason="bpy is not installed in this environment")


def test_blender_is_one_the_extension_supports():
    assert bpy.app.version >= (4, 2, 0)
