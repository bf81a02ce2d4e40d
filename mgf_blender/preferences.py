# SPDX-License-Identifier: GPL-3.0-or-later
"""Preferences: where the engine comes from, and how it is doing."""

import re

import bpy

from .common.addon import NAME
from .common.text import N_, draw_sentence, draw_value, in_our_words, tr
from .engine import current_task
from .engine.environment import managed_environment, python_of
from .engine.install import TICKS, has_nvidia
from .engine.swap import discarding, unfinished
from .engine.task import CANCELLED, DONE, FAILED, RUNNING

#: What the engine's report says where all is well, and of a segmenter without weights.
_ALL_WELL = N_("Everything a job needs is here.")
_NO_WEIGHTS = re.compile(
    r"random walker, which needs no weights; 'mgf weights' fetches those of EfficientSAM, the paper's segmenter "
    r"\((.*)\)"
)


def _other_engine(prefs: bpy.types.AddonPreferences, context: bpy.types.Context) -> None:
    """Forget what the last check said, which was about the engine before."""
    current_task.forget()


class MGF_Preferences(bpy.types.AddonPreferences):
    """What the add-on keeps for the user."""

    bl_idname = NAME

    engine_source: bpy.props.EnumProperty(
        name="Engine",
        description="Environment of the engine",
        items=[
            ("MANAGED", "Installed Here", "Use the environment made by Install Engine"),
            ("EXISTING", "Existing Environment", "Use a Python environment that has the engine already"),
        ],
        default="MANAGED",
        update=_other_engine,
    )
    engine_path: bpy.props.StringProperty(
        name="Environment",
        description="Virtual environment with the engine, or its Python executable",
        subtype="FILE_PATH",
        update=_other_engine,
    )
    wheel_folder: bpy.props.StringProperty(
        name="Wheel Folder",
        description="Install from the wheels in this folder and use no network",
        subtype="DIR_PATH",
    )
    torch_build: bpy.props.EnumProperty(
        name="Torch",
        description="Build of torch to install",
        items=[
            ("AUTO", "Automatic", "The CUDA build where an NVIDIA driver is found, else the CPU build"),
            ("CPU", "CPU", "The small build without GPU support"),
            ("CUDA", "CUDA", "The large build for NVIDIA GPUs"),
        ],
        default="AUTO",
    )
    default_index: bpy.props.BoolProperty(
        name="Use the Configured Package Index",
        description="Install torch from the package index configured on this machine, whichever build it offers",
        default=False,
    )
    install_weights: bpy.props.BoolProperty(
        name="EfficientSAM Weights (41 MB, Apache-2.0)",
        description="Also install the weights of EfficientSAM, the paper's segmenter; without them a random walker "
        "makes the masks",
        default=True,
    )
    install_survey: bpy.props.BoolProperty(
        name="Drawings and Map Coordinates",
        description="Install what drawings and map coordinates need, too: rasterio, ezdxf, pyproj, pyceres",
        default=False,
    )
    install_models: bpy.props.BoolProperty(
        name="Models",
        description="Install what models need, too: levels of detail, 3D Tiles, IFC, USD, LAZ (xatlas, "
        "fast-simplification, DracoPy, ifcopenshell, usd-core, laspy)",
        default=False,
    )
    weights_folder: bpy.props.StringProperty(
        name="Mask Weights",
        description="Folder of the weights of the mask model; empty uses the engine's cache folder",
        subtype="DIR_PATH",
    )

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.row().prop(self, "engine_source", expand=True)
        if self.engine_source == "EXISTING":
            layout.prop(self, "engine_path")
        else:
            self._draw_install(layout, context)
        self._draw_task(layout)
        layout.separator()
        row = layout.row(align=True)
        row.prop(self, "weights_folder")
        row.operator("mgf.download_weights", text="", icon="IMPORT")

    def _draw_install(self, layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
        column = layout.column()
        column.prop(self, "torch_build")
        column.prop(self, "wheel_folder")
        column.prop(self, "default_index")
        column = layout.column(heading="Also Install")
        column.prop(self, "install_weights")
        column.prop(self, "install_survey")
        column.prop(self, "install_models")
        there = python_of(managed_environment()).is_file()
        row = layout.row(align=True)
        text = N_("Reinstall Engine") if there else N_("Install Engine")
        row.operator("mgf.install_engine", text=text, icon="IMPORT")
        left = not there and unfinished(managed_environment()).exists()
        if there or left:
            row.operator("mgf.remove_engine", text="", icon="TRASH")
        if discarding():
            draw_sentence(layout, tr("The files of an engine are being removed"), "INFO")
        elif left and not current_task.installing():
            text = tr("An installation was interrupted; install again, or remove what is left of it")
            draw_sentence(layout, text, "INFO")
        if not there and not self.wheel_folder and not bpy.app.online_access:
            layout.label(text="Online access is off: allow it or choose a wheel folder", icon="INFO")
            if not bpy.app.online_access_override:  # Blender was not told to stay offline
                layout.prop(context.preferences.system, "use_online_access")

    def _draw_task(self, layout: bpy.types.UILayout) -> None:
        row = layout.row(align=True)
        row.operator("mgf.check_engine", icon="CHECKMARK")
        if has_nvidia():
            row.operator("mgf.check_gpu", icon="MEMORY")
        row.operator("mgf.open_engine_log", text="", icon="TEXT")
        kind, task = current_task.current()
        if task is None:
            return
        if task.status == RUNNING:
            row = layout.row(align=True)
            row.progress(factor=task.fraction, text=tr(task.title), translate=False)
            row.operator("mgf.cancel_engine_task", text="", icon="X")
            if task.output:
                layout.label(text=task.output[-1].strip()[:100], translate=False)
        elif not current_task.is_about_chosen_engine():
            return
        elif task.status in {FAILED, CANCELLED}:
            draw_sentence(layout, task.text, "ERROR" if task.status == FAILED else "INFO")
        elif task.status == DONE and kind in {"gpu", "weights"}:
            draw_sentence(layout, "".join(task.output[-1:]), "CHECKMARK")
        elif task.status == DONE and kind in {"check", "install"}:
            box = layout.box().column(align=True)
            *rows, (summary, _) = _report_lines(task.output) or [("", "")]
            draw_sentence(box, tr(summary), "CHECKMARK")
            for name, value in rows:
                if value:
                    draw_value(box, name, _in_panel_terms(value, self.engine_source == "MANAGED"))
                else:
                    box.label(text=name, translate=False)
            if task.note:
                draw_sentence(layout, task.note, "INFO")


def _in_panel_terms(value: str, managed: bool) -> str:
    """Say what is missing in terms of these preferences; in an engine that they installed nobody calls pip.

    Args:
        value: of a line of the engine's report.
        managed: whether *Install Engine* made the engine.
    """
    weights = _NO_WEIGHTS.fullmatch(value)
    if weights is not None:
        return tr(
            "random walker, which needs no weights; the arrow beside Mask Weights fetches those of EfficientSAM, the "
            "paper's segmenter ({size})",
            size=weights[1],
        )
    extra = re.search(r"pip install .*'mgf-engine\[(\w+)\]'", value)
    if extra is None or not managed:
        return value
    if extra[1] not in TICKS:
        return tr("missing; mgf town needs an existing environment with mgf-engine[town]")
    return tr("missing; tick {tick} and press Reinstall Engine", tick=tr(TICKS[extra[1]]))


def _report_lines(output: list[str]) -> list[tuple[str, str]]:
    """Return the engine's own report at the end of a check or an installation: names and values, sentences without
    value."""
    start = next((i for i in reversed(range(len(output))) if output[i].startswith("mgf ")), len(output))
    rows = [re.split(r"\s{2,}", line.strip(), maxsplit=1) for line in output[start:]]
    return [(row[0], row[1] if len(row) > 1 else "") for row in rows][:24]


in_our_words(MGF_Preferences)
register, unregister = bpy.utils.register_classes_factory((MGF_Preferences,))
