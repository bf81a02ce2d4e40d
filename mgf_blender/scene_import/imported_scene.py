# SPDX-License-Identifier: GPL-3.0-or-later
"""The collection of an imported scene: Cameras, Points, Mesh and Renders under one empty.

What the add-on made carries the property ``mgf_kind``; importing again replaces those objects and nothing else.
The empty is kept, with whatever scale and orientation the user gave it.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress

import bpy
import numpy as np
from mathutils import Matrix

from ..common.errors import UserError
from ..common.textures import shows_texture
from .frame import SceneFrame

KINDS = ("Cameras", "Points", "Mesh", "Renders")
KIND_KEY, OFFSET_KEY, RADIUS_KEY, ROLE_KEY = "mgf_kind", "mgf_offset", "mgf_radius", "mgf_role"
TOP = "tree"  # role of the top collection, as files of all versions have it
CROP, SECTION = "crop", "section"  # roles of what the add-on puts there for users to move
FIELD_KEY = "mgf_field"  # on the Gaussian field, which lies beside the sparse points


class ImportedScene:
    """The collections of one imported scene.

    Args:
        collection: the top collection, as made by :meth:`make` or found by :meth:`find`.
    """

    def __init__(self, collection: bpy.types.Collection) -> None:
        self.collection = collection

    @classmethod
    def make(cls, scene: bpy.types.Scene, name: str, frame: SceneFrame) -> ImportedScene:
        """Add an imported scene without objects, in a frame; those whose objects are all gone are removed.

        Raises:
            UserError: the scene is linked from another file.
        """
        check_own(scene)
        tops = [c for c in scene.collection.children if c.get(ROLE_KEY) == TOP]
        for old in [c for c in tops if c.library is None and next(objects_below(c), None) is None]:
            bpy.data.batch_remove([*old.children_recursive, old])
        top = bpy.data.collections.new(name)
        top[ROLE_KEY] = TOP
        scene.collection.children.link(top)
        root = bpy.data.objects.new("", None)  # named where it is placed
        root.empty_display_type = "ARROWS"
        root[ROLE_KEY] = "root"
        _note_frame(root, frame)
        top.objects.link(root)
        imported = cls(top)
        imported.place(name, frame)
        for kind in KINDS:
            imported.child(kind)
        return imported

    def place(self, name: str, frame: SceneFrame) -> None:
        """Give the collection the name and the empty the pose of a scene."""
        root = self.root
        self.collection.name = name
        root.name = f"{name} Origin"  # the name itself is the mesh's, which is what people look for
        root.empty_display_size = 0.25 * frame.radius
        _note_frame(root, frame)
        root.matrix_world = Matrix(frame.matrix().tolist())

    @classmethod
    def find(cls, scene: bpy.types.Scene) -> ImportedScene | None:
        """Find the imported scene that is worked on: that of the active camera, else the newest; None without any."""
        return next(iter(cls.find_all(scene)), None)

    @classmethod
    def find_all(cls, scene: bpy.types.Scene) -> list[ImportedScene]:
        """Find the imported scenes whose empty still exists: that of the active camera first, then the newest.

        Those of other files, linked or as library overrides, are not ours to change.
        """
        own = [c for c in scene.collection.children_recursive if is_own(c)]
        found = [cls(c) for c in reversed(own) if c.get(ROLE_KEY) == TOP and cls(c).root is not None]
        active = scene.camera.parent if scene.camera is not None else None
        return sorted(found, key=lambda imported: imported.root != active)

    @property
    def root(self) -> bpy.types.Object | None:
        """The empty above all objects; None when the user deleted it, or what it knows of the scene."""
        empties = (o for o in self.collection.objects if o.get(ROLE_KEY) == "root")
        return next((o for o in empties if OFFSET_KEY in o and RADIUS_KEY in o), None)

    def from_world(self) -> np.ndarray:
        """Return the matrix from world coordinates to those of the empty, float64 [4, 4].

        Raises:
            UserError: the empty has no size.
        """
        try:
            return np.linalg.inv(np.array(self.root.matrix_world, np.float64))
        except np.linalg.LinAlgError as error:
            raise UserError(
                "'{name}' is scaled to zero; give it a size again, or import the scene again.", name=self.root.name
            ) from error

    @property
    def offset(self) -> np.ndarray:
        """float64 [3], taken off all scene coordinates."""
        root = self.root
        return np.array(root[OFFSET_KEY], np.float64) if root is not None else np.zeros(3)

    @property
    def radius(self) -> float:
        """Size of the scene in its own units."""
        root = self.root
        return float(root[RADIUS_KEY]) if root is not None else 1.0

    @property
    def shows_texture(self) -> bool:
        """Whether the mesh is painted with its texture now."""
        return any(shows_texture(material) for obj in self.objects("Mesh") for material in obj.data.materials)

    def child(self, kind: str) -> bpy.types.Collection:
        """Return the sub-collection of a kind, made when missing."""
        found = next((c for c in self.collection.children if c.get(KIND_KEY) == kind), None)
        if found is None:
            found = bpy.data.collections.new(kind)
            found[KIND_KEY] = kind
            self.collection.children.link(found)
        return found

    def add(self, kind: str, obj: bpy.types.Object, matrix: np.ndarray | None = None) -> None:
        """Put an object of ours under the empty; ``matrix`` [4, 4] is in offset scene coordinates."""
        obj[KIND_KEY] = kind
        self.child(kind).objects.link(obj)
        obj.parent = self.root
        obj.matrix_parent_inverse = Matrix.Identity(4)
        if matrix is not None:
            obj.matrix_basis = Matrix(matrix.tolist())

    def objects(self, kind: str) -> list[bpy.types.Object]:
        """Return the objects of a kind that the add-on made, in whichever of the collections they are now."""
        return [o for o in objects_below(self.collection) if o.get(KIND_KEY) == kind]

    def cameras(self) -> list[bpy.types.Object]:
        """Return the cameras of the photos.

        Raises:
            UserError: there are none left.
        """
        found = self.objects("Cameras")
        if not found:
            raise UserError("The imported scene has no cameras left; import it again.")
        return found

    def clear(self, kind: str) -> None:
        """Remove our objects of a kind with the data only they used."""
        for obj in self.objects(kind):
            data = obj.data
            bpy.data.objects.remove(obj, do_unlink=True)
            _remove_unused(data)

    def clear_all(self) -> None:
        """Remove all that the add-on made but the empty: it is of photos that give way to others."""
        ours = [o for o in objects_below(self.collection) if KIND_KEY in o or o.get(ROLE_KEY) in (CROP, SECTION)]
        datas = {o.data for o in ours if o.data is not None}
        bpy.data.batch_remove(ours)
        for data in datas:
            _remove_unused(data)


def _note_frame(root: bpy.types.Object, frame: SceneFrame) -> None:
    """Note on a scene's empty what it knows of the scene."""
    root[OFFSET_KEY] = [float(v) for v in frame.offset]
    root[RADIUS_KEY] = frame.radius


