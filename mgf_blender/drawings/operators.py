# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the Drawings panel."""

from pathlib import Path

import bpy

from ..common.editors import show_image
from ..common.errors import UserError
from ..common.job import Job
from ..common.operators import Operator
from ..common.selection import select_only, selected_objects
from ..job_folder import has_job_file, job_folder
from ..jobs.operators import FinishedJobOperator, submit
from ..jobs.start import tool_job
from ..scene_import.cameras import IMAGE_KEY
from ..scene_import.imported_scene import ImportedScene
from ..scene_import.operators import SceneOperator
from .index import FOLDER, read_index
from .sections import ROLE_KEY, THEIRS, add_section, find_sections, may_be_section, remove_section, section_texts


def drawings_job(scene: bpy.types.Scene) -> Job:
    """Return the job that draws what the scene's options say; starts nothing.

    Raises:
        UserError: nothing is to be drawn, or there is no engine.
    """
    wanted, imported = scene.mgf.drawings, ImportedScene.find(scene)
    if not wanted.kinds:
        raise UserError("Nothing is chosen to be drawn; choose orthophotos, elevations or another kind.")
    command = ["drawings", str(job_folder(scene)), "--paper", wanted.paper]
    for kind in sorted(wanted.kinds):
        command += ["--draw", kind]
    if wanted.resolution > 0:
        command += ["--resolution", f"{wanted.resolution:.6g}"]
    if wanted.scale > 0:
        command += ["--scale", str(wanted.scale)]
    sections = section_texts(scene, imported) if imported is not None else []
    if wanted.height > 0:
        sections.append(f"z={wanted.height:.6g}")
    for text in sections:
        command += ["--section", text]
    return tool_job(scene, "drawings", command)


class MGF_OT_make_drawings(FinishedJobOperator):
    """Draw the finished job: facade orthophotos, elevations, sections, sheets, quantities"""

    bl_idname = "mgf.make_drawings"
    bl_label = "Make Drawings"

    def run(self, context: bpy.types.Context) -> set[str]:
        context.view_layer.update()  # planes may have been moved by a script
        return submit(self, drawings_job(context.scene))


class MGF_OT_add_section(SceneOperator):
    """Put a plane through the middle; the building is cut where it stands. Move and turn it as any object"""

    bl_idname = "mgf.add_section"
    bl_label = "Add Section Plane"
    bl_options = {"REGISTER", "UNDO"}

    axis: bpy.props.EnumProperty(
        name="Direction",
        description="How the plane stands",
        items=[
            ("LEVEL", "Level", "A floor plan, seen from above"),
            ("FRONT", "Along X", "Upright along the world's X axis"),
            ("SIDE", "Along Y", "Upright along the world's Y axis"),
        ],
    )

    def run(self, context: bpy.types.Context) -> None:
        context.view_layer.update()
        select_only(context, add_section(ImportedScene.find(context.scene), self.axis))


class MGF_OT_use_as_section(Operator):
    """Cut along the selected planes and empties, square to their Z axis"""

    bl_idname = "mgf.use_as_section"
    bl_label = "Cut Along Selected"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        chosen = [o for o in selected_objects(context) if may_be_section(o)]
        return cls.needs(chosen, "Select a plane or an empty of your own first")

    def run(self, context: bpy.types.Context) -> None:
        for obj in selected_objects(context):
            if may_be_section(obj):
                obj[ROLE_KEY] = THEIRS


class _OnSection(Operator):
    name: bpy.props.StringProperty(name="Plane", description="The section plane", options={"SKIP_SAVE"})

    def section(self, scene: bpy.types.Scene) -> bpy.types.Object:
        """Return the plane of that name."""
        found = next((o for o in find_sections(scene) if o.name == self.name), None)
        if found is None:
            raise UserError("There is no section plane '{name}' any more.", name=self.name)
        return found


class MGF_OT_select_section(_OnSection):
    """Select the section plane"""

    bl_idname = "mgf.select_section"
    bl_label = "Select Section Plane"
    bl_options = {"REGISTER", "UNDO"}

    def run(self, context: bpy.types.Context) -> None:
        select_only(context, self.section(context.scene))


class MGF_OT_remove_section(_OnSection):
    """Cut no longer along this plane; one that the add-on made is deleted"""

    bl_idname = "mgf.remove_section"
    bl_label = "Remove Section Plane"
    bl_options = {"REGISTER", "UNDO"}

    def run(self, context: bpy.types.Context) -> None:
        remove_section(self.section(context.scene))


class MGF_OT_show_drawing(Operator):
    """Show the drawing in an Image Editor"""

    bl_idname = "mgf.show_drawing"
    bl_label = "Show Drawing"
    bl_options = {"REGISTER", "UNDO"}

    name: bpy.props.StringProperty(name="File", description="File of the drawing", options={"SKIP_SAVE"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return cls.needs(has_job_file(context.scene, FOLDER), "Make the drawings first")

    def run(self, context: bpy.types.Context) -> None:
        show_image(context, load_drawing(job_folder(context.scene), self.name))


def load_drawing(job: Path, name: str) -> bpy.types.Image:
    """Read a picture of the job's drawings as an image block, as it is on disk now.

    Raises:
        UserError: there is none of that name, or it cannot be read.
    """
    index = read_index(job)
    path = next((d.path for d in index.pictures if d.path.name == name), None) if index is not None else None
    if path is None or not path.is_file():
        raise UserError("The job has no drawing '{name}'; make the drawings again.", name=name)
    try:
        image = bpy.data.images.load(str(path), check_existing=True)
    except RuntimeError as error:
        raise UserError("The drawing '{path}' cannot be read; make the drawings again.", path=path) from error
    image.reload()
    image[IMAGE_KEY] = "drawing"
    return image


CLASSES = (
    MGF_OT_make_drawings, MGF_OT_add_section, MGF_OT_use_as_section, MGF_OT_select_section, MGF_OT_remove_section,
    MGF_OT_show_drawing,
)  # fmt: skip


register, unregister = bpy.utils.register_classes_factory(CLASSES)
