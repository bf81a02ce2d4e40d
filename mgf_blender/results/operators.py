# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the Results panel."""

import json
from pathlib import Path

import bpy

from ..common.errors import UserError
from ..common.operators import Operator
from ..reconstruct.start import job_folder
from ..scene_import.cameras import PHOTO_KEY
from ..scene_import.tree import Tree
from . import arrival, switch
from .field import import_field
from .job_folder import read_delivery
from .load import import_result


class _NeedsJob(Operator):
    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        state = context.scene.mgf
        if not state.job_folder or not (job_folder(context.scene) / "deliver.json").is_file():
            cls.poll_message_set("The job folder holds no finished job")
            return False
        return True


class MGF_OT_import_result(Operator):
    """Bring mesh and renders of the job into the scene; replaces only what an earlier import made"""

    bl_idname = "mgf.import_result"
    bl_label = "Import Result"
    bl_options = {"REGISTER", "UNDO"}

    directory: bpy.props.StringProperty(
        name="Job Folder", description="Folder of a finished job; empty takes the scene's own", subtype="DIR_PATH",
        options={"SKIP_SAVE"},
    )  # fmt: skip

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        state = context.scene.mgf
        if self.directory or (state.job_folder and (job_folder(context.scene) / "deliver.json").is_file()):
            arrival.begin(context.scene, self._folder(context.scene))
            return {"CANCELLED"}  # nothing has changed yet; the arrival ends in execute, which is the undo step
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def _folder(self, scene: bpy.types.Scene) -> Path:
        return Path(bpy.path.abspath(self.directory)) if self.directory else job_folder(scene)

    def run(self, context: bpy.types.Context) -> None:
        scene = context.scene
        folder = self._folder(scene)
        there = arrival.ready(scene, folder)
        content = arrival.content_of(there) if there is not None else None
        mesh = there.take_mesh() if there is not None else None
        result = import_result(scene, folder, Tree.find(scene), content, mesh)
        scene.mgf.figures = json.dumps(result.delivery.figures)
        scene.mgf.job_folder = scene.mgf.job_folder or str(folder)
        faces = len(result.mesh.data.polygons) if result.mesh is not None else 0
        self.report({"INFO"}, f"Mesh of {faces} faces, {result.renders} renders")


class MGF_OT_import_field(_NeedsJob):
    """Bring the Gaussian field in as coloured points"""

    bl_idname = "mgf.import_field"
    bl_label = "Import Field as Points"
    bl_options = {"REGISTER", "UNDO"}

    def run(self, context: bpy.types.Context) -> None:
        delivery = read_delivery(job_folder(context.scene))
        tree = Tree.find(context.scene)
        if delivery.field is None or tree is None:
            raise UserError("The job has no field or its scene is gone; import the result first.")
        import_field(tree, delivery.field)


class MGF_OT_show_in_camera(Operator):
    """Choose what the camera shows: its photo, the render, the error between them, or the mesh alone"""

    bl_idname = "mgf.show_in_camera"
    bl_label = "Show in Camera"
    bl_options = {"REGISTER", "UNDO"}

    kind: bpy.props.EnumProperty(
        name="Show",
        description="What the camera shows",
        items=[
            ("PHOTO", "Photo", "The photo, with the mesh before it"),
            ("RENDER", "Render", "The rendering of the trained field"),
            ("ERROR", "Error", "Where photo and render differ"),
            ("MESH", "Mesh", "The mesh alone"),
        ],
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        camera = context.scene.camera
        if camera is None or PHOTO_KEY not in camera or Tree.find(context.scene) is None:
            cls.poll_message_set("Look through an imported camera first")
            return False
        return True

    def run(self, context: bpy.types.Context) -> None:
        switch.show(Tree.find(context.scene), context.scene.camera, self.kind)


CLASSES = (MGF_OT_import_result, MGF_OT_import_field, MGF_OT_show_in_camera)


def register() -> None:
    """Register the operators."""
    for cls in CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    """Take them away."""
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