def is_own(block: bpy.types.ID) -> bool:
    """Tell whether a block is of this file, neither linked nor a library override: only those are ours to change."""
    return block.library is None and block.override_library is None


def check_own(scene: bpy.types.Scene) -> None:
    """Make sure that something can be imported into a scene.

    Raises:
        UserError: it is linked from another file.
    """
    if scene.library is not None:
        raise UserError("The scene is linked from another file; open that file, or go to a scene of this one.")


def objects_below(collection: bpy.types.Collection) -> Iterator[bpy.types.Object]:
    """Return the objects of a collection and of those below it, each once.

    Blender has a list of its own for this, but after an undo it holds freed objects, and reading it ends Blender.
    """
    seen = set()
    for part in (collection, *collection.children_recursive):
        for obj in part.objects:
            if obj not in seen:
                seen.add(obj)
                yield obj


def hide(obj: bpy.types.Object, hidden: bool = True) -> None:
    """Hide or show an object in the viewports of every view layer that has it."""
    for scene in obj.users_scene:
        for layer in scene.view_layers:
            with suppress(RuntimeError):  # not in the layer, whose own list can still name what was just moved
                obj.hide_set(hidden, view_layer=layer)


def is_shown(obj: bpy.types.Object) -> bool:
    """Tell whether a view layer shows an object."""
    for scene in obj.users_scene:
        for layer in scene.view_layers:
            with suppress(RuntimeError):  # as above
                if not obj.hide_get(view_layer=layer):
                    return True
    return False


def _remove_unused(data: bpy.types.ID | None) -> None:
    if data is None or data.users > 0:
        return
    for kind, store in (("Camera", "cameras"), ("Mesh", "meshes"), ("Image", "images")):
        if isinstance(data, getattr(bpy.types, kind)):
            getattr(bpy.data, store).remove(data)
            return
