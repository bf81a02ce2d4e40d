# SPDX-License-Identifier: GPL-3.0-or-later
"""Every operator of the add-on in every odd state, for a process of its own: none may raise, or fail half done.

    export BLENDER_USER_RESOURCES=FOLDER/user
    python tests/blender/odd_states.py SEED CALLS FOLDER                      (an environment with bpy)
    blender -b --python tests/blender/odd_states.py -- SEED CALLS FOLDER

CALLS is how many calls are drawn at random, some in two states at once; 0 makes every operator's call in every state.
Before and after each call all panels are drawn; an operator that fails has to say so in one sentence and leave
Blender's data as they were. Faults are printed, with what makes them again; ends with 0 and ``survived`` without any.
"""

from __future__ import annotations

import collections
import contextlib
import faulthandler
import io
import math
import os
import random
import sys
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))
sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parent))
import bpy
from layouts import Recorder, draw
from mathutils import Matrix
from odd import file_states, scene_states
from odd.file_states import finish_jobs
from odd.stage import BASES, Stage

from mgf_blender.common import runner
from mgf_blender.common.errors import UserError
from mgf_blender.jobs import import_status
from mgf_blender.scene_import.crop import find_crop_box
from mgf_blender.scene_import.imported_scene import ImportedScene

#: They open programs of the system, or install.
SKIPPED = {"open_engine_log", "install_engine", "show_preferences"}


def operators() -> list[str]:
    """The add-on's operators."""
    return [name for name in dir(bpy.ops.mgf) if name not in SKIPPED]


#: Each state changes Blender's data, its mode, or what is on disk.
STATES: dict[str, Callable[[Stage], None]] = {
    name: value
    for module in (scene_states, file_states)
    for name, value in vars(module).items()
    if callable(value) and getattr(value, "__annotations__", {}).get("stage") == "Stage" and not name.startswith("_")
}


# Contexts that a call is made in.


@contextlib.contextmanager
def _editor(kind: str, image: str = "") -> Iterator[None]:
    window = bpy.context.window_manager.windows[0]
    area = max(window.screen.areas, key=lambda a: a.width * a.height)
    area.type = kind
    if kind == "IMAGE_EDITOR":
        area.spaces.active.image = next((i for i in bpy.data.images if i.get("mgf_image") == image), None)
    region = next((r for r in area.regions if r.type == "WINDOW"), area.regions[-1])
    with bpy.context.temp_override(window=window, area=area, region=region):
        yield
    area.type = "VIEW_3D"


CONTEXTS: dict[str, Callable[[], contextlib.AbstractContextManager[object]]] = {
    "here": contextlib.nullcontext,
    "viewport": lambda: _editor("VIEW_3D"),
    "photo": lambda: _editor("IMAGE_EDITOR", "photo"),
    "empty image editor": lambda: _editor("IMAGE_EDITOR"),
    "text editor": lambda: _editor("TEXT_EDITOR"),
    "no window": lambda: bpy.context.temp_override(window=None),
}


class Arguments:
    """Values for the properties of operators, good ones and others."""

    def __init__(self, dice: random.Random, stage: Stage) -> None:
        self.dice, self.stage = dice, stage

    def draw(self, operator: str) -> dict[str, object]:
        """Draw values for some of an operator's properties."""
        kind = getattr(bpy.ops.mgf, operator).get_rna_type()
        given = {}
        for prop in kind.properties:
            if prop.identifier != "rna_type" and not prop.is_readonly and self.dice.random() < 0.8:
                given[prop.identifier] = self._value(prop)
        return {name: value for name, value in given.items() if value is not None}

    def _value(self, prop: bpy.types.Property) -> object:
        dice, work = self.dice, self.stage.work
        if prop.type == "BOOLEAN":
            return dice.random() < 0.5
        if prop.type == "ENUM":
            return dice.choice([item.identifier for item in prop.enum_items]) if len(prop.enum_items) else None
        if prop.type == "INT":
            return dice.choice((0, 1, -1, 2, 2**31 - 1, -(2**31)))
        if prop.type == "FLOAT":
            values = dice.choices((9.0, 50.0, 0.0, -1.0, 1e30, math.nan, math.inf), (9, 9, 2, 2, 1, 1, 1), k=2)
            return values if prop.is_array else values[0]
        if prop.identifier == "directory":
            names = ("house", "house/job", "other job", "plain", "Ostviertel", "empty", "nowhere", "noise.bin", "")
        elif prop.identifier == "filepath":
            names = ("house", "prompts.json", "marks.csv", "noise.bin", "empty", "nowhere/x.json", "new.json", "")
        else:
            names = ("", "a", "Section", "log.txt", "orthophoto-A.png", "../../x", "nowhere", "\u00fc" * 300)
            return dice.choice(names)
        name = dice.choice(names)
        return str(work / name) if name else ""


