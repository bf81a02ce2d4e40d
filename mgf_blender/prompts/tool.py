# SPDX-License-Identifier: GPL-3.0-or-later
"""The point tool of the Image Editor: each click is one operator and one undo step.

The tool itself holds no state, so saving, loading and undo work while it is active.
"""

import bpy

from ..common.errors import UserError
from ..common.operators import Operator
from .drawing import RADIUS
from .files import add_click
from .properties import BUILDING, marks_control_points, photo_of_image

TOOL_ID = "mgf.point_tool"


def nearest(photo: bpy.types.PropertyGroup, u: float, v: float, reach: float) -> int:
    """Return the index of the click nearest to a pixel within ``reach`` pixels, or -1.

    Args:
        photo: of the scene's list.
        u: column, pixels of the photo.
        v: row, pixels of the photo.
        reach: pixels of the photo.
    """
    best, found = reach, -1
    for i, click in enumerate(photo.clicks):
        distance = ((click.uv[0] - u) ** 2 + (click.uv[1] - v) ** 2) ** 0.5
        if distance <= best:
            best, found = distance, i
    return found


class OnPhoto(Operator):
    """What the operators of the tool share: the photo under the pointer and the pixel there."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        space = context.space_data
        in_editor = space is not None and space.type == "IMAGE_EDITOR"
        shown = in_editor and photo_of_image(context.scene, space.image) >= 0
        return cls.needs(shown, "Show one of the listed photos in an Image Editor first")

    def locate(self, context: bpy.types.Context, event: bpy.types.Event) -> None:
        """Take photo, pixel and reach from the pointer."""
        space, region = context.space_data, context.region
        width, height = space.image.size
        x, y = region.view2d.region_to_view(event.mouse_region_x, event.mouse_region_y)
        self.photo = photo_of_image(context.scene, space.image)
        self.uv = (min(max(x, 0.0), 1.0) * width, (1 - min(max(y, 0.0), 1.0)) * height)
        self.inside = 0 <= x <= 1 and 0 <= y <= 1
        zoom = max(1e-6, space.zoom[0])
        self.reach = 2 * RADIUS * context.preferences.system.ui_scale / zoom

    def listed_photo(self, context: bpy.types.Context) -> bpy.types.PropertyGroup:
        photos = context.scene.mgf.photos
        if not 0 <= self.photo < len(photos):
            raise UserError("The photo is not in the list any more; choose it again.")
        return photos[self.photo]


class DragOnPhoto(OnPhoto):
    """What placing a point by dragging shares; what begins the drag hands over to ``modal``."""

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if self.gone(context):
            return {"CANCELLED"}
        if event.type == "MOUSEMOVE":
            self.locate(context, event)
            self.move(context, event)
            redraw_area(context)
        elif event.type == "LEFTMOUSE" and event.value == "RELEASE":
            self.drop(context)
            return {"FINISHED"}
        elif event.type in {"ESC", "RIGHTMOUSE"}:
            self.put_back(context)
            redraw_area(context)
            return {"CANCELLED"}
        return {"RUNNING_MODAL"}

    def gone(self, context: bpy.types.Context) -> bool:
        """Tell whether what is dragged is there no more."""
        return False

    def move(self, context: bpy.types.Context, event: bpy.types.Event) -> None:
        """Put the point where the pointer is."""
        raise NotImplementedError

    def drop(self, context: bpy.types.Context) -> None:
        """Leave the point where it is."""
        raise NotImplementedError

    def put_back(self, context: bpy.types.Context) -> None:
        """Restore what was there before the drag."""
        raise NotImplementedError


class _OnClicks(OnPhoto):
    """While control points are marked, clicks are theirs, see ``georef/tool.py``."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        free = not marks_control_points(context.scene)
        return cls.needs(free, "Control points are being marked; switch that off first") and super().poll(context)


class MGF_OT_click(_OnClicks, DragOnPhoto):
    "Mark the building; a drag moves a point, a click accepts a proposed one. Ctrl marks what is beside it, Alt removes"

    bl_idname = "mgf.click"
    bl_label = "Place Point"
    bl_options = {"REGISTER", "UNDO", "BLOCKING"}

    photo: bpy.props.IntProperty(default=-1, options={"HIDDEN", "SKIP_SAVE"})
    uv: bpy.props.FloatVectorProperty(
        name="Pixel", description="Position in pixels from the top left", size=2, options={"SKIP_SAVE"}
    )
    negative: bpy.props.BoolProperty(name="Negative", description="The point is not on the building")
    reach: bpy.props.FloatProperty(default=0.0, options={"HIDDEN", "SKIP_SAVE"})

    def run(self, context: bpy.types.Context) -> None:
        photo = self.listed_photo(context)
        part = BUILDING if self.negative else context.scene.mgf.part.strip().lower() or BUILDING
        add_click(photo, *self.uv, self.negative, part)
        redraw_area(context)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        self.locate(context, event)
        if not self.inside:
            return {"PASS_THROUGH"}
        photo = self.listed_photo(context)
        self._at = nearest(photo, *self.uv, self.reach)
        self._moved = self._at >= 0
        if self._moved:
            click = photo.clicks[self._at]
            self._before = tuple(click.uv), click.proposed
            click.proposed = False
        else:
            self.run(context)
            self._at = len(photo.clicks) - 1
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def gone(self, context: bpy.types.Context) -> bool:
        return self._at >= len(self.listed_photo(context).clicks)

    def move(self, context: bpy.types.Context, event: bpy.types.Event) -> None:
        self.listed_photo(context).clicks[self._at].uv = self.uv

    def drop(self, context: bpy.types.Context) -> None:
        self.uv = self.listed_photo(context).clicks[self._at].uv

    def put_back(self, context: bpy.types.Context) -> None:
        clicks = self.listed_photo(context).clicks
        if self._moved:
            clicks[self._at].uv, clicks[self._at].proposed = self._before
        else:
            clicks.remove(self._at)


