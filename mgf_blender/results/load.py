# SPDX-License-Identifier: GPL-3.0-or-later
"""Bring a job's results into a Blender scene: mesh, renders, and the cameras they were made for."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from ..common.errors import UserError
from ..common.materials import vertex_color_material
from ..common.meshes import MeshData, make_mesh, prepare_mesh
from ..common.ply import read_ply
from ..common.textures import texture_material
from ..common.views import draw_texture
from ..job_folder import job_name
from ..scene_import.cameras import (
    DISTORTED_KEY,
    PHOTO_KEY,
    CameraSpec,
    add_background,
    add_cameras,
    clear_view,
    fit_render,
    load_image,
    shrink_cameras,
)
from ..scene_import.frame import SceneFrame, make_frame, turn_as_held
from ..scene_import.imported_scene import ImportedScene, hide
from ..scene_import.startup_cube import remove_startup_cube
from .delivery import Delivery, ResultView, read_delivery
from .field import leave_field
from .parts import Parts, assign_parts, read_parts
from .surface import show
from .texture import check_picture, load_texture, read_uv, remove_unused_textures
from .view_mode import forget_results

SHARP_ANGLE = 40.0  # degrees
_BESIDE_MESH = 1 / 3  # size of the drawn cameras once there is a mesh: in full size they stand before it


@dataclass(frozen=True)
class Result:
    """What an import brought."""

    imported: ImportedScene
    mesh: bpy.types.Object | None
    renders: int
    delivery: Delivery


@dataclass(frozen=True)
class Content:
    """A finished job as read from disk; holds no Blender data, so that an undo while it is read harms nothing.

    Attributes:
        offset: float64 [3], taken off the mesh's coordinates.
        frame: placement of a job read without its COLMAP scene.
    """

    delivery: Delivery
    offset: np.ndarray
    mesh: MeshData | None
    parts: Parts | None
    frame: SceneFrame | None = None


def read_result(folder: Path, offset: np.ndarray | None = None) -> Content:
    """Read a finished job at once, see :func:`reading_steps`."""
    steps = reading_steps(folder, offset)
    while True:
        try:
            next(steps)
        except StopIteration as end:
            content: Content = end.value
            return content


def reading_steps(folder: Path, offset: np.ndarray | None = None) -> Generator[None, None, Content]:
    """Read a finished job file by file, yielding in between.

    Args:
        folder: the job folder.
        offset: of the imported COLMAP scene; None when the job comes alone.

    Raises:
        UserError: the job is not finished or a file is damaged.
    """
    delivery = read_delivery(folder.absolute())
    frame = None if offset is not None else _frame_of_job(delivery)
    offset = frame.offset if frame is not None else offset
    if delivery.mesh is None:
        return Content(delivery, offset, None, None, frame)
    yield
    surface = read_ply(delivery.mesh)
    if len(surface.triangles) == 0:
        raise UserError("'{mesh}' holds no faces; read the job's report for the reason.", mesh=delivery.mesh)
    yield
    parts = read_parts(delivery.parts, len(surface.triangles)) if delivery.parts is not None else None
    yield
    uv = _read_texture(delivery, len(surface.triangles))
    yield
    mesh = prepare_mesh(surface.positions - offset, surface.triangles, surface.colors(), surface.extras(), uv)
    if parts is not None:
        parts = Parts(parts.names, parts.face[mesh.kept])
    return Content(delivery, offset, mesh, parts, frame)


def import_result(
    scene: bpy.types.Scene,
    folder: Path,
    imported: ImportedScene | None = None,
    content: Content | None = None,
    mesh: bpy.types.Mesh | None = None,
) -> Result:
    """Import a finished job; earlier results in the same imported scene are replaced, other objects stay.

    Args:
        scene: to import into.
        folder: the job folder.
        imported: the imported COLMAP scene; made from the job's own cameras when None.
        content: what :func:`read_result` gave for the folder, when that was read before.
        mesh: the mesh block made of it, when that was made before.

    Raises:
        UserError: the job is not finished or a file is damaged; the scene is then unchanged.
    """
    alone = imported is None or imported.root is None
    alone = alone or _foreign(imported, content.delivery if content else read_delivery(folder))
    offset = None if alone else imported.offset
    if content is None or not _was_read_for(content, offset):
        content, mesh = read_result(folder, offset), None
    delivery = content.delivery
    texture = load_texture(delivery.texture) if content.mesh is not None and delivery.texture is not None else None
    if alone:
        imported = _scene_of_job(scene, content)
    imported.clear("Renders")
    forget_results(imported)
    if content.mesh is not None and not imported.objects("Mesh"):
        shrink_cameras(imported, _BESIDE_MESH)
    _add_views(imported, delivery.views)
    _look_at(scene, imported)
    obj = None if content.mesh is None else _replace_mesh(scene, imported, content, mesh, texture)
    if scene.camera is not None:
        clear_view(imported, scene.camera)
    return Result(imported, obj, len(imported.objects("Renders")), delivery)


def fitting_scene(scene: bpy.types.Scene, folder: Path) -> ImportedScene | None:
    """Find the imported scene whose photos a job is of; None where it needs one of its own.

    Raises:
        UserError: the job is not finished or a file is damaged.
    """
    delivery = read_delivery(folder.absolute())
    return next((imported for imported in ImportedScene.find_all(scene) if not _foreign(imported, delivery)), None)


def _was_read_for(content: Content, offset: np.ndarray | None) -> bool:
    """Tell whether a job was read for an imported scene with this offset; None for a job that comes alone."""
    if offset is None:
        return content.frame is not None
    return content.frame is None and np.array_equal(offset, content.offset)


def _look_at(scene: bpy.types.Scene, imported: ImportedScene) -> None:
    """Give a scene that looks through no camera, or through one of another import, a camera of this one."""
    cameras, active = imported.objects("Cameras"), scene.camera
    if cameras and (active is None or (PHOTO_KEY in active and active not in cameras)):
        scene.camera = cameras[0]
        fit_render(scene, cameras[0])  # the handler does it too late, after the undo step


def _replace_mesh(
    scene: bpy.types.Scene,
    imported: ImportedScene,
    content: Content,
    mesh: bpy.types.Mesh | None,
    texture: bpy.types.Image | None,
) -> bpy.types.Object:
    """Put the job's mesh in the place of the earlier one, with its texture."""
    had_texture = imported.shows_texture
    imported.clear("Mesh")
    name = job_name(content.delivery.folder)
    obj = _add_mesh(imported, name, mesh or make_mesh(name, content.mesh, SHARP_ANGLE), content.parts, texture)
    remove_unused_textures()
    leave_field(scene, imported)
    if texture is not None or had_texture:
        draw_texture(scene, texture is not None)
    for points in imported.objects("Points"):
        hide(points)  # they would speckle the surface
    return obj


