# SPDX-License-Identifier: GPL-3.0-or-later
"""The Reconstruct panel: options, the button that starts a job, progress, and the outcome of the last job."""

import bpy

from ..common import options, runner
from ..common.job import DONE, Job
from ..common.panels import SidebarPanel
from ..common.text import draw_sentence, format_duration, tr
from ..engine.status_label import draw_engine_missing
from ..job_folder import has_job_file
from ..jobs.status_label import draw_job
from ..scene_import.panel import finding_cameras
from ..scene_keys import key_of
from .estimate import estimate, photos_of
from .operators import interrupted

_NAME_LETTERS = 14  # of an option's name that Blender's own layout has room for, in a sidebar of the default width
_LONG_NAME = 0.48  # share of the width for a longer one


class MGF_PT_mark(SidebarPanel, bpy.types.Panel):
    """Where the building is: the way to the photos, and how many are marked"""

    bl_idname = "MGF_PT_mark"
    bl_label = "Prompts"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return len(context.scene.mgf.photos) > 0

    def draw(self, context: bpy.types.Context) -> None:
        layout, state = self.layout, context.scene.mgf
        if state.masks_folder or not state.options.use_masks:
            text = tr("Your own masks are used") if state.masks_folder else tr("Masks are switched off")
            draw_sentence(layout, text, "INFO")
            return
        done, count = sum(p.done() for p in state.photos), len(state.photos)
        row = layout.row()
        row.scale_y = 1.0 if done else 1.6
        row.operator("mgf.mark_building", icon="CURSOR")
        text = tr("{done} of {count} photos marked", done=done, count=count)
        draw_sentence(layout, text, "CHECKMARK" if done else "INFO")


class MGF_PT_reconstruct(SidebarPanel, bpy.types.Panel):
    """Start, watch and resume the reconstruction"""

    bl_idname = "MGF_PT_reconstruct"
    bl_label = "Reconstruct"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return bool(context.scene.mgf.source) and finding_cameras(context.scene) is None  # which the Scene panel shows

    def draw(self, context: bpy.types.Context) -> None:
        layout, state = self.layout, context.scene.mgf
        layout.use_property_split = True
        layout.use_property_decorate = False
        column = layout.column()
        for name, option in options.OPTIONS.items():
            if name == "memory":
                _draw_memory(column, state)
            elif option["level"] == "basic":
                column.prop(state.options, name)
        column.prop(state, "job_folder")
        column.prop(state, "import_when_done")
        if draw_engine_missing(layout):
            return
        job = runner.last_job(key_of(context.scene))
        live = job is not None and job.live
        if not live:
            self._draw_start(layout, context, job)
        if job is not None:
            draw_job(layout, job)

    def _draw_start(self, layout: bpy.types.UILayout, context: bpy.types.Context, job: Job | None) -> None:
        state = context.scene.mgf
        cost = estimate(state.options, photos_of(context.scene))
        text = tr(
            "About {time}, {gigabytes:.1f} GB of memory",
            time=format_duration(cost.seconds),
            gigabytes=cost.memory / 1e9,
        )
        draw_sentence(layout, text, "TIME")
        column = layout.column()
        column.scale_y = 1.6
        column.operator("mgf.reconstruct", icon="HOME")
        if job is None and interrupted(context.scene):
            draw_sentence(layout, tr("An earlier job was interrupted"), "INFO")
            layout.operator("mgf.resume", icon="PLAY")
        elif job is not None and job.status != DONE and has_job_file(context.scene, "job.json"):
            layout.operator("mgf.resume", icon="PLAY")


class MGF_PT_options(SidebarPanel, bpy.types.Panel):
    """More options of the engine; those for experiments are shown with Developer Extras"""

    bl_idname = "MGF_PT_options"
    bl_label = "Advanced Options"
    bl_parent_id = "MGF_PT_reconstruct"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        layout, state = self.layout, context.scene.mgf
        layout.use_property_split = True
        layout.use_property_decorate = False
        shown = _shown_options(state.options, context.preferences.view.show_developer_ui)
        for section, heading in options.SECTIONS.items():
            names = [name for name in shown if options.OPTIONS[name]["section"] == section]
            if not names:
                continue
            header, body = layout.panel(f"MGF_options_{section}", default_closed=True)
            header.label(text=tr(heading), translate=False)
            if body is not None:
                column = body.column()
                for name in names:
                    if name == "crop_box":  # an object in the viewport stands for it
                        continue
                    _draw_option(column, state.options, name)
                if section == "masks":
                    column.prop(state, "masks_folder")
        layout.operator("mgf.reset_options", icon="LOOP_BACK")


def _shown_options(values: bpy.types.PropertyGroup, experts: bool) -> list[str]:
    """Return the options that the panel shows: also one for experts that is changed, as by a job that goes on."""
    changed = options.changed(values)
    levels = ("advanced", "expert") if experts else ("advanced",)
    return [
        name
        for name, option in options.OPTIONS.items()
        if option["level"] in levels or (option["level"] == "expert" and name in changed)
    ]


def _draw_option(layout: bpy.types.UILayout, values: bpy.types.PropertyGroup, name: str) -> None:
    """Draw an option; a long name gets more of the width than Blender gives it, and the value less."""
    title = tr(options.title(name))
    if options.OPTIONS[name]["type"] == "bool" or len(title) <= _NAME_LETTERS:
        layout.prop(values, name)
        return
    split = layout.split(factor=_LONG_NAME)
    split.use_property_split = False
    label = split.row()
    label.alignment = "RIGHT"
    label.label(text=title, translate=False)
    split.prop(values, name, text="")


def _draw_memory(layout: bpy.types.UILayout, state: bpy.types.PropertyGroup) -> None:
    """Draw the limit of the memory: a number alone would say 0 where there is none."""
    row = layout.row(align=True, heading="Memory (GB)")
    row.prop(state, "limit_memory", text="")
    value = row.row(align=True)
    value.active = state.limit_memory
    value.prop(state.options, "memory", text="")


CLASSES = (MGF_PT_mark, MGF_PT_reconstruct, MGF_PT_options)


register, unregister = bpy.utils.register_classes_factory(CLASSES)
