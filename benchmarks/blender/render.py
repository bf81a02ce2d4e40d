# SPDX-License-Identifier: GPL-3.0-or-later
"""Render one synthetic scene with Cycles: ``python render.py FOLDER`` in a Python that has ``bpy``.

Reads ``FOLDER/work/job.json`` and ``FOLDER/work/parts.npz``; writes ``work/photos/*.png`` (what the camera sees),
``work/ids/*.png`` (which element each pixel's centre hits) and ``work/alone/*.png`` (the same with the
surroundings taken away). Pictures that are there already are kept, so a stopped render goes on where it was.
Only the files of this folder import ``bpy``; the engine starts them as a process.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from materials import MATERIALS
from mathutils import Matrix


def main(folder: Path) -> None:
    job = json.loads((folder / "work/job.json").read_text(encoding="utf-8"))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    outside = _add_parts(folder / "work/parts.npz", float(job["texture_strength"]))
    camera = _add_camera(job)
    _set_engine(job)
    todo = [(kind, shot) for kind in ("photos", "ids", "alone") for shot in job["shots"]]
    lights: list[Any] = []
    current = ""
    for number, (kind, shot) in enumerate(todo):
        if kind != current:
            current = kind
            lights = _add_light(job) if kind == "photos" else _flat_ids(lights, outside if kind == "alone" else [])
        target = folder / "work" / kind / (Path(shot["name"]).stem + ".png")
        if not target.exists():
            _render(camera, shot, target, exposure=shot["exposure"] if kind == "photos" else 0.0)
        print(f"rendered {number + 1} of {len(todo)}", flush=True)


def _add_parts(path: Path, strength: float) -> list[Any]:
    """One object per part; returns those that are not the building."""
    data = np.load(path, allow_pickle=False)
    table = json.loads(str(data["table"]))
    materials: dict[str, Any] = {}
    outside = []
    for i, part in enumerate(table):
        vertices, loops, sizes = data[f"v{i}"], data[f"l{i}"], data[f"s{i}"]
        mesh = bpy.data.meshes.new(part["name"])
        ends = np.cumsum(sizes)
        mesh.from_pydata(
            vertices, [], [tuple(int(k) for k in loops[e - n : e]) for e, n in zip(ends, sizes, strict=True)]
        )
        _unwrap(mesh)
        key = part["material"]
        if key not in materials:
            materials[key] = MATERIALS[key](strength)
        mesh.materials.append(materials[key])
        item = bpy.data.objects.new(part["name"], mesh)
        item.pass_index = part["id"]
        bpy.context.scene.collection.objects.link(item)
        if not part["building"]:
            outside.append(item)
    return outside


def _unwrap(mesh: Any) -> None:
    """UV in metres in the plane of each face: u horizontal, v up the slope."""
    count = len(mesh.polygons)
    normals = np.empty((count, 3))
    mesh.polygons.foreach_get("normal", normals.reshape(-1))
    sizes = np.empty(count, dtype=np.int32)
    mesh.polygons.foreach_get("loop_total", sizes)
    index = np.empty(len(mesh.loops), dtype=np.int32)
    mesh.loops.foreach_get("vertex_index", index)
    corners = np.empty((len(mesh.vertices), 3))
    mesh.vertices.foreach_get("co", corners.reshape(-1))
    points = corners[index]
    u = np.stack([-normals[:, 1], normals[:, 0], np.zeros(count)], axis=1)
    flat = np.linalg.norm(u, axis=1) < 0.02
    u[flat] = [1.0, 0.0, 0.0]
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(normals, u)
    owner = np.repeat(np.arange(count), sizes)
    uv = np.stack([(points * u[owner]).sum(1), (points * v[owner]).sum(1)], axis=1)
    mesh.uv_layers.new(name="metres").data.foreach_set("uv", uv.astype(np.float32).ravel())


def _add_camera(job: dict[str, Any]) -> Any:
    """A camera with the job's exact intrinsics (COLMAP pixel convention)."""
    camera = bpy.data.cameras.new("camera")
    item = bpy.data.objects.new("camera", camera)
    scene = bpy.context.scene
    scene.collection.objects.link(item)
    scene.camera = item
    width, height, fx, fy = job["width"], job["height"], job["fx"], job["fy"]
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = width, height, 100
    scene.render.pixel_aspect_x, scene.render.pixel_aspect_y = max(1.0, fy / fx), max(1.0, fx / fy)
    camera.sensor_fit = "HORIZONTAL"
    camera.lens = fx * camera.sensor_width / width
    camera.shift_x = (width / 2 - job["cx"]) / width
    camera.shift_y = (job["cy"] - height / 2) * (fx / fy) / width
    camera.clip_start, camera.clip_end = 0.5, 2000.0
    return item


