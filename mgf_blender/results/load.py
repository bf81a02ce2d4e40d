# SPDX-License-Identifier: GPL-3.0-or-later
"""Bring a job's results into a Blender scene: mesh, renders, and the cameras they were made for."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from ..common.errors import UserError
from ..common.materials import vertex_color_material
from ..common.meshes import make_mesh, set_attribute, shade_smooth_by_angle
from ..common.ply import Ply, read_ply
from ..scene_import.cameras import (
    DISTORTED_KEY,
    CameraSpec,
    add_background,
    add_cameras,
    find_camera,
    load_image,
)
from ..scene_import.colmap import Points
from ..scene_import.frame import make_frame
from ..scene_import.points import add_points
from ..scene_import.tree import Tree
from .job_folder import Delivery, ResultView, read_delivery
from .parts import Parts, assign_parts, read_parts

SHARP_ANGLE = 40.0  # degrees


@dataclass(frozen=True)
class Result:
    """What an import brought."""

    tree: Tree
    mesh: bpy.types.Object | None
    renders: int
    delivery: Delivery


def import_result(scene: bpy.types.Scene, folder: Path, tree: Tree | None = None) -> Result:
    """Import a finished job; earlier results in the same tree are replaced, other objects stay.

    Args:
        folder: the job folder.
        tree: the imported COLMAP scene; made from the job's own cameras and points when None.

    Raises:
        UserError: the job is not finished or a file is damaged; the scene is then unchanged.
    """
    delivery = read_delivery(folder.absolute())
    surface = read_ply(delivery.mesh) if delivery.mesh is not None else None
    if surface is not None and len(surface.triangles) == 0:
        raise UserError(f"'{delivery.mesh}' holds no faces; read the job's report for the reason.")
    parts = read_parts(delivery.parts, len(surface.triangles)) if delivery.parts and surface is not None else None
    if tree is None or tree.root is None:
        tree = _tree_of_job(scene, delivery)
    tree.clear("Renders")
    for view in delivery.views:
        _add_view(tree, view)
    if scene.camera is None and tree.objects("Cameras"):
        scene.camera = tree.objects("Cameras")[0]
    obj = None
    if surface is not None:
        tree.clear("Mesh")
        obj = _add_mesh(tree, surface, parts)
        layer = scene.view_layers[0]
        for points in tree.objects("Points"):
            if points.name in layer.objects:
                points.hide_set(True, view_layer=layer)  # they would speckle the surface
    return Result(tree, obj, len(tree.objects("Renders")), delivery)


def _tree_of_job(scene: bpy.types.Scene, delivery: Delivery) -> Tree:
    """A tree for a job imported without its COLMAP scene."""
    specs = [v.camera for v in delivery.views]
    cloud = read_ply(delivery.points) if delivery.points is not None else None
    xyz = cloud.positions if cloud is not None else np.zeros((0, 3))
    rotations = np.array([s.rotation for s in specs]).reshape(-1, 3, 3)
    centres = np.array([-s.rotation.T @ s.translation for s in specs]).reshape(-1, 3)
    if not len(specs):
        raise UserError(f"'{delivery.folder}' holds no views; run the job again.")
    tree = Tree.make(scene, delivery.folder.name, make_frame(xyz, rotations, centres))
    add_cameras(tree, specs)
    if cloud is not None:
        rgb = cloud.colors()
        n = len(xyz)
        error = cloud.vertices.get("error", np.zeros(n, np.float32))
        length = cloud.vertices.get("track_length", np.zeros(n, np.int32))
        add_points(tree, Points(xyz, rgb if rgb is not None else np.full((n, 3), 200, np.uint8), error, length))
    return tree


def _add_mesh(tree: Tree, surface: Ply, parts: Parts | None) -> bpy.types.Object:
    mesh = make_mesh("Building", surface.positions - tree.offset, surface.triangles, surface.colors())
    for name, values in surface.extras().items():
        set_attribute(mesh, name, values)
    shade_smooth_by_angle(mesh, SHARP_ANGLE)
    mesh.materials.append(vertex_color_material())
    if parts is not None:
        assign_parts(mesh, parts)
    obj = bpy.data.objects.new("Building", mesh)
    tree.add("Mesh", obj)
    return obj


def _add_view(tree: Tree, view: ResultView) -> None:
    """Attach a view's pictures to its camera: behind the camera, and standing in its frustum as an object."""
    camera = find_camera(tree, view.camera.name)
    if camera is not None and camera.get(DISTORTED_KEY):
        # The job worked on the undistorted photo; only its camera fits mesh and render.
        bpy.data.objects.remove(camera, do_unlink=True)
        camera = None
    if camera is None:
        camera = add_cameras(tree, [view.camera])[0]
        camera.data.display_size = _common_display_size(tree, camera)
    if view.render is not None:
        add_background(camera, load_image(view.render, "render"), show=False)
        _add_render_object(tree, camera, view)
    if view.error is not None:
        add_background(camera, load_image(view.error, "error"), show=False)


def _common_display_size(tree: Tree, camera: bpy.types.Object) -> float:
    return next((o.data.display_size for o in tree.objects("Cameras") if o != camera), camera.data.display_size)


def _add_render_object(tree: Tree, camera: bpy.types.Object, view: ResultView) -> None:
    """The rendering as an image object in the camera's frustum, exactly where the picture plane is."""
    spec = view.camera
    obj = bpy.data.objects.new(f"Render {camera.name}", None)
    obj.empty_display_type = "IMAGE"
    obj.data = load_image(view.render, "render")  # type: ignore[arg-type]
    obj.empty_image_side = "DOUBLE_SIDED"
    obj["mgf_photo"] = spec.name
    obj["mgf_held_out"] = view.held_out
    tree.add("Renders", obj)
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
