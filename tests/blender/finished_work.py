# SPDX-License-Identifier: GPL-3.0-or-later
"""What can lie beside or in a finished job: its georeference, models with levels of detail, a town of such jobs."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import bpy
import numpy as np

#: Local frame of the models -> scene: turned by a quarter about z, twice as large, far away.
TO_SCENE = np.array([[0, -2, 0, 500.0], [2, 0, 0, -300.0], [0, 0, 2, 7.0], [0, 0, 0, 1]])
SIZES = 3.0, 2.0, 1.0  # of the square that each level is
OFFSET = [691234.0, 5334876.0, 500.0]  # of the local frame


def write_georef(path: Path, rotation: np.ndarray, method: str) -> None:
    """A ``georef.json`` in UTM: the scene is turned by a matrix [3, 3], doubled and moved to the local frame."""
    to_local = np.eye(4)
    to_local[:3, :3], to_local[:3, 3] = 2.0 * rotation, [3.0, -1.0, 19.0]
    data = {
        "format": 1, "to_local": to_local.tolist(), "offset": OFFSET, "crs": "EPSG:25832", "unit": "metre",
        "up_known": True, "north_known": True, "method": method, "heights": "", "origin": [48.1, 11.6, 500.0],
        "accuracy": {},
    }  # fmt: skip
    path.write_text(json.dumps(data))


def write_models(folder: Path) -> Path:
    """Three textured squares as GLB and an index, made with Blender's own exporter."""
    folder.mkdir(parents=True)
    files = {}
    bpy.ops.wm.read_factory_settings(use_empty=True)
    for level, size in enumerate(SIZES):
        mesh = bpy.data.meshes.new("square")
        mesh.from_pydata([(0, 0, 1), (size, 0, 1), (size, size, 1), (0, size, 1)], [], [(0, 1, 2), (0, 2, 3)])
        mesh.uv_layers.new()
        material = bpy.data.materials.new("building")
        material.use_nodes = True
        picture = bpy.data.images.new(f"picture {level}", 4, 4)
        picture.pack()
        node = material.node_tree.nodes.new("ShaderNodeTexImage")
        node.image = picture
        shader = next(n for n in material.node_tree.nodes if n.type == "BSDF_PRINCIPLED")
        material.node_tree.links.new(node.outputs["Color"], shader.inputs["Base Color"])
        mesh.materials.append(material)
        obj = bpy.data.objects.new("building", mesh)
        bpy.context.scene.collection.objects.link(obj)
        name = f"mesh_lod{level}.glb"
        bpy.ops.export_scene.gltf(filepath=str(folder / name))
        bpy.data.objects.remove(obj)
        files[name] = {"kind": "lod", "level": level, "faces": 2}
    files["building.city.json"] = {"kind": "solid"}
    (folder / "models.json").write_text(json.dumps({"format": 1, "files": files, "to_scene": TO_SCENE.tolist()}))
    return folder


def write_light(path: Path, corner: tuple[float, float, float]) -> None:
    """A tetrahedron in the local frame."""
    places = np.add(corner, [[0, 0, 0], [4, 0, 0], [0, 4, 0], [1, 1, 3]])
    faces = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]
    names = "".join(f"property float {axis}\n" for axis in "xyz")
    names += "".join(f"property uchar {channel}\n" for channel in ("red", "green", "blue"))
    head = f"ply\nformat ascii 1.0\nelement vertex 4\n{names}element face 4\nproperty list uchar int vertex_indices\n"
    rows = [f"{x} {y} {z} 200 90 40" for x, y, z in places] + [f"3 {a} {b} {c}" for a, b, c in faces]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(head + "end_header\n" + "\n".join(rows) + "\n")


def write_town(folder: Path, job: Path) -> Path:
    """Two finished buildings and one that failed; the scene is doubled and moved on its way to the local frame.

    Args:
        job: a finished one, copied for each building.
    """
    for name, corner in (("a", (0, 0, 0)), ("b", (20, 0, 1))):
        write_light(folder / "buildings" / name / "light.ply", corner)
        (folder / "buildings" / name / "done.json").write_text(json.dumps({"confidence": 0.75}))
        shutil.copytree(job, folder / "buildings" / name / "job")
    write_light(folder / "terrain" / "terrain.ply", (-5, -5, -1))
    rows = [{"id": name} for name in ("a", "b", "failed")]
    (folder / "buildings.json").write_text(json.dumps({"format": 1, "buildings": rows}))
    write_georef(folder / "georef.json", np.eye(3), "gps")
    return folder
