# SPDX-License-Identifier: GPL-3.0-or-later
"""Proposed points: the engine finds them by ``mgf suggest-clicks``, people accept, move or remove them.

A proposed point does not count before it is accepted: it is in no prompts file and no preview. Moving it accepts it.
"""

from pathlib import Path

import bpy
import numpy as np

from ..common.editors import areas_of
from ..common.job import DONE, Job
from ..common.operators import Operator
from ..common.text import tr
from ..job_folder import job_folder
from ..jobs.operators import JobOperator, submit
from ..jobs.start import job_options, tool_job
from ..operator_calls import run_in
from ..scene_import.cameras import find_source
from ..scene_import.crop import crop_text
from ..scene_import.imported_scene import ImportedScene
from ..scene_keys import scene_of
from . import files
from .operators import add_missing
from .properties import active_photo, photo_of_image

KIND = "suggest"
_FILE = "prompts.json"


def suggest_job(scene: bpy.types.Scene) -> Job:
    """Return the job that proposes points; starts nothing.

    Raises:
        UserError: there is no source or no engine.
    """
    state, folder = scene.mgf, job_folder(scene)
    command = ["suggest-clicks", bpy.path.abspath(state.source), "--job", str(folder), "--out", str(_out(folder))]
    command += job_options(scene, folder)
    imported = find_source(scene)
    if state.suggest_at == "CURSOR" and imported is not None:
        command += ["--point", *(f"{v:.9g}" for v in _cursor(scene, imported))]
    return tool_job(scene, KIND, command, on_end=_ended)


def _out(folder: Path) -> Path:
    """Return where a run leaves its points: beside the job folder, which is the engine's own."""
    return folder.with_name(folder.name + ".suggested")


def _cursor(scene: bpy.types.Scene, imported: ImportedScene) -> np.ndarray:
    """Return the 3D cursor in coordinates of the COLMAP scene, float64 [3]."""
    root = np.array(imported.root.matrix_world, np.float64)
    place = np.linalg.solve(root, np.append(np.array(scene.cursor.location, np.float64), 1.0))
    return place[:3] + imported.offset


def _ended(job: Job) -> None:
    """Take over what a run proposed, in the scene that asked for it."""
    scene = scene_of(job.scene_key)
    if job.status == DONE and scene is not None:
        run_in(scene, "take_suggestions", filepath=str(_out(job.folder) / _FILE))


def proposed(scene: bpy.types.Scene) -> list[bpy.types.PropertyGroup]:
    """Return photos with proposed points."""
    return [photo for photo in scene.mgf.photos if any(click.proposed for click in photo.clicks)]


def drop_proposed(photo: bpy.types.PropertyGroup) -> None:
    """Remove the proposed points of a photo."""
    for index in reversed(range(len(photo.clicks))):
        if photo.clicks[index].proposed:
            photo.clicks.remove(index)


class MGF_OT_suggest_clicks(JobOperator):
    """Propose points on the building and beside it, out of the sparse points; they count when you accept them"""

    bl_idname = "mgf.suggest_clicks"
    bl_label = "Suggest"
    bl_options = {"REGISTER", "UNDO"}

    def run(self, context: bpy.types.Context) -> set[str]:
        context.view_layer.update()  # the crop box may have been moved by a script
        context.scene.mgf.options.crop_box = crop_text(find_source(context.scene))
        return submit(self, suggest_job(context.scene))


def _working(scene: bpy.types.Scene) -> bool:
    """Tell whether someone works on the chosen photo: it has points, or an Image Editor shows it."""
    photo, index = active_photo(scene), scene.mgf.photo_index
    if photo is None:
        return False
    shown = [area.spaces.active.image for _, area in areas_of("IMAGE_EDITOR")]
    return len(photo.clicks) > 0 or any(photo_of_image(scene, image) == index for image in shown)


class MGF_OT_take_suggestions(Operator):
    """Show the points that the engine proposes; photos with points of your own get none"""

    bl_idname = "mgf.take_suggestions"
    bl_label = "Show Proposed Points"
    bl_options = {"REGISTER", "UNDO", "INTERNAL"}

    filepath: bpy.props.StringProperty(subtype="FILE_PATH", options={"SKIP_SAVE"})

    def run(self, context: bpy.types.Context) -> None:
        scene, state = context.scene, context.scene.mgf
        found = files.read(Path(self.filepath))
        for photo in state.photos:
            drop_proposed(photo)
        add_missing(scene, list(found))
        taken = 0
        for name, clicks in found.items():
            photo = state.photos.get(name)
            if photo is None or len(photo.clicks):  # points by hand win
                continue
            for u, v, negative, part in clicks:
                files.add_click(photo, u, v, negative, part, proposed=True)
            taken += len(clicks)
        shown = proposed(scene)
        if shown and not _working(scene):
            state.photo_index = state.photos.find(shown[0].name)
        text = tr("{count} points proposed in {photos} photos", count=taken, photos=len(shown))
        self.report({"INFO"}, text)


class _OnProposed(Operator):
    every: bpy.props.BoolProperty(
        name="All Photos", description="In all photos, not only in the chosen one", default=True, options={"SKIP_SAVE"}
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return cls.needs(proposed(context.scene), "No points are proposed")

    def photos(self, scene: bpy.types.Scene) -> list[bpy.types.PropertyGroup]:
        """Return the photos that are meant."""
        here = active_photo(scene)
        return proposed(scene) if self.every else [] if here is None else [here]


class MGF_OT_accept_suggestions(_OnProposed):
    """Let the proposed points count as if you had clicked them"""

    bl_idname = "mgf.accept_suggestions"
    bl_label = "Accept"
    bl_options = {"REGISTER", "UNDO"}

    def run(self, context: bpy.types.Context) -> None:
        for photo in self.photos(context.scene):
            for click in photo.clicks:
                click.proposed = False


class MGF_OT_discard_suggestions(_OnProposed):
    """Remove the proposed points"""

    bl_idname = "mgf.discard_suggestions"
    bl_label = "Discard"
    bl_options = {"REGISTER", "UNDO"}

    def run(self, context: bpy.types.Context) -> None:
        for photo in self.photos(context.scene):
            drop_proposed(photo)


CLASSES = (
    MGF_OT_suggest_clicks, MGF_OT_take_suggestions, MGF_OT_accept_suggestions, MGF_OT_discard_suggestions,
)  # fmt: skip


register, unregister = bpy.utils.register_classes_factory(CLASSES)
