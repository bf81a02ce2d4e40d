# SPDX-License-Identifier: GPL-3.0-or-later
"""Keys of scenes: what running jobs know a scene by, since no Blender data is held over an undo or another file."""

import uuid

import bpy

#: Key -> ``session_uid`` of the scene that took it. An undo takes the property away, and a copied scene has it, too.
_owners: dict[str, int] = {}


def scene_key(scene: bpy.types.Scene) -> str:
    """Return the scene's key, made on first use; a copied scene gets one of its own."""
    key = key_of(scene) or uuid.uuid4().hex
    if scene.mgf.key != key:
        scene.mgf.key = key
    _owners[key] = scene.session_uid
    return key


def key_of(scene: bpy.types.Scene) -> str:
    """Return the scene's key, or an empty text when it has none yet; changes nothing, so that drawing may ask."""
    key = scene.mgf.key
    if not key:
        return next((k for k, uid in _owners.items() if uid == scene.session_uid), "")
    owner = _owners.get(key, scene.session_uid)
    copied = owner != scene.session_uid and any(s.session_uid == owner for s in bpy.data.scenes)
    return "" if copied else key


def scene_of(key: str) -> bpy.types.Scene | None:
    """Return the scene with a key, if the open file has it."""
    return next((s for s in bpy.data.scenes if key and key_of(s) == key), None)
