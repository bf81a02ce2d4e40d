# SPDX-License-Identifier: GPL-3.0-or-later
"""What a job goes on to do with what a reader accepted: draw it, train on it, mesh it, paint it.

A reader that lets something through which later crashes has not refused it. All of it is small: a few views of a few
hundred pixels, meshes of a few faces.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from benchmarks.fuzz.target import FACES, VERTICES, small_field
from mgf_engine.field.export import write_splats
from mgf_engine.field.initialise import initial_field
from mgf_engine.field.losses import LossOptions, total_loss
from mgf_engine.field.targets import make_target
from mgf_engine.geometry import clean
from mgf_engine.geometry.mesh_files import write_glb, write_obj, write_ply, write_texture
from mgf_engine.geometry.rasterize import render_mesh
from mgf_engine.mesh.colors import color_from_photos
from mgf_engine.mesh.component_filter import faces_near_clicks
from mgf_engine.mesh.decimate import reduce_faces
from mgf_engine.mesh.face_visibility import count_pixels
from mgf_engine.mesh.ground_pixels import ground_pixels
from mgf_engine.model.gaussians import Gaussians
from mgf_engine.model.masks import MaskSet, building
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.scene import Scene
from mgf_engine.raster.api import Camera, render
from mgf_engine.raster.points import INSIDE, PointOpacity
from mgf_engine.texture.draw import draw_textured
from mgf_engine.texture.texture_pipeline import make_texture

#: Larger things are left alone: what a case costs must not depend on the damage.
MOST_PIXELS, MOST_FACES, MOST_GAUSSIANS = 1 << 16, 10_000, 5000


def all_inside(scene: Scene) -> MaskSet:
    """Masks in which every pixel shows the building."""
    count = len(scene.views)
    labels = tuple(np.ones((v.height, v.width), np.uint8) for v in scene.views)
    return MaskSet(labels, np.ones(count, bool), np.ones(count, np.float32), np.ones(len(scene.points), bool), ())


def use_mesh(mesh: Mesh, scene: Scene, masks: MaskSet, folder: Path) -> None:
    """Clean, colour, reduce, paint, draw and write a mesh of the normalised frame."""
    if len(mesh.faces) > MOST_FACES or not _small(scene):
        return
    views = list(scene.views)
    for view in views:  # as it is, as `mgf evaluate` does
        render_mesh(mesh, view)
    mesh = clean.weld(clean.with_faces(replace(mesh, values={}), mesh.faces))
    mesh = clean.with_faces(mesh, mesh.faces[clean.large_parts(mesh, 0.01)])
    mesh = clean.smooth(clean.split_nonmanifold(mesh), 1)
    counts = count_pixels(mesh, views)
    mesh = clean.orient_outward(mesh, counts.front, counts.back)
    faces_near_clicks(mesh, views, masks.clicks or [np.zeros((0, 2), np.float32)] * len(views))
    inside = [building(labels) for labels in masks.labels]
    mesh = color_from_photos(mesh, views, scene.photo, inside)
    mesh = reduce_faces(mesh, 3, 0.1 * ground_pixels(mesh, views))
    if not len(mesh.faces):
        return
    texture = make_texture(mesh, scene, masks, 64, lambda text: None)
    for view in views:
        draw_textured(mesh, texture, view)
    write_texture(texture, folder)
    for write, name in ((write_obj, "used.obj"), (write_glb, "used.glb")):
        write(mesh, folder / name, texture)
    write_ply(mesh, folder / "used.ply")


def use_field(field: Gaussians, scene: Scene, masks: MaskSet, folder: Path) -> None:
    """Compare renders of a field with the photos, ask for its opacity, and write it as a 3DGS file."""
    if not 0 < len(field) <= MOST_GAUSSIANS or not _small(scene):
        return
    for index, (view, labels) in enumerate(zip(scene.views, masks.labels, strict=True)):
        leaves = Gaussians(**{
            name: value.detach().clone().requires_grad_(value.is_floating_point())
            for name, value in vars(field).items()
        })  # fmt: skip
        drawn = render(leaves, Camera.from_view(view), sh_degree=1)
        target = make_target(scene.photo(index), labels, view, 1)
        if target is not None and view.width >= 16 and view.height >= 16:
            error = torch.zeros(view.height, view.width)
            total_loss(drawn, target, LossOptions(), torch.zeros(3), True, error).total.backward()
        points = scene.points[:100].astype(np.float32)
        where = np.full((view.height, view.width), INSIDE, np.uint8)
        PointOpacity(field).lower(np.full((len(points), 2), 2.0, np.float32), points, view, where)
    write_splats(field, scene.to_normalised, folder / "used_field.ply")


def use_masks(masks: MaskSet, scene: Scene, folder: Path) -> None:
    """Train a step on the masks, and paint a mesh from what they show."""
    use_field(small_field(), scene, masks, folder)
    use_mesh(Mesh(VERTICES, FACES, np.full((4, 3), 7, np.uint8)), scene, masks, folder)


def use_scene(scene: Scene, folder: Path) -> None:
    """Begin a field from a scene, and build a mesh among its points."""
    masks = all_inside(scene)
    if not _small(scene) or not len(scene.points) or not len(scene.views):
        return
    twice = np.concatenate([scene.points, 1.01 * scene.points + 0.01])  # a field begins with four points at least
    towards = np.array([v.centre for v in scene.views]).mean(0) - twice
    use_field(initial_field(twice, np.tile(scene.colors, (2, 1)), towards), scene, masks, folder)
    if len(scene.points) >= 3:
        corners = scene.points[:3]
        use_mesh(Mesh(corners, np.array([[0, 1, 2]], np.int32), scene.colors[:3].copy()), scene, masks, folder)


def _small(scene: Scene) -> bool:
    return all(v.width * v.height <= MOST_PIXELS for v in scene.views) and len(scene.views) <= 20
