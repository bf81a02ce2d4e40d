# SPDX-License-Identifier: GPL-3.0-or-later
"""Control points and their marks as Blender properties."""

import bpy

from ..compat import PATH


class MGF_PG_control_point(bpy.types.PropertyGroup):
    """A point whose place is known; ``name`` is that of the file."""

    role: bpy.props.StringProperty(name="Role", description="Whether the point is control or only checks")


class MGF_PG_mark(bpy.types.PropertyGroup):
    """Where a point appears in a photo, pixels of the user's own photo, (0, 0) its top-left corner."""

    point: bpy.props.StringProperty(name="Point", description="Name of the control point")
    photo: bpy.props.StringProperty(name="Photo", description="Name of the photo")
    uv: bpy.props.FloatVectorProperty(name="Pixel", description="Position in pixels from the top left", size=2)


class MGF_PG_georef(bpy.types.PropertyGroup):
    """What is known of the scene's place, at ``scene.mgf.georef``."""

    crs: bpy.props.StringProperty(
        name="CRS", description="Coordinate reference system, such as EPSG:25832; auto is the UTM zone of the photos' "
        "GPS, empty a local frame in meters",
    )  # fmt: skip
    control_file: bpy.props.StringProperty(
        name="Points", description="Control and check points: name, east, north, height, accuracy, role (CSV), or the "
        "file of Metashape or OpenDroneMap", subtype="FILE_PATH", options=PATH,
    )  # fmt: skip
    scale_bars: bpy.props.StringProperty(
        name="Scale Bars", description="Distances between marked points: from, to, meters (CSV)", subtype="FILE_PATH",
        options=PATH,
    )  # fmt: skip
    points: bpy.props.CollectionProperty(name="Control Points", type=MGF_PG_control_point)
    index: bpy.props.IntProperty(name="Point", description="The point that the next click marks")
    marks: bpy.props.CollectionProperty(name="Marks", type=MGF_PG_mark)
    marking: bpy.props.BoolProperty(
        name="Mark Control Points", description="Clicks of the point tool mark the chosen control point and not the "
        "building", default=False,
    )  # fmt: skip
    follow: bpy.props.BoolProperty(
        name="Predict After Each Mark", description="Ask the engine after each mark where the points should appear in "
        "the other photos", default=True,
    )  # fmt: skip


def active_point(scene: bpy.types.Scene) -> MGF_PG_control_point | None:
    """Return the control point chosen in the list."""
    state = scene.mgf.georef
    return state.points[state.index] if 0 <= state.index < len(state.points) else None


def mark_of(scene: bpy.types.Scene, point: str, photo: str) -> int:
    """Return the index of a point's mark in a photo, or -1."""
    marks = scene.mgf.georef.marks
    return next((i for i, mark in enumerate(marks) if mark.point == point and mark.photo == photo), -1)


def set_mark(scene: bpy.types.Scene, point: str, photo: str, uv: tuple[float, float]) -> None:
    """Mark a point in a photo, in the place of an earlier mark.

    Args:
        scene: whose marks are meant.
        point: name of the control point.
        photo: name of the photo.
        uv: pixel of the photo.
    """
    marks, at = scene.mgf.georef.marks, mark_of(scene, point, photo)
    mark = marks[at] if at >= 0 else marks.add()
    mark.point, mark.photo, mark.uv = point, photo, uv
