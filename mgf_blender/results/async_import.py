# SPDX-License-Identifier: GPL-3.0-or-later
"""Import a finished job in short steps, which read it and build the mesh, so that the window stays responsive.

Blender supports no threads of Python, so none reads. The last step calls ``mgf.import_result``, which links what is
ready, so that the whole import is one undo step. Names and keys are held between the steps, never Blender data: after
an undo or another file in between the mesh is begun anew.
"""

from __future__ import annotations

import contextlib
import time
import uuid
from collections.abc import Iterator
from pathlib import Path

import bpy
import numpy as np

from ..common.errors import UserError, sentence
from ..common.meshes import mesh_steps
from ..common.runner import redraw
from ..jobs import import_status
from ..operator_calls import run_in
from ..scene_keys import key_of, scene_key, scene_of
from .load import SHARP_ANGLE, Content, fitting_scene, reading_steps

_TICK = 0.02  # seconds between two steps
_KEY = "mgf_importing"  # on the mesh while it is built
_RETRIES = 3  # times that a mesh is begun anew because it was not there any more

_imports: dict[str, AsyncImport] = {}  # scene key -> the import under way
_longest = 0.0


class AsyncImport:
    """One import under way.

    Args:
        key: of the scene.
        folder: the job folder.
        offset: of the imported COLMAP scene, or None.
    """

    def __init__(self, key: str, folder: Path, offset: np.ndarray | None) -> None:
        self.key, self.folder, self.offset = key, folder, offset
        self.content: Content | None = None
        self.error: Exception | None = None
        self.mesh_name = ""
        self.ready = False
        self._reading = reading_steps(folder, offset)
        self._steps: Iterator[None] | None = None
        self._lost = 0

    def drain(self) -> bool:
        """Take one step; returns whether there is more to do before the mesh can be linked."""
        if self.content is None and self.error is None:
            return self._read()
        if self.content is None or self.content.mesh is None:
            return False
        try:
            if self._steps is None:
                # A name that nobody takes: giving a mesh a name that is taken may rename the other one.
                mesh = bpy.data.meshes.new(f"MGF {uuid.uuid4().hex}")
                mesh[_KEY] = True
                self.mesh_name = mesh.name
                self._steps = mesh_steps(mesh.name, self.content.mesh, SHARP_ANGLE)
            next(self._steps)
        except StopIteration:
            return False
        except KeyError:  # somebody removed it
            if self._lost == _RETRIES:
                raise
            self._lost += 1
            self.restart()
        return True

    def restart(self) -> None:
        """Build the mesh anew: an undo or another file removed it, or put it back to how it was some steps ago."""
        self.mesh_name, self._steps = "", None

    def take_mesh(self) -> bpy.types.Mesh | None:
        """Return the finished mesh and hand it over to the caller."""
        mesh = bpy.data.meshes.get(self.mesh_name) if self.mesh_name else None
        self.mesh_name = ""
        if mesh is None or _KEY not in mesh:
            return None
        del mesh[_KEY]
        return mesh

    def take_content(self) -> Content | None:
        """Return what was read.

        Raises:
            UserError: it could not be read.
        """
        if isinstance(self.error, UserError):
            raise self.error
        if self.error is not None:
            raise UserError(
                "The results cannot be read ({error!r}); run the job again.", error=self.error
            ) from self.error
        return self.content

    def drop(self) -> None:
        """Remove what was made and not taken."""
        mesh = self.take_mesh()
        if mesh is not None and mesh.users == 0:
            bpy.data.meshes.remove(mesh)

    def _read(self) -> bool:
        """Read the next file; always true, since the mesh is still to be built."""
        try:
            next(self._reading)
        except StopIteration as end:
            self.content = end.value
        except Exception as error:  # shown by the operator
            self.error = error
        return True


def begin(scene: bpy.types.Scene, folder: Path) -> None:
    """Start to bring a job's results into a scene, in place of another job's; does nothing when that is under way."""
    key = scene_key(scene)
    if key in _imports and _imports[key].folder == folder:
        return
    forget(scene)
    import_status.begin(key)
    imported = None
    with contextlib.suppress(UserError):  # the first step says it again, where it is shown
        imported = fitting_scene(scene, folder)
    _imports[key] = AsyncImport(key, folder, imported.offset if imported is not None else None)
    if not bpy.app.background and not bpy.app.timers.is_registered(_tick):
        bpy.app.timers.register(_tick, first_interval=_TICK, persistent=True)


def ready(scene: bpy.types.Scene, folder: Path) -> AsyncImport | None:
    """Return the import of a folder into a scene that has only to be finished: all read, and its mesh built."""
    found = _imports.get(key_of(scene))
    return found if found is not None and found.folder == folder and found.ready else None


def forget(scene: bpy.types.Scene) -> None:
    """Drop the import into a scene that is under way, because it was imported by other means."""
    key = key_of(scene)
    found = _imports.pop(key, None)
    import_status.end(key)
    if found is not None:
        found.drop()


def pump() -> bool:
    """Take one step of every import; returns whether there is more to do. Tests call it in place of the timer."""
    global _longest
    begun = time.perf_counter()
    for key, pending in list(_imports.items()):
        try:
            pending.ready = not pending.drain()
            if not pending.ready:
                continue
            problem = _import(key, pending)
        except Exception as error:  # Blender drops a timer whose function raises
            problem = sentence(error)
        _imports.pop(key, None)
        import_status.end(key, problem)
        pending.drop()
    _longest = max(_longest, time.perf_counter() - begun)
    return bool(_imports)


def longest_step() -> float:
    """Return the longest time in seconds that a step has blocked Blender's main thread; tests measure it."""
    return _longest


def _import(key: str, pending: AsyncImport) -> str:
    """Link what is ready into its scene, if that is still there; return why it failed, empty when it did not."""
    scene = scene_of(key)
    return "" if scene is None else run_in(scene, "import_result", directory=str(pending.folder))


@bpy.app.handlers.persistent
def start_over(*_: object) -> None:
    """Let no half-made mesh outlive an undo or another file (handler); what was read does."""
    for pending in _imports.values():
        pending.restart()
    bpy.data.batch_remove([m for m in bpy.data.meshes if _KEY in m and m.users == 0])


def _tick() -> float | None:
    alive = pump()
    redraw()
    return _TICK if alive else None


_EVENTS = (bpy.app.handlers.undo_post, bpy.app.handlers.redo_post, bpy.app.handlers.load_post)


def register() -> None:
    """Follow undo and other files; the timer starts with the first import."""
    for handlers in _EVENTS:
        handlers.append(start_over)


def unregister() -> None:
    """Leave no timer and no half-made mesh behind."""
    for handlers in _EVENTS:
        if start_over in handlers:
            handlers.remove(start_over)
    if bpy.app.timers.is_registered(_tick):
        bpy.app.timers.unregister(_tick)
    for pending in _imports.values():
        with contextlib.suppress(ReferenceError, AttributeError):
            pending.drop()
    _imports.clear()
    import_status.clear()
