# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the Georeference panels."""

import bisect

import bpy

from ..common.errors import UserError
from ..common.operators import FileOperator, Operator
from ..common.text import tr
from ..job_folder import has_job_file, job_folder
from ..jobs.operators import FinishedJobOperator, submit
from ..prompts.operators import choose_photo, open_photo
from ..prompts.properties import active_photo
from ..scene_import.cameras import PHOTO_KEY
from ..scene_import.framing import frame_imported
from ..scene_import.imported_scene import ImportedScene
from ..scene_import.operators import SceneOperator
from . import files
from .place import place_scene
from .properties import active_point
from .start import georef_job, places_job


class MGF_OT_georeference(FinishedJobOperator):
    """Find the true coordinates of the finished job, from its photos' GPS or from the marked control points"""

    bl_idname = "mgf.georeference"
    bl_label = "Georeference Job"

    def run(self, context: bpy.types.Context) -> set[str]:
        return submit(self, georef_job(context.scene))


class MGF_OT_predict_places(FinishedJobOperator):
    """Read the control points, and predict where they appear in the photos as soon as enough is known"""

    bl_idname = "mgf.predict_places"
    bl_label = "Read Points"

    def run(self, context: bpy.types.Context) -> set[str]:
        return submit(self, places_job(context.scene))


class MGF_OT_take_control_points(Operator):
    """List the control points as the engine read them"""

    bl_idname = "mgf.take_control_points"
    bl_label = "List Control Points"
    bl_options = {"REGISTER", "UNDO", "INTERNAL"}

    def run(self, context: bpy.types.Context) -> None:
        state = context.scene.mgf.georef
        chosen = active_point(context.scene)
        name = chosen.name if chosen is not None else ""
        state.points.clear()
        for known in _known_points(context.scene).values():
            point = state.points.add()
            point.name, point.role = known.name, known.role
        state.index = max(0, state.points.find(name))
        state.marking = len(state.points) > 0


class MGF_OT_place_scene(SceneOperator):
    """Lay the scene where it truly is: meters, Z up, Y north; properties of the scene say what its origin is"""

    bl_idname = "mgf.place_scene"
    bl_label = "Place in True Coordinates"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        known = has_job_file(context.scene, "georef.json")
        return super().poll(context) and cls.needs(known, "Press Georeference Job first")

    def run(self, context: bpy.types.Context) -> None:
        found = files.read_placement(job_folder(context.scene))
        if found is None or not found.metric:
            raise UserError("The job has no true coordinates yet; press Georeference Job first.")
        imported = ImportedScene.find(context.scene)
        before = imported.root.matrix_world.copy()
        place_scene(context.scene, imported, found)
        if imported.root.matrix_world != before:  # it may stand hundreds of meters above the origin now
            frame_imported(context, imported)


class MGF_OT_mark_control_points(Operator):
    """Show the photos in an Image Editor, with the point tool ready for control points"""

    bl_idname = "mgf.mark_control_points"
    bl_label = "Mark Control Points"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        read = cls.needs(len(context.scene.mgf.georef.points), "Read the control points first")
        return read and cls.needs(active_photo(context.scene) is not None, "Import a scene first")

    def run(self, context: bpy.types.Context) -> None:
        open_photo(context)
        context.scene.mgf.georef.marking = True


class MGF_OT_next_marked_photo(Operator):
    """Go to the next photo that should show the chosen control point"""

    bl_idname = "mgf.next_marked_photo"
    bl_label = "Next Photo with Point"
    bl_options = {"REGISTER", "UNDO"}

    step: bpy.props.IntProperty(name="Step", description="Number of photos to advance", default=1)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        chosen = cls.needs(active_point(context.scene) is not None, "Choose a control point to mark first")
        return chosen and cls.needs(ImportedScene.find(context.scene) is not None, "Import a scene first")

    def run(self, context: bpy.types.Context) -> None:
        scene, point = context.scene, active_point(context.scene).name
        cameras = {o[PHOTO_KEY]: o for o in ImportedScene.find(scene).objects("Cameras") if PHOTO_KEY in o}
        known = _known_points(scene).get(point)
        wanted = set(known.photos if known is not None else ()) | {
            m.photo for m in scene.mgf.georef.marks if m.point == point
        }
        names = sorted(name for name in cameras if name in wanted) or sorted(cameras)
        if not names:
            raise UserError("The imported scene has no cameras left; import it again.")
        here = active_photo(scene)
        choose_photo(scene.mgf, cameras[step_from("" if here is None else here.name, names, self.step)])


