# SPDX-License-Identifier: GPL-3.0-or-later
"""The Prompts panel in the sidebar of the Image Editor."""

import bpy

from ..common import runner
from ..common.job import DONE, RESUMABLE
from ..common.panels import PhotoPanel
from ..common.text import draw_sentence, tr
from ..jobs.engine_messages import in_panel_terms, translate_message
from ..jobs.status_label import draw_job
from ..scene_keys import key_of
from . import overlay, preview, suggest
from .properties import BUILDING, active_photo, marks_control_points


class MGF_UL_photos(bpy.types.UIList):
    """Photos to click on, ticked when they have a point on the building."""

    bl_idname = "MGF_UL_photos"

    def draw_item(self, context, layout, data, item, icon, active_data, active_property, index=0, flt_flag=0):
        split = layout.split(factor=0.85)
        split.label(text=item.name, icon="CHECKBOX_HLT" if item.done() else "CHECKBOX_DEHLT", translate=False)
        entry = overlay.mask_entry(context.scene, item.name)
        weak = entry is not None and not entry.get("used", True)
        count = str(len(item.clicks)) if len(item.clicks) else ""
        open_ = any(click.proposed for click in item.clicks)
        split.label(text=count, icon="ERROR" if weak else "QUESTION" if open_ else "NONE", translate=False)


class MGF_PT_prompts(PhotoPanel, bpy.types.Panel):
    """Show the engine where the building is"""

    bl_idname = "MGF_PT_prompts"
    bl_label = "Prompts"

    def draw(self, context: bpy.types.Context) -> None:
        layout, state = self.layout, context.scene.mgf
        if not len(state.photos):
            draw_sentence(layout, tr("Import a scene in the 3D viewport first"), "INFO")
            return
        row = layout.row(align=True)
        row.scale_y = 1.4
        row.operator("mgf.use_point_tool", icon="CURSOR")
        row.operator("mgf.show_viewport", text="3D View", icon="VIEW3D")  # the way on when all is clicked
        row = layout.row(align=True)
        row.operator("mgf.next_photo", text="Previous", icon="TRIA_LEFT").step = -1
        row.operator("mgf.next_photo", text="Next", icon="TRIA_RIGHT").step = 1
        row = layout.row()
        row.template_list(MGF_UL_photos.bl_idname, "", state, "photos", state, "photo_index", rows=6)
        column = row.column(align=True)
        column.operator("mgf.add_photo", text="", icon="ADD")
        column.operator("mgf.remove_photo", text="", icon="REMOVE")
        column.separator()
        column.operator("mgf.import_prompts", text="", icon="IMPORT")
        column.operator("mgf.export_prompts", text="", icon="EXPORT")
        if marks_control_points(context.scene):  # whose panel, below, needs the room
            draw_sentence(layout, tr("Clicks mark control points"), "TRACKER")
            return
        _draw_proposed(layout, context)
        self._draw_photo(context)
        self._draw_mask(context)

    def _draw_photo(self, context: bpy.types.Context) -> None:
        layout, photo = self.layout, active_photo(context.scene)
        if photo is None:
            return
        layout.prop(context.scene.mgf, "part")
        mine = [c for c in photo.clicks if not c.proposed]
        negative = sum(c.negative for c in mine)
        parts = sum(not c.negative and c.part != BUILDING for c in mine)
        positive = len(mine) - negative - parts
        text = tr("{positive} on it, {negative} off it", positive=positive, negative=negative)
        if parts:
            text += tr(", {count} on parts", count=parts)
        if len(photo.clicks):
            row = layout.row(align=True)
            row.label(text=text, translate=False)
            row.operator("mgf.clear_clicks", text="", icon="TRASH")
        else:
            draw_sentence(layout, tr("Click the building, Ctrl click beside it"), "NONE")
        if not photo.file:
            draw_sentence(layout, tr("The photo was not found on disk"), "ERROR")

    def _draw_mask(self, context: bpy.types.Context) -> None:
        layout, state = self.layout, context.scene.mgf
        layout.separator()
        photo = active_photo(context.scene)
        found = preview.newest(context.scene, photo.name) if photo is not None else None
        row = layout.row(align=True)
        if found is not None and found.status == preview.RUNNING:  # in the button's place: nothing moves meanwhile
            row.label(text="Finding the building", icon="SORTTIME")
            row.operator("mgf.cancel_preview", text="", icon="X")
        else:
            row.operator("mgf.preview_mask", icon="IMAGE_ALPHA")
        row.prop(state, "auto_preview", text="", icon="FILE_REFRESH")
        if found is not None:
            _draw_preview(layout, context.scene, photo, found)
        row = layout.row(align=True)
        row.prop(state, "show_mask")
        sub = row.row(align=True)
        sub.active = state.show_mask
        sub.prop(state, "mask_opacity", text="")


class MGF_PT_masks(PhotoPanel, bpy.types.Panel):
    """Masks of all photos, as the reconstruction will use them"""

    bl_idname = "MGF_PT_masks"
    bl_label = "All Photos"
    bl_parent_id = "MGF_PT_prompts"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return len(context.scene.mgf.photos) > 0 and not marks_control_points(context.scene)

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        layout.operator("mgf.find_masks", icon="RENDERLAYERS")
        key = key_of(context.scene)
        job = runner.live_job(key, RESUMABLE) or runner.last_job(key, ("masks",))
        if job is not None:
            draw_job(layout, job)
        photo = active_photo(context.scene)
        entry = overlay.mask_entry(context.scene, photo.name) if photo is not None else None
        if entry is not None:
            text = tr("Agrees with points: {share:.0%}", share=float(entry.get("score", 0)))
            draw_sentence(layout, text, "NONE")
            if entry.get("flag"):
                draw_sentence(layout, translate_message(str(entry["flag"])), "ERROR")


def _draw_proposed(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw the button that has points proposed, how far that is, and what may be done with them."""
    scene = context.scene
    row = layout.row(align=True)
    row.operator("mgf.suggest_clicks", icon="LIGHT")
    row.prop(scene.mgf, "suggest_at", text="")
    photos = suggest.proposed(scene)
    latest = runner.last_job(key_of(scene), (suggest.KIND,))
    if latest is not None and latest.status != DONE:
        draw_job(layout, latest)
    if not photos:
        return
    count = sum(click.proposed for photo in photos for click in photo.clicks)
    draw_sentence(layout, tr("{count} points proposed in {photos} photos", count=count, photos=len(photos)), "QUESTION")
    row = layout.row(align=True)
    here = row.row(align=True)
    here.enabled = active_photo(scene) in photos
    here.operator("mgf.accept_suggestions", text="Accept Photo", icon="CHECKMARK").every = False
    row.operator("mgf.accept_suggestions", text="Accept All").every = True
    row.operator("mgf.discard_suggestions", text="", icon="TRASH").every = True


def _draw_preview(
    layout: bpy.types.UILayout, scene: bpy.types.Scene, photo: bpy.types.PropertyGroup, found: preview.Preview
) -> None:
    """Say what is wrong with the photo's preview."""
    if found.status == preview.FAILED:
        draw_sentence(layout, translate_message(in_panel_terms(found.text)), "ERROR")
    elif (
        found.status == preview.DONE
        and found.clicks != preview.signature(photo)
        and preview.shares_clicks(found, photo)  # else it is not shown
        and not overlay.job_knows(scene, photo)
    ):
        draw_sentence(layout, tr("The points have changed since this mask"), "INFO")


CLASSES = (MGF_UL_photos, MGF_PT_prompts, MGF_PT_masks)


register, unregister = bpy.utils.register_classes_factory(CLASSES)
