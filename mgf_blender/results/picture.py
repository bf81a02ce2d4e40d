# SPDX-License-Identifier: GPL-3.0-or-later
"""Render a picture of the mesh in sun and sky, in three-quarter view from the side of the cameras."""

from __future__ import annotations

import math
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix, Vector

from ..common.materials import COLOR_ATTRIBUTE, new_material
from ..common.meshes import vertices_of
from ..common.textures import add_texture_node
from ..compat import EEVEE
from ..scene_import.imported_scene import ImportedScene
from .surface import shown, texture

_RIG = "MGF Picture"
_LENS = 45.0  # mm on a 36 mm sensor
_SKY = (0.74, 0.83, 0.95)
_OWN_LIGHT = 0.35  # share of the photos' own light in the picture; the sun adds the shape
_ELEVATION = 16.0  # degrees


def render_picture(
    scene: bpy.types.Scene,
    imported: ImportedScene,
    path: Path,
    size: tuple[int, int] = (1280, 800),
    samples: int = 48,
    engine: str = "CYCLES",
    turn: float = 30.0,
) -> None:
    """Render the mesh to a PNG; the scene keeps its own camera, world and settings.

    Args:
        scene: it holds the imported scene.
        imported: the imported scene with its mesh.
        path: where the PNG goes.
        size: width and height in pixels.
        samples: per pixel, for Cycles and EEVEE.
        engine: CYCLES, WORKBENCH or EEVEE.
        turn: degrees around the building from where most cameras stand.

    Raises:
        ValueError: it has no mesh.
    """
    meshes = imported.objects("Mesh")
    if not meshes:
        raise ValueError("no mesh to render")
    for layer in scene.view_layers:
        layer.update()  # fresh objects have no world matrices yet
    stage = bpy.data.scenes.new(_RIG)
    made: list[bpy.types.ID] = []
    try:
        made += _add_copies(stage, meshes)
        stage.view_layers[0].update()
        corners = _world_vertices(meshes)
        made += _add_camera(stage, imported, corners, turn, size)
        made += [*_add_light(stage, corners), *_add_ground(stage, corners)]
        _settings(stage, path, size, samples, engine)
        stage.display.shading.color_type = "TEXTURE" if imported.shows_texture else "VERTEX"
        bpy.ops.render.render(write_still=True, scene=stage.name)
    finally:
        bpy.data.scenes.remove(stage, do_unlink=True)
        bpy.data.batch_remove(made)


def _add_copies(stage: bpy.types.Scene, meshes: list[bpy.types.Object]) -> list[bpy.types.ID]:
    """Add copies of the meshes to the stage, in materials that keep the light of the photos; returns their data."""
    made: list[bpy.types.ID] = []
    for obj in meshes:
        material = _matte_material(texture(obj.data) if shown(obj.data) == "TEXTURE" else None)
        copy = obj.copy()
        copy.parent = None
        copy.matrix_world = obj.matrix_world
        copy.hide_render = False
        for slot in copy.material_slots:
            slot.link, slot.material = "OBJECT", material
        stage.collection.objects.link(copy)
        made += [material, copy]
    return made


def _matte_material(picture: bpy.types.Image | None) -> bpy.types.Material:
    """Make a matte material with some emission, in the colours of a texture or else of the vertices."""
    material, shader = new_material(_RIG, 0.9, specular=0.1)
    nodes, links = material.node_tree.nodes, material.node_tree.links
    if picture is not None:
        color = add_texture_node(material.node_tree, picture)
    else:
        color = nodes.new("ShaderNodeAttribute")
        color.attribute_name = COLOR_ATTRIBUTE
    for name in ("Base Color", "Emission Color"):
        links.new(color.outputs["Color"], shader.inputs[name])
    shader.inputs["Emission Strength"].default_value = _OWN_LIGHT
    return material


