# SPDX-License-Identifier: GPL-3.0-or-later
"""Enabling and disabling leaves nothing behind; every string keeps the interface's rules."""

from __future__ import annotations

import ast
import importlib
import inspect
import pkgutil
import re
from pathlib import Path

import bpy
import pytest

import mgf_blender

SMALL = {"a", "an", "and", "as", "at", "but", "by", "for", "from", "in", "into", "of", "on", "or", "the", "to", "with",
          }  # fmt: skip


def leftovers() -> dict[str, object]:
    """Everything an add-on could leave in Blender."""
    handlers = {n: [str(f) for f in getattr(bpy.app.handlers, n)] for n in dir(bpy.app.handlers)
                if isinstance(getattr(bpy.app.handlers, n), list)}  # fmt: skip
    keymaps = {c.name: {k.name: len(k.keymap_items) for k in c.keymaps} for c in bpy.context.window_manager.keyconfigs}
    classes = sorted(n for n in dir(bpy.types) if n.startswith("MGF_"))
    return {
        "handlers": handlers, "keymaps": keymaps, "classes": classes, "operators": dir(bpy.ops.mgf),
        "menu": len(bpy.types.TOPBAR_MT_file_import._dyn_ui_initialize()), "scene": "mgf" in dir(bpy.types.Scene),
    }  # fmt: skip


def test_ten_times_on_and_off_leaves_nothing(scene):
    mgf_blender.register()
    mgf_blender.unregister()
    before = leftovers()
    for _ in range(10):
        mgf_blender.register()
        assert bpy.context.scene.mgf is not None and "import_colmap" in dir(bpy.ops.mgf)
        mgf_blender.unregister()
    after = leftovers()
    assert after == before
    assert not after["classes"] and not after["scene"] and not after["operators"]
    from mgf_blender.common import runner

    assert not bpy.app.timers.is_registered(runner._tick)


def our_classes() -> list[type]:
    """Every class of the add-on that Blender registers."""
    found = {}
    for info in pkgutil.walk_packages(mgf_blender.__path__, "mgf_blender."):
        for cls in vars(importlib.import_module(info.name)).values():
            if inspect.isclass(cls) and cls.__name__.startswith("MGF_") and issubclass(cls, bpy.types.bpy_struct):
                found[cls.__name__] = cls
    return list(found.values())


def properties_of(cls: type) -> list:
    """The registered properties that the class itself defines."""
    if issubclass(cls, bpy.types.Operator):
        group, name = cls.bl_idname.split(".")
        known = getattr(getattr(bpy.ops, group), name).get_rna_type().properties
    else:
        known = cls.bl_rna.properties
    return [p for p in known if p.identifier in getattr(cls, "__annotations__", {})]


def interface_texts() -> list[tuple[str, str, str]]:
    """(where, kind, text) of every label and description that Blender shows."""
    texts = []
    for cls in our_classes():
        if getattr(cls, "bl_label", None):
            texts.append((cls.__name__, "label", cls.bl_label))
        if issubclass(cls, bpy.types.Operator):
            texts.append((cls.__name__, "description", cls.__doc__ or ""))
        for prop in properties_of(cls):
            where = f"{cls.__name__}.{prop.identifier}"
            if prop.is_hidden or prop.identifier in {"filepath", "directory"} or prop.type in {"COLLECTION", "POINTER"}:
                continue
            texts += [(where, "label", prop.name), (where, "description", prop.description)]
            for item in prop.enum_items if prop.type == "ENUM" else ():
                texts.append((f"{where}.{item.identifier}", "label", item.name))
                texts.append((f"{where}.{item.identifier}", "description", item.description))
    return texts


def title_case(text: str) -> bool:
    """Whether every word but the small ones, units in parentheses and λ begins in upper case."""
    words = re.split(r"[\s/]+", re.sub(r" (\(.*\)|λ)$", "", text))
    for i, word in enumerate(words):
        first = next((c for c in word if c.isalpha()), "")
        small = word.lower() in SMALL and 0 < i < len(words) - 1
        if first and (first.isupper() if small else not first.isupper()):
            return False
    return True


def written_texts() -> list[tuple[str, str, str]]:
    """(where, call, text) of the texts that panels give to buttons, labels and greyed-out buttons."""
    found = []
    for path in sorted(Path(mgf_blender.__path__[0]).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Attribute):
                continue
            given = [k.value for k in node.keywords if k.arg == "text"]
            given += node.args[1:2] if node.func.attr == "needs" else []
            for value in given:
                if isinstance(value, ast.Constant) and value.value:
                    found.append((f"{path.name}:{node.lineno}", node.func.attr, value.value))
    return found


def test_buttons_are_titles_and_labels_sentences():
    """Buttons and options: Title Case. Labels and reasons: a sentence's case, without the final full stop."""
    texts = written_texts()
    assert {call for _, call, _ in texts} >= {"operator", "label", "needs", "prop"}
    for where, call, text in texts:
        if call in {"operator", "prop"}:
            assert title_case(re.sub(r"\(.*\)", "", text).strip()), (where, text)
        else:
            assert text[0].isupper() and not text.endswith("."), (where, text)


def test_strings_keep_the_interface_rules(addon):
    texts = interface_texts()
    assert len(texts) > 150
    wrong = []
    for where, kind, text in texts:
        if kind == "label":
            if not title_case(text):
                wrong.append((where, kind, text))
        elif not text or text.endswith(".") or not (text[0].isupper() or text[0].isdigit() or text.startswith("w_")):
            wrong.append((where, kind, text))
    assert not wrong


def test_sentences_of_errors_end_with_a_full_stop():
    """Every UserError is a sentence that starts in upper case or with a quoted path."""
    pattern = re.compile(r'UserError\(\s*f?"((?:[^"\\]|\\.)*)"(?:\s*f?"((?:[^"\\]|\\.)*)")?')
    seen = 0
    for path in importlib.import_module("pathlib").Path(mgf_blender.__path__[0]).rglob("*.py"):
        for match in pattern.finditer(path.read_text(encoding="utf-8")):
            text = (match.group(1) + (match.group(2) or "")).strip()
            seen += 1
            assert text.endswith((".", "{error}")), (path.name, text)
    assert seen > 40


@pytest.mark.parametrize("cls", [c for c in our_classes() if issubclass(c, bpy.types.Panel)], ids=lambda c: c.__name__)
def test_panels_have_their_place(addon, cls):
    assert cls.bl_category == "MGF" and cls.bl_idname == cls.__name__
