# SPDX-License-Identifier: GPL-3.0-or-later
"""The Town panel in the sidebar of the 3D viewport."""

import bpy

from ..common.panels import SidebarPanel
from ..common.text import draw_sentence, tr
from ..scene_import.imported_scene import objects_below
from .load import BUILDING_KEY, JOB_KEY, find_town
from .operators import chosen_buildings, is_full


class MGF_PT_town(SidebarPanel, bpy.types.Panel):
    """A town of many buildings, made by mgf town"""

    bl_idname = "MGF_PT_town"
    bl_label = "Town"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        layout.operator("mgf.import_town", icon="IMPORT")
        top = find_town(context.scene)
        if top is None:
            return
        buildings = [obj for obj in objects_below(top) if JOB_KEY in obj]
        full = sum(is_full(obj) for obj in buildings)
        draw_sentence(layout, tr("{count} buildings, {full} in full", count=len(buildings), full=full), "HOME")
        chosen = chosen_buildings(context)
        if len(chosen) == 1:
            name, confidence = chosen[0][BUILDING_KEY], chosen[0].get("confidence")
            text = name if confidence is None else tr("{name}: confidence {value:.2f}", name=name, value=confidence)
            draw_sentence(layout, text, "OBJECT_DATA")
        row = layout.row(align=True)
        row.operator("mgf.show_full_building", icon="MESH_ICOSPHERE")
        row.operator("mgf.show_light_building", text="", icon="MESH_CUBE")


CLASSES = (MGF_PT_town,)


register, unregister = bpy.utils.register_classes_factory(CLASSES)