def _set_engine(job: dict[str, Any]) -> None:
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.render.use_persistent_data = True
    scene.render.threads_mode = "FIXED"
    scene.render.threads = int(job["threads"])
    c = scene.cycles
    c.device, c.samples, c.use_adaptive_sampling, c.seed = "CPU", int(job["samples"]), False, int(job["seed"])
    c.use_denoising, c.denoiser, c.denoising_input_passes = (
        job["denoiser"] != "none",
        "OPENIMAGEDENOISE",
        "RGB_ALBEDO_NORMAL",
    )
    if job["denoiser"] == "fast":
        c.denoising_prefilter, c.denoising_quality = "FAST", "FAST"
    c.max_bounces, c.diffuse_bounces, c.glossy_bounces, c.transmission_bounces = 4, 2, 2, 2
    c.sample_clamp_indirect, c.filter_width = 4.0, float(job["pixel_filter"])
    scene.view_settings.view_transform = "AgX"
    scene.view_settings.look = "AgX - Medium High Contrast"
    scene.render.image_settings.file_format = "PNG"
    scene.render.image_settings.color_mode = "RGB"
    scene.render.image_settings.compression = 30


def _add_light(job: dict[str, Any]) -> list[Any]:
    """A sun and a clear sky."""
    scene = bpy.context.scene
    world = bpy.data.worlds.new("sky")
    scene.world = world
    world.use_nodes = True
    tree = world.node_tree
    sky = tree.nodes.new("ShaderNodeTexSky")
    sky.sky_type = "MULTIPLE_SCATTERING"
    sky.sun_disc = False
    elevation, azimuth = np.radians(job["sun_elevation"]), np.radians(job["sun_azimuth"])
    sky.sun_elevation = float(elevation)
    sky.sun_rotation = float(np.pi / 2 - azimuth)
    background = next(n for n in tree.nodes if n.type == "BACKGROUND")
    background.inputs["Strength"].default_value = float(job["sky_strength"])
    tree.links.new(sky.outputs[0], background.inputs["Color"])
    lamp = bpy.data.lights.new("sun", "SUN")
    lamp.energy, lamp.angle, lamp.color = float(job["sun_strength"]), np.radians(0.6), (1.0, 0.94, 0.85)
    sun = bpy.data.objects.new("sun", lamp)
    toward = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    z = toward / np.linalg.norm(toward)
    x = np.cross([0.0, 0.0, 1.0], z)
    x /= np.linalg.norm(x)
    sun.matrix_world = Matrix([[*row, 0.0] for row in np.stack([x, np.cross(z, x), z], axis=1)] + [[0, 0, 0, 1]])
    scene.collection.objects.link(sun)
    return [sun]


def _flat_ids(lights: list[Any], hide: list[Any]) -> list[Any]:
    """Turn the scene into a picture of object ids: unlit, one sample through each pixel's centre."""
    scene = bpy.context.scene
    for item in [*lights, *hide]:
        item.hide_render = True
    scene.world = bpy.data.worlds.new("black")
    scene.world.use_nodes = True
    next(n for n in scene.world.node_tree.nodes if n.type == "BACKGROUND").inputs["Strength"].default_value = 0.0
    c = scene.cycles
    c.samples, c.use_denoising, c.max_bounces = 1, False, 0
    c.pixel_filter_type, c.filter_width = "BOX", 0.01
    scene.view_settings.view_transform, scene.view_settings.look = "Raw", "None"
    scene.render.dither_intensity = 0.0
    flat = bpy.data.materials.new("ids")
    flat.use_nodes = True
    tree = flat.node_tree
    tree.nodes.clear()
    info, divide = tree.nodes.new("ShaderNodeObjectInfo"), tree.nodes.new("ShaderNodeMath")
    glow, out = tree.nodes.new("ShaderNodeEmission"), tree.nodes.new("ShaderNodeOutputMaterial")
    divide.operation = "DIVIDE"
    divide.inputs[1].default_value = 255.0
    tree.links.new(info.outputs["Object Index"], divide.inputs[0])
    tree.links.new(divide.outputs[0], glow.inputs["Color"])
    tree.links.new(glow.outputs[0], out.inputs["Surface"])
    bpy.context.view_layer.material_override = flat
    return []


def _render(camera: Any, shot: dict[str, Any], target: Path, exposure: float) -> None:
    rotation, translation = np.array(shot["rotation"]), np.array(shot["translation"])
    pose = np.eye(4)
    pose[:3, :3] = rotation.T @ np.diag([1.0, -1.0, -1.0])
    pose[:3, 3] = -rotation.T @ translation
    camera.matrix_world = Matrix(pose.tolist())
    scene = bpy.context.scene
    scene.view_settings.exposure = exposure
    partial = target.with_name(target.stem + ".partial.png")
    scene.render.filepath = str(partial)
    bpy.ops.render.render(write_still=True)
    os.replace(partial, target)


if __name__ == "__main__":
    try:
        main(Path(sys.argv[1]))
    except BaseException:
        import traceback

        traceback.print_exc()
        sys.stderr.flush()
        os._exit(1)
    sys.stdout.flush()
    os._exit(0)  # the bpy module can crash or hang while the interpreter ends