class Fault(Exception):
    """Something that must not happen; the message says what."""


class Call:
    """One call of an operator in a state.

    Args:
        base: of :data:`BASES`.
        states: names of :data:`STATES`.
        operator: its name.
        context: of :data:`CONTEXTS`.
        given: values of its properties.
    """

    def __init__(
        self, base: str, states: tuple[str, ...], operator: str, context: str, given: dict[str, object]
    ) -> None:
        self.base, self.states, self.operator, self.context, self.given = base, states, operator, context, given

    def __str__(self) -> str:
        given = ", ".join(f"{name}={value!r}"[:120] for name, value in self.given.items())
        return f"{self.base} / {' + '.join(self.states)} / {self.context}: {self.operator}({given})"

    def make(self, stage: Stage) -> str:
        """Make the call; returns its answer.

        Raises:
            Fault: something raised, was not said in a sentence, or failed half done.
        """
        stage.begin(self.base)
        for state in self.states:
            with contextlib.suppress(RuntimeError, UserError, OSError):  # the second does not fit the first
                STATES[state](stage)
        printed = io.StringIO()
        with contextlib.redirect_stderr(printed), _without_privileges():
            answer = self._make()
        if "Traceback" in printed.getvalue():
            raise Fault(printed.getvalue())
        return answer

    def _make(self) -> str:
        look()
        bpy.ops.ed.undo_push(message="before")
        before = content()
        text, outcome, in_editor = "", {"CANCELLED"}, self.context not in {"here", "no window"}
        with CONTEXTS[self.context]():
            try:
                # With undo, Blender 5.0 crashes in an editor that has no window to draw its redo panel.
                outcome = getattr(bpy.ops.mgf, self.operator)("EXEC_DEFAULT", not in_editor, **self.given)
            except RuntimeError as error:
                text = str(error).strip()
        check_sentence(text)
        if outcome == {"CANCELLED"} and text and not runner.jobs():  # a run of the engine may leave what it was given
            compare(before, content(), text)
        look()
        if in_editor and outcome == {"FINISHED"}:
            bpy.ops.ed.undo_push(message="after")
        for step in (bpy.ops.ed.undo, bpy.ops.ed.redo):
            if step.poll():
                step()
                look()
        finish_jobs()
        for job in runner.jobs():
            for text_ in (job.text, *job.warnings):
                check_sentence(text_)
        for problem in import_status._problems.values():
            check_sentence(problem)
        look()
        return text or "".join(outcome)


def check_sentence(text: str) -> None:
    """Raise when an error is no sentence that a user can read."""
    if "The engine ended with code" in text:  # and its own last words
        return
    for bad in ("Traceback", "made a mistake", "Error(", "Errno", "<bpy", "NoneType"):
        if bad in text:
            raise Fault(f"not a sentence for users: {text}")


def compare(before: dict[str, object], after: dict[str, object], text: str) -> None:
    """Raise when a call that failed changed something."""
    for name in before:
        if before[name] != after[name]:
            raise Fault(f"failed ({text}) but changed {name}: {_difference(before[name], after[name])}")


def _difference(before: object, after: object) -> str:
    if isinstance(before, dict) and isinstance(after, dict):
        keys = [k for k in {**before, **after} if before.get(k) != after.get(k)]
        return "; ".join(f"{k}: {before.get(k)!r} -> {after.get(k)!r}" for k in keys[:4])[:600]
    return f"{before!r} -> {after!r}"[:600]


def look() -> None:
    """Draw everything, as Blender does after each step."""
    scene = bpy.context.scene
    bpy.context.view_layer.update()
    find_crop_box(ImportedScene.find(scene))
    for cls in bpy.types.Panel.__subclasses__():
        if cls.__name__.startswith("MGF_PT_"):
            draw(cls)
    for cls in bpy.types.UIList.__subclasses__():
        if cls.__name__.startswith("MGF_UL_"):
            items = scene.mgf.photos if "photos" in cls.__name__ else scene.mgf.georef.points
            for item in items:
                cls.draw_item(None, bpy.context, Recorder(), None, item, 0, None, "")