class MGF_OT_remove_click(_OnClicks):
    """Remove the point under the pointer"""

    bl_idname = "mgf.remove_click"
    bl_label = "Remove Point"
    bl_options = {"REGISTER", "UNDO"}

    photo: bpy.props.IntProperty(default=-1, options={"HIDDEN", "SKIP_SAVE"})
    uv: bpy.props.FloatVectorProperty(
        name="Pixel", description="Position in pixels from the top left", size=2, options={"SKIP_SAVE"}
    )
    reach: bpy.props.FloatProperty(default=8.0, options={"HIDDEN", "SKIP_SAVE"})

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        self.locate(context, event)
        return self.execute(context)

    def run(self, context: bpy.types.Context) -> set[str]:
        photo = self.listed_photo(context)
        index = nearest(photo, *self.uv, self.reach)
        if index < 0:
            return {"CANCELLED"}
        photo.clicks.remove(index)
        redraw_area(context)
        return {"FINISHED"}


class MGF_OT_use_point_tool(Operator):
    """Click in the photo to mark the building; Ctrl click marks what is not, Alt click or X removes a point"""

    bl_idname = "mgf.use_point_tool"
    bl_label = "Place Points"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        in_editor = context.area is not None and context.area.type == "IMAGE_EDITOR"
        return cls.needs(in_editor, "Show a photo in an Image Editor first")

    def run(self, context: bpy.types.Context) -> None:
        if context.space_data.ui_mode != "VIEW":
            context.space_data.ui_mode = "VIEW"
        bpy.ops.wm.tool_set_by_id(name=TOOL_ID, space_type="IMAGE_EDITOR")


class MGF_PointTool(bpy.types.WorkSpaceTool):
    """The tool in the toolbar of the Image Editor."""

    bl_space_type = "IMAGE_EDITOR"
    bl_context_mode = "VIEW"
    bl_idname = TOOL_ID
    bl_label = "Building Points"
    bl_description = "Click on the building; Ctrl click beside it; Alt click or X removes a point"
    bl_icon = "ops.generic.cursor"
    bl_cursor = "CROSSHAIR"
    bl_keymap = (
        ("mgf.click", {"type": "LEFTMOUSE", "value": "PRESS"}, {"properties": [("negative", False)]}),
        ("mgf.click", {"type": "LEFTMOUSE", "value": "PRESS", "ctrl": True}, {"properties": [("negative", True)]}),
        ("mgf.remove_click", {"type": "LEFTMOUSE", "value": "PRESS", "alt": True}, None),
        ("mgf.remove_click", {"type": "X", "value": "PRESS"}, None),
        ("mgf.mark", {"type": "LEFTMOUSE", "value": "PRESS"}, None),
        ("mgf.mark", {"type": "LEFTMOUSE", "value": "PRESS", "shift": True}, None),
        ("mgf.remove_mark", {"type": "LEFTMOUSE", "value": "PRESS", "alt": True}, None),
        ("mgf.remove_mark", {"type": "X", "value": "PRESS"}, None),
    )

    @staticmethod
    def draw_settings(context: bpy.types.Context, layout: bpy.types.UILayout, tool: object) -> None:
        """Draw the tool's settings in the header."""
        layout.prop(context.scene.mgf, "part")


def reactivate_tool() -> bool:
    """Activate the tool anew where a loaded file has it active: Blender keeps its name but not its keys.

    Returns:
        False while a window has not been drawn yet.
    """
    for window in bpy.context.window_manager.windows:
        tool = window.workspace.tools.from_space_image_mode("VIEW") if window.workspace is not None else None
        if tool is None or tool.idname != TOOL_ID:
            continue
        for area in window.screen.areas:
            if area.type != "IMAGE_EDITOR" or area.spaces.active.ui_mode != "VIEW":
                continue
            with bpy.context.temp_override(window=window, area=area, region=area.regions[-1]):
                if not bpy.ops.wm.tool_set_by_id.poll():
                    return False
                bpy.ops.wm.tool_set_by_id(name=TOOL_ID, space_type="IMAGE_EDITOR")
    return True


@bpy.app.handlers.persistent
def after_load(*_: object) -> None:
    """Keep the tool of a loaded file as it was (handler); in the window once that has been drawn."""
    if bpy.app.background:
        reactivate_tool()
    elif not bpy.app.timers.is_registered(_reactivate_later):
        bpy.app.timers.register(_reactivate_later, first_interval=0.3)


def _reactivate_later() -> float | None:
    return None if reactivate_tool() else 0.3


def redraw_area(context: bpy.types.Context) -> None:
    """Draw the editor under the pointer again, with its sidebar, which would keep showing the old count."""
    if context.area is not None:
        context.area.tag_redraw()


CLASSES = (MGF_OT_click, MGF_OT_remove_click, MGF_OT_use_point_tool)


def register() -> None:
    """Register the operators and the tool."""
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    bpy.utils.register_tool(MGF_PointTool, separator=True)
    bpy.app.handlers.load_post.append(after_load)
    if not bpy.app.background:
        bpy.app.timers.register(_reactivate_later, first_interval=0.5)  # Blender may have started with a file


def unregister() -> None:
    """Take them away."""
    bpy.app.handlers.load_post.remove(after_load)
    if bpy.app.timers.is_registered(_reactivate_later):
        bpy.app.timers.unregister(_reactivate_later)
    bpy.utils.unregister_tool(MGF_PointTool)
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
