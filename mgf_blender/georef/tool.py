# SPDX-License-Identifier: GPL-3.0-or-later
"""The point tool of the Image Editor while control points are marked: one mark of a point in each photo."""

import bpy

from ..common.errors import UserError
from ..prompts.tool import DragOnPhoto, OnPhoto, redraw_area
from . import magnifier
from .properties import active_point, mark_of, set_mark
from .start import predict_again

FINE = 0.1  # what a mark moves of the pointer's way while Shift is held, as Blender's sliders do


def dragged(
    at: tuple[float, ...], before: tuple[float, ...], now: tuple[float, ...], fine: bool, size: tuple[int, int]
) -> tuple[float, ...]:
    """Return where a mark at pixel ``at`` goes when the pointer moves over the photo from ``before`` to ``now``.

    Args:
        at: where the mark is.
        before: where the pointer was, pixels of the photo.
        now: where it is.
        fine: the mark goes a tenth of the pointer's way.
        size: width and height of the photo, which the mark does not leave.
    """
    share = FINE if fine else 1.0
    moved = (a + share * (n - b) for a, b, n in zip(at, before, now, strict=True))
    return tuple(min(max(v, 0.0), float(most)) for v, most in zip(moved, size, strict=True))


class _OnMark(OnPhoto):
    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        state = context.scene.mgf.georef
        chosen = state.marking and active_point(context.scene) is not None
        return cls.needs(chosen, "Choose a control point to mark first") and super().poll(context)

    def _names(self, context: bpy.types.Context) -> tuple[str, str]:
        """Return the chosen point and the photo under the pointer."""
        point = active_point(context.scene)
        if point is None:
            raise UserError("The control point is not in the list any more; choose another one.")
        return point.name, self.listed_photo(context).name


class MGF_OT_mark(_OnMark, DragOnPhoto):
    """Mark where the chosen control point appears; drag to place it, with Shift a tenth as far. Alt removes the mark"""

    bl_idname = "mgf.mark"
    bl_label = "Mark Control Point"
    bl_options = {"REGISTER", "UNDO", "BLOCKING"}

    photo: bpy.props.IntProperty(default=-1, options={"HIDDEN", "SKIP_SAVE"})
    uv: bpy.props.FloatVectorProperty(
        name="Pixel", description="Position in pixels from the top left", size=2, options={"SKIP_SAVE"}
    )

    def run(self, context: bpy.types.Context) -> None:
        set_mark(context.scene, *self._names(context), self.uv)
        redraw_area(context)
        predict_again(context.scene)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        self.locate(context, event)
        if not self.inside:
            return {"PASS_THROUGH"}
        at = mark_of(context.scene, *self._names(context))
        self._before = tuple(context.scene.mgf.georef.marks[at].uv) if at >= 0 else None
        self._pointer = tuple(self.uv)
        if event.shift and self._before is not None:
            self.uv = self._before
        self._put(context)
        redraw_area(context)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def move(self, context: bpy.types.Context, event: bpy.types.Event) -> None:
        pointer = tuple(self.uv)
        self.uv = dragged(self._at, self._pointer, pointer, event.shift, context.space_data.image.size)
        self._pointer = pointer
        self._put(context)

    def _put(self, context: bpy.types.Context) -> None:
        set_mark(context.scene, *self._names(context), self.uv)
        self._at = tuple(self.uv)
        magnifier.show_pixel(self._at)

    def drop(self, context: bpy.types.Context) -> None:
        self.uv = self._at
        magnifier.show_pixel(None)
        predict_again(context.scene)

    def put_back(self, context: bpy.types.Context) -> None:
        magnifier.show_pixel(None)
        at = mark_of(context.scene, *self._names(context))
        if self._before is not None:
            set_mark(context.scene, *self._names(context), self._before)
        elif at >= 0:
            context.scene.mgf.georef.marks.remove(at)


class MGF_OT_remove_mark(_OnMark):
    """Remove the mark of the chosen control point from this photo"""

    bl_idname = "mgf.remove_mark"
    bl_label = "Remove Mark"
    bl_options = {"REGISTER", "UNDO"}

    photo: bpy.props.IntProperty(default=-1, options={"HIDDEN", "SKIP_SAVE"})

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        self.locate(context, event)
        return self.execute(context)

    def run(self, context: bpy.types.Context) -> set[str]:
        at = mark_of(context.scene, *self._names(context))
        if at < 0:
            return {"CANCELLED"}
        context.scene.mgf.georef.marks.remove(at)
        redraw_area(context)
        predict_again(context.scene)
        return {"FINISHED"}


register, unregister = bpy.utils.register_classes_factory((MGF_OT_mark, MGF_OT_remove_mark))