def content() -> dict[str, object]:
    """What an operator can change in Blender's data, but for images that were loaded to be looked at."""
    stores = ("scenes", "objects", "collections", "meshes", "cameras", "materials")
    found: dict[str, object] = {name: {b.name_full: True for b in getattr(bpy.data, name)} for name in stores}
    found["mode"], scene = bpy.context.mode, bpy.context.scene
    found["scene"] = {"name": scene.name_full, "camera": scene.camera.name_full if scene.camera else None,
                      **{k: str(v) for k, v in scene.items() if k != "mgf"}}  # fmt: skip
    found["state"] = _values(scene.mgf)
    found["placed"] = {o.name_full: _facts(o) for o in bpy.data.objects}
    return found


def _facts(obj: bpy.types.Object) -> tuple[object, ...]:
    numbers = [round(v, 5) if math.isfinite(v) else str(v) for row in Matrix(obj.matrix_basis) for v in row]
    return (numbers, obj.parent.name_full if obj.parent else None, obj.hide_render, obj.data and obj.data.name_full,
            sorted(obj.keys()), [c.name_full for c in obj.users_collection],
            obj.hide_get() if obj.name in bpy.context.view_layer.objects else None)  # fmt: skip


def _values(group: bpy.types.PropertyGroup) -> object:
    found = {}
    for prop in group.bl_rna.properties:
        if prop.identifier in {"rna_type", "name", "key", "job_folder"}:  # the last is chosen when it is first needed
            continue
        value = getattr(group, prop.identifier)
        if prop.type == "POINTER":
            value = _values(value)
        elif prop.type == "COLLECTION":
            value = [_values(item) for item in value]
        elif getattr(prop, "is_array", False):
            value = str(list(value))
        elif isinstance(value, float):
            value = str(value)
        found[prop.identifier] = value
    return found


@contextlib.contextmanager
def _without_privileges() -> Iterator[None]:
    """As root, obey the permissions of files as everybody else does (Linux)."""
    if sys.platform != "linux" or os.geteuid() != 0:
        yield
        return
    import ctypes

    libc = ctypes.CDLL(None, use_errno=True)
    head = (ctypes.c_uint32 * 2)(0x20080522, 0)  # version 3 of the structure, this thread
    data = (ctypes.c_uint32 * 6)()
    libc.capget(head, data)
    before = data[0]
    data[0] = before & ~0b110  # CAP_DAC_OVERRIDE, CAP_DAC_READ_SEARCH
    libc.capset(head, data)
    try:
        yield
    finally:
        data[0] = before
        libc.capset(head, data)


def all_calls(dice: random.Random, arguments: Arguments) -> Iterator[Call]:
    """Every operator in every state of the finished work, and without arguments in one of another."""
    for state in STATES:
        for operator in operators():
            for base, given in (("finished", arguments.draw(operator)), (dice.choice(BASES), {})):
                yield Call(base, (state,), operator, dice.choice(list(CONTEXTS)), given)


def random_calls(dice: random.Random, arguments: Arguments, count: int) -> Iterator[Call]:
    """Some of all, in one or two states."""
    for _ in range(count):
        states = tuple(dice.sample(list(STATES), dice.choice((1, 1, 2))))
        operator = dice.choice(operators())
        yield Call(dice.choice((*BASES, "finished")), states, operator, dice.choice(list(CONTEXTS)),
                   arguments.draw(operator))  # fmt: skip


def main(seed: int, count: int, folder: Path) -> int:
    """Make the calls; returns the number of faults."""
    os.chdir(folder)  # some names are relative
    stage, dice = Stage(folder), random.Random(seed)
    arguments = Arguments(dice, stage)
    calls = random_calls(dice, arguments, count) if count else all_calls(dice, arguments)
    answers: collections.Counter[str] = collections.Counter()
    faults = 0
    last = (folder / "last call.txt").open("w")
    for number, call in enumerate(calls):
        last.seek(0)
        last.truncate()
        last.write(f"{number} {call}\n")  # what a crash leaves
        last.flush()
        try:
            answers[call.make(stage)] += 1
        except Exception as error:
            faults += 1
            text = str(error) if isinstance(error, Fault) else traceback.format_exc()
            print(f"\nFAULT in call {number}: {call}\n{text}", flush=True)
    if os.environ.get("ODD_ANSWERS"):
        for text, times in answers.most_common():
            print(times, text)
    return faults


if __name__ == "__main__":
    faulthandler.enable()
    words = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    try:
        faults = main(int(words[0]), int(words[1]), Path(words[2]).absolute())
    except BaseException:
        traceback.print_exc(file=sys.stdout)
        faults = 1
    runner.stop_all()
    print(f"\n{faults} faults" if faults else "\nsurvived", flush=True)
    os._exit(min(faults, 1))
