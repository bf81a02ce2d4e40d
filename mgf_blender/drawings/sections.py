# SPDX-License-Identifier: GPL-3.0-or-later
"""Section planes: objects that say where to cut; their z axis points to whoever looks at the section.

The add-on's own are squares under the scene's empty; any mesh or empty of the user's can be one as well.
"""

from __future__ import annotations

import re

import bpy
import numpy as np
from mathutils import Matrix

from ..scene_import.imported_scene import FIELD_KEY, KIND_KEY, ROLE_KEY, SECTION, ImportedScene, is_own, objects_below

THEIRS = "section of the user"
_NAME = "Section"
#: World axes (columns) of a new plane, whose last one is its normal.
AXES = {
    "LEVEL": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "FRONT": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    "SIDE": ((0, 1, 0), (0, 0, 1), (1, 0, 0)),
}


def find_sections(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Find the scene's section planes, by name; those of other files are not ours."""
    found = [o for o in objects_below(scene.collection) if o.get(ROLE_KEY) in (SECTION, THEIRS) and is_own(o)]
    return sorted(found, key=lambda o: o.name)


def may_be_section(obj: bpy.types.Object) -> bool:
    """Tell whether an object of the user's can say where to cut."""
    return obj.type in {"MESH", "EMPTY"} and ROLE_KEY not in obj and KIND_KEY not in obj and is_own(obj)


def add_section(imported: ImportedScene, axis: str) -> bpy.types.Object:
    """Return a square through the middle of the mesh, or of the points where there is none."""
    from_world, (low, high) = imported.from_world(), _bounds(imported)
    size = 0.6 * float((high - low).max()) or 1.0
    corners = [(-size, -size, 0), (size, -size, 0), (size, size, 0), (-size, size, 0)]
    mesh = bpy.data.meshes.new(_NAME)
    mesh.from_pydata(corners, [], [(0, 1, 2, 3)])
    obj = bpy.data.objects.new(_NAME, mesh)
    obj[ROLE_KEY] = SECTION
    obj.display_type, obj.hide_render, obj.show_axis = "WIRE", True, True
    imported.collection.objects.link(obj)
    obj.parent = imported.root
    world = np.eye(4)
    world[:3, :3], world[:3, 3] = np.array(AXES[axis], float).T, (low + high) / 2
    obj.matrix_parent_inverse = Matrix.Identity(4)
    obj.matrix_basis = Matrix((from_world @ world).tolist())
    return obj


def remove_section(obj: bpy.types.Object) -> None:
    """Delete a plane of ours; an object of the user's stays and is no section any more."""
    if obj.get(ROLE_KEY) == THEIRS:
        del obj[ROLE_KEY]
        return
    mesh = obj.data
    bpy.data.objects.remove(obj, do_unlink=True)
    if mesh is not None and mesh.users == 0:
        bpy.data.meshes.remove(mesh)


def section_texts(scene: bpy.types.Scene, imported: ImportedScene) -> list[str]:
    """Return the planes as the engine reads them: ``NAME=x,y,z,nx,ny,nz`` in coordinates of the job's mesh."""
    root, texts, taken = np.array(imported.root.matrix_world, np.float64), list[str](), set[str]()
    for obj in find_sections(scene):
        point, normal = plane_of(obj)
        inside = imported.from_world() @ np.append(point, 1.0)
        turned = root[:3, :3].T @ normal
        turned /= max(float(np.linalg.norm(turned)), 1e-300)
        numbers = ",".join(f"{v:.12g}" for v in (*(inside[:3] + imported.offset), *turned))
        texts.append(f"{_file_name(obj.name, taken)}={numbers}")
    return texts


def plane_of(obj: bpy.types.Object) -> tuple[np.ndarray, np.ndarray]:
    """Return a point [3] and the normal [3] of an object in the world: of its one face, else its origin and z axis."""
    world = np.array(obj.matrix_world, np.float64)
    point, normal = np.zeros(3), np.array([0.0, 0.0, 1.0])
    if obj.type == "MESH" and len(obj.data.polygons) == 1:
        point, normal = (np.array(v) for v in (obj.data.polygons[0].center, obj.data.polygons[0].normal))
    x, y, z = world[:3, :3].T
    # The cofactors turn normals as the inverse does, and are there for a plane that somebody scaled flat, too.
    cofactors = np.stack([np.cross(y, z), np.cross(z, x), np.cross(x, y)], axis=1)
    side = -1.0 if np.linalg.det(world[:3, :3]) < 0 else 1.0
    return world[:3, :3] @ point + world[:3, 3], side * cofactors @ normal


def _file_name(name: str, taken: set[str]) -> str:
    """Return a name that files may have, and no other plane has: on Windows and macOS not in other cases either."""
    plain = re.sub(r"[^\w-]+", "-", name).strip("-") or "section"
    while plain.casefold() in taken:
        plain += "-2"
    taken.add(plain.casefold())
    return plain


def _bounds(imported: ImportedScene) -> tuple[np.ndarray, np.ndarray]:
    """Return lower and upper corner of the mesh, else of the sparse points, world coordinates.

    The Gaussian field, which reaches beyond the building, does not count.
    """
    there = [o for kind in ("Mesh", "Points") for o in imported.objects(kind) if not o.get(FIELD_KEY)][:1]
    if not there:
        middle = np.array(imported.root.matrix_world)[:3, 3]
        return middle - imported.radius, middle + imported.radius
    world = np.array(there[0].matrix_world)
    corners = np.array(there[0].bound_box) @ world[:3, :3].T + world[:3, 3]
    return corners.min(axis=0), corners.max(axis=0)
