# SPDX-License-Identifier: GPL-3.0-or-later
"""The Georeference panel of the 3D viewport, and the list of control points in the Image Editor."""

from __future__ import annotations

import math

import bpy

from ..common.panels import PhotoPanel
from ..common.text import N_, draw_sentence, tr
from ..engine.status_label import draw_engine_missing
from ..job_folder import has_job_file, job_folder
from ..jobs.finished_job import FinishedJobPanel, draw_run
from ..scene_import.imported_scene import ImportedScene
from . import files, place
from .properties import active_point

_BY = {
    "marks": N_("Known by its own marks"),
    "other points": N_("Known by other points"),
    "georeference": N_("Roughly known by GPS"),
    "": N_("Not known yet; mark it in two photos"),
}


class MGF_PT_georef(FinishedJobPanel, bpy.types.Panel):
    """True coordinates of the finished job: by GPS, control points or scale bars"""

    bl_idname = "MGF_PT_georef"
    bl_label = "Georeference"

    def draw(self, context: bpy.types.Context) -> None:
        layout, scene = self.layout, context.scene
        state = scene.mgf.georef
        layout.use_property_split = True
        layout.use_property_decorate = False
        column = layout.column()
        column.prop(state, "crs")
        column.prop(state, "control_file")
        column.prop(state, "scale_bars")
        if draw_engine_missing(layout):
            return
        if not (state.crs or state.control_file or state.scale_bars):
            text = tr("Photos with GPS need nothing; else choose a CSV of control points: name, east, north, height")
            draw_sentence(layout, text, "INFO")
        if state.control_file:
            row = layout.row(align=True)
            row.operator("mgf.predict_places", icon="FILE_REFRESH")
            row.operator("mgf.mark_control_points", text="Mark Points", icon="CURSOR")
        if len(state.points):
            text = tr("{points} points, {marks} marks", points=len(state.points), marks=len(state.marks))
            draw_sentence(layout, text, "TRACKER")
        second = ("mgf.use_in_reconstruction", "HOME") if len(state.marks) else None
        if draw_run(layout, scene, ("georef", "places"), "mgf.georeference", "WORLD", second):
            _draw_residuals(layout, files.read_residuals(job_folder(scene)))
            _draw_place(layout, scene)


def _draw_residuals(layout: bpy.types.UILayout, residuals: list[files.PointResiduals]) -> None:
    """Draw the residuals of the points, in millimeters and pixels; check points are marked with a ring."""
    if not residuals:
        return
    box = layout.box().column(align=True)
    _draw_cells(box, (tr("mm"), tr("East"), tr("North"), tr("Up"), tr("px")), "BLANK1")
    for row in residuals:
        values = [_number(1000 * v, "+.0f") for v in row.residual]
        icon = "ERROR" if row.note else "RADIOBUT_OFF" if row.role == "check" else "RADIOBUT_ON"
        _draw_cells(box, (row.name, *values, _number(row.pixels, ".1f")), icon)
    for role, title in (("control", N_("Control")), ("check", N_("Check"))):
        error = files.rmse(residuals, role)
        if error is not None:
            draw_sentence(box, tr("{role}: RMSE {total:.1f} mm", role=tr(title), total=1000 * error), "BLANK1")


def _draw_cells(layout: bpy.types.UILayout, cells: tuple[str, ...], icon: str) -> None:
    split = layout.split(factor=0.3)
    split.label(text=cells[0], icon=icon, translate=False)
    row = split.row(align=True)
    for cell in cells[1:]:
        row.label(text=cell, translate=False)


def _number(value: float, form: str) -> str:
    return format(value, form) if math.isfinite(value) else "–"


def _draw_place(layout: bpy.types.UILayout, scene: bpy.types.Scene) -> None:
    """Draw what the job knows of its place, and whether the scene lies there."""
    found, imported = files.read_placement(job_folder(scene)), ImportedScene.find(scene)
    if found is None or imported is None:
        return
    if not found.metric:
        text = tr("Scale and place are still unknown; give control points or scale bars")
        draw_sentence(layout, text, "INFO")
        return
    if place.is_placed(scene, imported, found):
        east, north, height = found.offset
        where = found.crs or tr("Local frame")
        draw_sentence(layout, tr("In true coordinates: {where}", where=where), "CHECKMARK")
        if any(found.offset):
            text = tr("Origin at {east:.0f}, {north:.0f}, {height:.0f}", east=east, north=north, height=height)
            draw_sentence(layout, text, "BLANK1")
    else:
        layout.operator("mgf.place_scene", icon="ORIENTATION_GLOBAL")


class MGF_UL_control_points(bpy.types.UIList):
    """Control points with the number of their marks."""

    bl_idname = "MGF_UL_control_points"

    def draw_item(self, context, layout, data, item, icon, active_data, active_property, index=0, flt_flag=0):
        split = layout.split(factor=0.8)
        sign = "RADIOBUT_OFF" if item.role == "check" else "RADIOBUT_ON"
        split.label(text=item.name, icon=sign, translate=False)
        count = sum(mark.point == item.name for mark in context.scene.mgf.georef.marks)
        split.label(text=str(count) if count else "", translate=False)


class MGF_PT_control_points(PhotoPanel, bpy.types.Panel):
    """Mark control points in the photos"""

    bl_idname = "MGF_PT_control_points"
    bl_label = "Control Points"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return len(context.scene.mgf.georef.points) > 0

    def draw(self, context: bpy.types.Context) -> None:
        layout, scene = self.layout, context.scene
        state = scene.mgf.georef
        row = layout.row(align=True)
        row.scale_y = 1.4
        row.prop(state, "marking", icon="TRACKER", toggle=True)
        row.operator("mgf.show_viewport", text="", icon="VIEW3D")
        if not state.marking:
            return
        row = layout.row()
        row.template_list(MGF_UL_control_points.bl_idname, "", state, "points", state, "index", rows=6)
        column = row.column(align=True)
        column.operator("mgf.import_marks", text="", icon="IMPORT")
        column.operator("mgf.export_marks", text="", icon="EXPORT")
        row = layout.row(align=True)
        row.operator("mgf.next_marked_photo", text="Previous", icon="TRIA_LEFT").step = -1
        row.operator("mgf.next_marked_photo", text="Next", icon="TRIA_RIGHT").step = 1
        self._draw_point(context)
        row = layout.row(align=True)
        row.operator("mgf.predict_places", text="Predict Places", icon="TRACKING_FORWARDS_SINGLE")
        row.prop(state, "follow", text="", icon="FILE_REFRESH")

    def _draw_point(self, context: bpy.types.Context) -> None:
        layout, scene = self.layout, context.scene
        point = active_point(scene)
        if point is None:
            return
        known = files.read_known_points(job_folder(scene)).get(point.name) if has_job_file(scene) else None
        text = tr(_BY.get(known.by if known is not None else "", _BY[""]))
        if known is not None and known.pixels is not None:
            text += tr(", {pixels:.1f} px", pixels=known.pixels)
        draw_sentence(layout, text, "INFO")
        for photo in known.wrong if known is not None else ():
            draw_sentence(layout, tr("The mark in {photo} contradicts the others", photo=photo), "ERROR")


CLASSES = (MGF_PT_georef, MGF_UL_control_points, MGF_PT_control_points)


register, unregister = bpy.utils.register_classes_factory(CLASSES)