def _world_vertices(meshes: list[bpy.types.Object]) -> np.ndarray:
    """Return a sample of the vertices in world coordinates, [N, 3]."""
    clouds = []
    for obj in meshes:
        matrix, xyz = np.array(obj.matrix_world), vertices_of(obj.data)
        xyz = xyz[:: max(1, len(xyz) // 200_000)]
        clouds.append(xyz @ matrix[:3, :3].T + matrix[:3, 3])
    return np.concatenate(clouds)


def _add_camera(
    stage: bpy.types.Scene, imported: ImportedScene, xyz: np.ndarray, turn: float, size: tuple[int, int]
) -> list[bpy.types.ID]:
    """Add a camera that frames the building from the side of the cameras, a little above them; returns its data."""
    low, high = np.percentile(xyz, [0.5, 99.5], axis=0)
    middle = (low + high) / 2
    stands = np.array([np.array(o.matrix_world)[:3, 3] for o in imported.objects("Cameras")]).reshape(-1, 3)
    rotation = _direction(middle, stands, turn).to_track_quat("Z", "Y").to_matrix()
    data = bpy.data.cameras.new(_RIG)
    data.lens = _LENS
    obj = bpy.data.objects.new(_RIG, data)
    stage.collection.objects.link(obj)
    stage.camera = obj
    distance, shift = _fit(xyz, middle, np.array(rotation), size)
    eye = middle + np.array(rotation) @ np.array([*shift, distance])
    obj.matrix_world = Matrix.Translation(eye.tolist()) @ rotation.to_4x4()
    reach = float(np.linalg.norm(high - low))
    data.clip_start, data.clip_end = 1e-3 * reach, 1e3 * reach
    return [obj, data]


def _direction(middle: np.ndarray, stands: np.ndarray, turn: float) -> Vector:
    """Return the unit vector from the building's middle [3] to the eye, for cameras that stand at ``stands`` [N, 3]."""
    around = stands - middle
    view = around.mean(axis=0) if len(stands) else np.array([0.0, -1.0, 0.0])
    if len(stands) and np.linalg.norm(view[:2]) < 0.3 * np.linalg.norm(around[:, :2], axis=1).mean():
        view = around[0]  # photos all around: any side is as good
    angle, up = math.atan2(view[1], view[0]) + math.radians(turn), math.radians(_ELEVATION)
    return Vector((math.cos(angle) * math.cos(up), math.sin(angle) * math.cos(up), math.sin(up)))


def _fit(xyz: np.ndarray, middle: np.ndarray, rotation: np.ndarray, size: tuple[int, int]) -> tuple[float, np.ndarray]:
    """Return distance and sideways shift [2] of a camera that sees the 0.5th to 99.5th percentiles, with a margin."""
    local = (xyz - middle) @ rotation  # camera axes: x right, y up, z towards the camera
    low, high = np.percentile(local, [0.5, 99.5], axis=0)
    tangent = 36.0 / (2 * _LENS)
    aspect = size[1] / size[0]
    half = (high - low) / 2
    distance = max(half[0] / tangent, half[1] / (tangent * aspect)) * 1.12 + half[2]
    return float(distance), (low + high)[:2] / 2


def _add_light(stage: bpy.types.Scene, xyz: np.ndarray) -> list[bpy.types.ID]:
    """Add a pale sky and a warm sun from behind the camera's left shoulder; returns their data."""
    world = bpy.data.worlds.new(_RIG)
    stage.world = world
    if not world.node_tree:
        world.use_nodes = True
    background = next(n for n in world.node_tree.nodes if n.type == "BACKGROUND")
    background.inputs["Color"].default_value = (*_SKY, 1)
    background.inputs["Strength"].default_value = 0.75
    sun = bpy.data.lights.new(_RIG, "SUN")
    sun.energy, sun.angle, sun.color = 2.6, math.radians(2.0), (1.0, 0.95, 0.87)
    obj = bpy.data.objects.new(_RIG, sun)
    stage.collection.objects.link(obj)
    eye = Vector(stage.camera.matrix_world.translation) - Vector(xyz.mean(axis=0).tolist())
    azimuth = math.atan2(eye.y, eye.x) + math.radians(40)
    high = math.radians(42)
    direction = Vector((math.cos(azimuth) * math.cos(high), math.sin(azimuth) * math.cos(high), math.sin(high)))
    obj.rotation_euler = direction.to_track_quat("Z", "Y").to_euler()
    return [world, obj, sun]


def _add_ground(stage: bpy.types.Scene, xyz: np.ndarray) -> list[bpy.types.ID]:
    """Add a wide pale disc under the building, on which it casts a shadow; returns its data."""
    low, high = np.percentile(xyz, [0.5, 99.5], axis=0)
    reach = float(np.linalg.norm(high - low)) * 20
    angles = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    middle = (low + high) / 2
    rim = [(middle[0] + reach * math.cos(a), middle[1] + reach * math.sin(a), low[2]) for a in angles]
    mesh = bpy.data.meshes.new(_RIG)
    mesh.from_pydata(rim, [], [tuple(range(64))])
    material, shader = new_material(_RIG, 1.0, specular=0.5)
    shader.inputs["Base Color"].default_value = (0.55, 0.55, 0.53, 1)
    mesh.materials.append(material)
    obj = bpy.data.objects.new(_RIG, mesh)
    stage.collection.objects.link(obj)
    return [obj, mesh, material]


def _can_denoise() -> bool:
    """Tell whether this build of Blender has a denoiser: those of some distributions lack it and refuse to."""
    try:
        import _cycles
    except ImportError:
        return True
    return bool(getattr(_cycles, "with_openimagedenoise", True))


def _settings(stage: bpy.types.Scene, path: Path, size: tuple[int, int], samples: int, engine: str) -> None:
    render = stage.render
    render.engine = {"CYCLES": "CYCLES", "WORKBENCH": "BLENDER_WORKBENCH", "EEVEE": EEVEE}[engine]
    render.resolution_x, render.resolution_y, render.resolution_percentage = *size, 100
    render.filepath = str(path)
    render.image_settings.file_format = "PNG"
    stage.view_settings.view_transform = "AgX"
    stage.view_settings.look = "AgX - Medium High Contrast"
    if engine == "CYCLES":
        stage.cycles.samples = samples
        stage.cycles.use_denoising = _can_denoise()
        stage.cycles.max_bounces = 4
    elif engine == "EEVEE":
        stage.eevee.taa_render_samples = samples
    else:
        stage.display.shading.light = "STUDIO"
        stage.display.shading.show_cavity = True
        stage.display.shading.show_shadows = True
        stage.display.shading.background_type = "VIEWPORT"
