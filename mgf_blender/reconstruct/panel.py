# SPDX-License-Identifier: GPL-3.0-or-later
"""The Reconstruct panel: options, the button that starts a job, progress, and the outcome of the last job."""

from pathlib import Path

import bpy

from ..common import options, runner
from ..common.job import CANCELLED, CANCELLING, DONE, FAILED, NO_ENGINE, QUEUED, RESUMABLE, Job
from ..common.panels import SidebarPanel
from ..common.stats import draw_figures
from ..common.text import N_, draw_sentence, tr, widest
from ..engine.status_label import draw_engine_missing
from ..job_folder import has_job_file
from .engine_messages import CONTACT_SHEET, in_panel_terms, translate_message
from .estimate import estimate, format_duration, photos_of
from .operators import finding_cameras, interrupted, last_job

_DONE = {
    "reconstruct": N_("Mesh finished in {time}"),
    "masks": N_("Masks found in {time}"),
    "scene": N_("Cameras found in {time}"),
    "drawings": N_("Drawings finished in {time}"),
    "models": N_("Models finished in {time}"),
    "georef": N_("Georeference finished in {time}"),
    "places": N_("Control points read in {time}"),
    "suggest": N_("Points proposed in {time}"),
}
#: Parts of the starting surface, before the training, by the engine's names.
_START = {
    "views": N_("Reading masks"), "lines": N_("Finding edges"), "dense": N_("Matching photos"),
    "planes": N_("Finding planes"), "cut": N_("Making the surface"),
}  # fmt: skip
#: What is shown while a command runs that is no stage.
_TOOLS = {
    "drawings": N_("Drawings"), "models": N_("Models"), "georef": N_("Georeference"), "suggest": N_("Proposing points"),
}  # fmt: skip
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
            elif not option["advanced"]:
                column.prop(state.options, name)
        column.prop(state, "job_folder")
        column.prop(state, "import_when_done")
        if draw_engine_missing(layout):
            return
        job = last_job(context.scene)
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
    """Every option of the engine"""

    bl_idname = "MGF_PT_options"
    bl_label = "Advanced Options"
    bl_parent_id = "MGF_PT_reconstruct"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        layout, state = self.layout, context.scene.mgf
        layout.use_property_split = True
        layout.use_property_decorate = False
        for section, heading in options.SECTIONS.items():
            names = [n for n, o in options.OPTIONS.items() if o["section"] == section and o["advanced"]]
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


def draw_job(layout: bpy.types.UILayout, job: Job) -> None:
    """Draw the progress of a running job, or how the last one ended."""
    box = layout.box().column(align=True)
    if job.live:
        row = box.row(align=True)
        row.progress(factor=job.overall, text=_headline(job), translate=False)
        row.operator("mgf.cancel_job", text="", icon="X")
    else:
        icon = {DONE: "CHECKMARK", FAILED: "ERROR", CANCELLED: "PAUSE"}.get(job.status, "INFO")
        draw_sentence(box, _outcome(job), icon)
    if job.status == FAILED and job.text == tr(NO_ENGINE):
        layout.operator("mgf.show_preferences", icon="PREFERENCES")
    _draw_buttons(box, job)  # above what comes and goes, or they would move under the pointer
    if job.live:
        figures = {name: value for name, value in job.figures.items() if name != "start"}  # which the bar says
        draw_figures(box, dict(list(figures.items())[:6]))
    for text in job.warnings[-3:]:
        draw_sentence(box, translate_message(in_panel_terms(text)), "INFO")


def _draw_buttons(layout: bpy.types.UILayout, job: Job) -> None:
    """Draw the ways to what a job shows: its latest picture, its masks, its log, its report."""
    row = layout.row(align=True)
    if job.live and job.preview:
        text = N_("Show Render") if job.preview_stage == "field" else N_("Show Masks")
        row.operator("mgf.show_preview", text=text, icon="IMAGE_DATA")
    if job.kind in RESUMABLE:
        _draw_file_button(row, job.folder, "log.txt", N_("Open Log"), "TEXT")
    if job.status == DONE and job.kind == "reconstruct":
        _draw_file_button(row, job.folder, "report.html", N_("Open Report"), "URL")
    if job.status == DONE and job.kind in {"reconstruct", "masks"} and CONTACT_SHEET in " ".join(job.warnings):
        _draw_file_button(layout, job.folder, "masks/contact_sheet.jpg", N_("Open Contact Sheet"), "IMAGE_DATA")


def _draw_file_button(layout: bpy.types.UILayout, folder: Path, name: str, text: str, icon: str) -> None:
    """Draw a button that opens a file of a job, once there is one: Blender keeps a button grey that was so when the
    pointer came to rest on it, as it does on this one after the job was started."""
    if (folder / name).is_file():
        button = layout.operator("mgf.open_job_file", text=text, icon=icon)
        button.name, button.directory = name, str(folder)


def _headline(job: Job) -> str:
    if job.status == QUEUED:
        ahead = sum(j.live for j in runner.jobs()) - 1
        return tr("Waiting for another job") if ahead == 1 else tr("Waiting for {count} other jobs", count=ahead)
    if job.status == CANCELLING:
        return tr("Stopping")
    if not job.stage:
        return tr("Starting the engine")
    part = _START.get(str(job.figures.get("start")))
    stage, left = tr(part or {**options.STAGES, **_TOOLS}.get(job.stage, job.stage)), format_duration(job.seconds_left)
    if not left:
        return tr("{stage}, {share:.0%}", stage=stage, share=job.overall)
    texts = (N_("{stage}, {share:.0%}, {time} left"), N_("{stage}, {time} left"), N_("{share:.0%}, {time} left"))
    return widest(tr(text, stage=stage, share=job.overall, time=left) for text in texts)


def _outcome(job: Job) -> str:
    """Return how a job ended."""
    if job.text or job.status != DONE:
        return translate_message(in_panel_terms(job.text)) if job.text else tr("Cancelled")
    return tr(_DONE.get(job.kind, _DONE["reconstruct"]), time=format_duration(job.seconds))


CLASSES = (MGF_PT_mark, MGF_PT_reconstruct, MGF_PT_options)


register, unregister = bpy.utils.register_classes_factory(CLASSES)