def _foreign(imported: ImportedScene, delivery: Delivery) -> bool:
    """Tell whether a job is of other photos than an imported scene, so that it needs one of its own."""
    names = {o.get(PHOTO_KEY) for o in imported.objects("Cameras")}
    return bool(names) and not any(view.camera.name in names for view in delivery.views)


def _frame_of_job(delivery: Delivery) -> SceneFrame:
    """Return the placement of a job brought in without its COLMAP scene."""
    if not delivery.views:
        raise UserError("'{folder}' holds no views; run the job again.", folder=delivery.folder)
    specs = [v.camera for v in delivery.views]
    rotations = np.array([turn_as_held(s.rotation, s.held) for s in specs]).reshape(-1, 3, 3)
    centres = np.array([-s.rotation.T @ s.translation for s in specs]).reshape(-1, 3)
    return make_frame(np.zeros((0, 3)), rotations, centres)


def _scene_of_job(scene: bpy.types.Scene, content: Content) -> ImportedScene:
    """Make the imported scene of a job that is brought in without its COLMAP scene."""
    remove_startup_cube(scene)
    imported = ImportedScene.make(scene, content.delivery.folder.name, content.frame)
    add_cameras(imported, [v.camera for v in content.delivery.views])
    return imported


def _read_texture(delivery: Delivery, faces: int) -> np.ndarray | None:
    """Return the texture coordinates of a job's mesh, [F, 3, 2], where it has a texture; its picture is checked as
    well."""
    if delivery.texture is None or delivery.texture_uv is None:
        return None
    check_picture(delivery.texture)
    return read_uv(delivery.texture_uv, faces)


def _add_mesh(
    imported: ImportedScene, name: str, mesh: bpy.types.Mesh, parts: Parts | None, texture: bpy.types.Image | None
) -> bpy.types.Object:
    mesh.name = name
    mesh.materials.append(vertex_color_material() if texture is None else texture_material("Building", texture))
    if parts is not None:
        assign_parts(mesh, parts, texture)
    if texture is not None:
        show(mesh, "TEXTURE")  # materials of an earlier import may show the vertex colours
    obj = bpy.data.objects.new(name, mesh)
    imported.add("Mesh", obj)
    return obj


def _add_views(imported: ImportedScene, views: Sequence[ResultView]) -> None:
    """Attach the pictures of views to their cameras: behind each camera, and standing in its frustum as an object."""
    there = imported.objects("Cameras")
    size = there[0].data.display_size if there else None
    cameras = {camera.get(PHOTO_KEY): camera for camera in reversed(there)}  # the first of a photo counts
    for view in views:
        camera = cameras.get(view.camera.name)
        if camera is not None and camera.get(DISTORTED_KEY):
            # The job worked on the undistorted photo; only its camera fits mesh and render.
            bpy.data.objects.remove(camera, do_unlink=True)
            camera = None
        if camera is None:
            camera = add_cameras(imported, [view.camera])[0]
            camera.data.display_size = size or camera.data.display_size
        if view.render is not None:
            add_background(camera, load_image(view.render, "render"), show=False)
            _add_render_object(imported, camera, view)


def _add_render_object(imported: ImportedScene, camera: bpy.types.Object, view: ResultView) -> None:
    """Add the rendering as an image object in the camera's frustum, exactly where the picture plane is."""
    spec = view.camera
    obj = bpy.data.objects.new(f"Render {camera.name}", None)
    obj.empty_display_type = "IMAGE"
    obj.data = load_image(view.render, "render")  # type: ignore[arg-type]
    obj.empty_image_side = "DOUBLE_SIDED"
    obj[PHOTO_KEY] = spec.name
    obj["mgf_held_out"] = view.held_out
    imported.add("Renders", obj)
    _place_in_frustum(obj, spec, camera.data.display_size)
    obj.parent = camera


def _place_in_frustum(obj: bpy.types.Object, spec: CameraSpec, depth: float) -> None:
    """Fill the frustum of ``spec`` at ``depth``; Blender draws an image object with its longer side = its size."""
    obj.empty_display_size = depth * max(spec.width, spec.height) / spec.fx
    obj.empty_image_offset = (-0.5, -0.5)
    obj.location = (
        depth * (spec.width / 2 - spec.cx) / spec.fx,
        depth * (spec.cy - spec.height / 2) / spec.fy,
        -depth,
    )
    obj.scale = (1.0, spec.fx / spec.fy, 1.0)
