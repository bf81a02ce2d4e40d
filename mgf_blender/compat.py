# SPDX-License-Identifier: GPL-3.0-or-later
"""Differences between the Blender versions that the add-on runs in (4.2 LTS to 5.x)."""

from __future__ import annotations

import bpy

#: Render engine id of EEVEE.
EEVEE = "BLENDER_EEVEE" if bpy.app.version >= (5, 0, 0) else "BLENDER_EEVEE_NEXT"
#: Options of a property that holds a path: from 5.0 on Blender wants to be told that ``//`` may begin it.
PATH = {"PATH_SUPPORTS_BLEND_RELATIVE"} if bpy.app.version >= (5, 0, 0) else set()
