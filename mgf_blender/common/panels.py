# SPDX-License-Identifier: GPL-3.0-or-later
"""Where our panels appear: mixins that stand before ``bpy.types.Panel`` among the bases."""

from .text import CONTEXT


class SidebarPanel:
    """In the sidebar of the 3D viewport, on our tab."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "MGF"
    bl_translation_context = CONTEXT


class PhotoPanel:
    """In the sidebar of the Image Editor, which shows a photo, on our tab."""

    bl_space_type = "IMAGE_EDITOR"
    bl_region_type = "UI"
    bl_category = "MGF"
    bl_translation_context = CONTEXT
