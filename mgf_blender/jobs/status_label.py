# SPDX-License-Identifier: GPL-3.0-or-later
"""Draw the state of a job: its progress and its latest picture, or how it ended and what it left."""

from pathlib import Path

import bpy

from ..common import options, runner
from ..common.job import CANCELLED, CANCELLING, DONE, FAILED, NO_ENGINE, QUEUED, RESUMABLE, Job
from ..common.stats import draw_figures
from ..common.text import N_, draw_sentence, format_duration, tr, widest
from .engine_messages import CONTACT_SHEET, in_panel_terms, is_passing, translate_message

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
#: Separators without height before the bar. When the layout changes, Blender 4 takes the first label or box for the bar
#: that the pointer lies on, and draws it as a bar, unless there was something else before it to take it for.
_SPARES = 40
#: What is shown while a command runs that is no stage.
_TOOLS = {
    "drawings": N_("Drawings"), "models": N_("Models"), "georef": N_("Georeference"), "suggest": N_("Proposing points"),
}  # fmt: skip


def draw_job(layout: bpy.types.UILayout, job: Job) -> None:
    """Draw the progress of a running job, or how the last one ended."""
    box = layout.box().column(align=True)
    if job.live:
        for _ in range(_SPARES):
            box.separator(factor=0.0)
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
    warnings = [text for text in job.warnings if job.status != DONE or not is_passing(text)]
    for text in warnings[-3:]:
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
