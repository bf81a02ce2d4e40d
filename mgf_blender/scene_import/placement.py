# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that place an imported scene: its scale by a known distance, and its direction up."""

import bpy
import numpy as np
from mathutils import Matrix, Vector

from ..common.errors import UserError
from ..common.selection import active_object, selected_objects
from ..common.text import N_, tr
from ..common.views import scale_views
from .cameras import HELD_KEY, set_clipping
from .frame import rotation_to_z, turn_as_held, up_direction
from .imported_scene import ImportedScene
from .operators import SceneOperator

DIALOG_WIDTH = 460  # pixels at interface scale 1: room for the sentence in every language
LENGTHS = N_("Drawings and models get true lengths from Georeference")


class MGF_OT_set_scale(SceneOperator):
    """Scale the scene so that two chosen points lie at a known distance: select two vertices or two objects"""

    bl_idname = "mgf.set_scale"
    bl_label = "Set Scale"
    bl_options = {"REGISTER", "UNDO"}

    distance: bpy.props.FloatProperty(
        name="Distance", description="True distance between the two points", default=1.0, min=1e-6, subtype="DISTANCE",
        precision=4,
    )  # fmt: skip
    measured: bpy.props.FloatProperty(options={"HIDDEN", "SKIP_SAVE"}, description="Distance before", precision=4)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        chosen = _count_points(context) == 2
        return super().poll(context) and cls.needs(chosen, "Select exactly two vertices or two objects first")

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        try:
            self.measured = self.distance = _distance(context)
        except UserError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return context.window_manager.invoke_props_dialog(self, width=DIALOG_WIDTH)

    def draw(self, context: bpy.types.Context) -> None:
        self.layout.label(text=tr("Distance now: {measured:.6g}", measured=self.measured), translate=False)
        self.layout.prop(self, "distance")
        self.layout.label(text=LENGTHS, icon="INFO")

    def run(self, context: bpy.types.Context) -> None:
        self.measured = measured = _distance(context)
        if context.mode != "OBJECT":
            bpy.ops.object.mode_set(mode="OBJECT")  # the undo steps of other modes know nothing of objects' scale
        imported, factor = ImportedScene.find(context.scene), self.distance / measured
        root = imported.root
        root.matrix_basis = Matrix.Scale(factor, 4) @ root.matrix_basis
        scale_views(context, factor)
        for obj in imported.objects("Cameras"):
            set_clipping(obj.data, imported)
        self.report({"INFO"}, tr("{measured:.6g} measured, scaled by {factor:.6g}", measured=measured, factor=factor))


class MGF_OT_set_up_axis(SceneOperator):
    """Set the direction of the scene that points up"""

    bl_idname = "mgf.set_up_axis"
    bl_label = "Set Up Axis"
    bl_options = {"REGISTER", "UNDO"}

    axis: bpy.props.EnumProperty(
        name="Up",
        description="Direction of the scene's own coordinates that becomes Z",
        items=[
            ("CAMERAS", "From Cameras", "The direction that keeps the photos' horizons level"),
            ("X", "X", "The scene's X axis"), ("NEG_X", "-X", "Against the scene's X axis"),
            ("Y", "Y", "The scene's Y axis"), ("NEG_Y", "-Y", "Against the scene's Y axis"),
            ("Z", "Z", "The scene's Z axis"), ("NEG_Z", "-Z", "Against the scene's Z axis"),
        ],
    )  # fmt: skip

    def run(self, context: bpy.types.Context) -> None:
        imported = ImportedScene.find(context.scene)
        if self.axis == "CAMERAS":
            up = up_direction(np.array([_rotation_as_held(camera) for camera in imported.cameras()]))
        else:
            up = np.eye(3)["XYZ".index(self.axis[-1])] * (-1.0 if self.axis.startswith("NEG") else 1.0)
        root = imported.root
        location, _, scale = root.matrix_basis.decompose()
        root.matrix_basis = Matrix.LocRotScale(location, Matrix(rotation_to_z(up).tolist()), scale)


def _rotation_as_held(camera: bpy.types.Object) -> np.ndarray:
    """Return scene -> camera [3, 3], y down in the photo as people look at it."""
    axes = np.array(camera.matrix_basis)[:3, :3]
    rotation = np.diag([1.0, -1.0, -1.0]) @ (axes / np.linalg.norm(axes, axis=0)).T
    return turn_as_held(rotation, camera.get(HELD_KEY, 1))


def _count_points(context: bpy.types.Context) -> int:
    """Return how many points are selected: vertices in Edit Mode, else objects."""
    obj = active_object(context)
    if obj is not None and obj.mode == "EDIT" and obj.type == "MESH":
        return obj.data.total_vert_sel
    return len(selected_objects(context))


def _distance(context: bpy.types.Context) -> float:
    """Measure between the two selected points.

    Raises:
        UserError: they are not two, or at one place.
    """
    a, b = _two_points(context)
    measured = (a - b).length
    if measured < 1e-12:
        raise UserError("The two points are in the same place; choose two different ones.")
    return measured


def _two_points(context: bpy.types.Context) -> list[Vector]:
    """Return two world positions out of the selection: vertices in Edit Mode, else objects."""
    obj = active_object(context)
    if obj is not None and obj.mode == "EDIT" and obj.type == "MESH":
        obj.update_from_editmode()
        found = [obj.matrix_world @ v.co for v in obj.data.vertices if v.select]
    else:
        found = [o.matrix_world.translation.copy() for o in selected_objects(context)]
    if len(found) != 2:
        raise UserError("Select exactly two vertices or two objects; {count} are selected.", count=len(found))
    return found


CLASSES = (MGF_OT_set_scale, MGF_OT_set_up_axis)
register, unregister = bpy.utils.register_classes_factory(CLASSES)