class MGF_OT_use_in_reconstruction(Operator):
    """Give CRS, points and marks to the next reconstruction, which adjusts the cameras to the control points, too"""

    bl_idname = "mgf.use_in_reconstruction"
    bl_label = "Use in Reconstruction"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        state = context.scene.mgf.georef
        return cls.needs(state.control_file or state.scale_bars, "Choose a file of control points first") and cls.needs(
            len(state.marks), "There are no marks yet"
        )

    def run(self, context: bpy.types.Context) -> None:
        state, values = context.scene.mgf.georef, context.scene.mgf.options
        marks = files.marks_path(job_folder(context.scene))
        files.write_marks(context.scene, marks)
        values.crs, values.marks = state.crs.strip(), str(marks)
        values.control = bpy.path.abspath(state.control_file)
        values.scale_bars = bpy.path.abspath(state.scale_bars)
        values.control_adjust = True
        self.report({"INFO"}, tr("The next reconstruction adjusts the cameras to the points"))


class MGF_OT_export_marks(FileOperator):
    """Write the marks to a CSV, as mgf georef reads them"""

    bl_idname = "mgf.export_marks"
    bl_label = "Export Marks"
    bl_options = {"REGISTER"}

    filepath: bpy.props.StringProperty(subtype="FILE_PATH", default="marks.csv", options={"SKIP_SAVE"})
    check_existing: bpy.props.BoolProperty(default=True, options={"HIDDEN"})
    filter_glob: bpy.props.StringProperty(default="*.csv", options={"HIDDEN"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return cls.needs(len(context.scene.mgf.georef.marks), "There are no marks yet")

    def run(self, context: bpy.types.Context) -> None:
        path = self.chosen_file()
        files.write_marks(context.scene, path if path.suffix else path.with_suffix(".csv"))


class MGF_OT_import_marks(FileOperator):
    """Read marks from a CSV (name, photo, x, y); they replace those of the same points in the same photos"""

    bl_idname = "mgf.import_marks"
    bl_label = "Import Marks"
    bl_options = {"REGISTER", "UNDO"}

    filepath: bpy.props.StringProperty(subtype="FILE_PATH", options={"SKIP_SAVE"})
    filter_glob: bpy.props.StringProperty(default="*.csv", options={"HIDDEN"})

    def run(self, context: bpy.types.Context) -> None:
        count = files.read_marks(context.scene, self.chosen_file())
        self.report({"INFO"}, tr("{count} marks read", count=count))


def step_from(name: str, names: list[str], step: int) -> str:
    """Return the name that is some steps from a place in a sorted list, going round at its ends; a name that is not in
    the list has its place between two, so that the first step from it leads to the next of them."""
    at = bisect.bisect_left(names, name)
    between = at == len(names) or names[at] != name
    return names[(at + step - (1 if between and step > 0 else 0)) % len(names)]


def _known_points(scene: bpy.types.Scene) -> dict[str, files.KnownPoint]:
    """Return the control points as the engine read them; none where the scene has no job."""
    return files.read_known_points(job_folder(scene)) if has_job_file(scene) else {}


CLASSES = (
    MGF_OT_georeference, MGF_OT_predict_places, MGF_OT_take_control_points, MGF_OT_place_scene,
    MGF_OT_mark_control_points, MGF_OT_next_marked_photo, MGF_OT_use_in_reconstruction, MGF_OT_export_marks,
    MGF_OT_import_marks,
)  # fmt: skip


register, unregister = bpy.utils.register_classes_factory(CLASSES)
