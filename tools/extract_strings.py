# SPDX-License-Identifier: GPL-3.0-or-later
"""Every text of the interface, for translators.

    .venv-bpy/bin/python tools/extract_strings.py LOCALE        (for example fr_FR)

Makes or refreshes ``mgf_blender/languages/LOCALE.json``: English -> translated; new texts get an empty translation,
texts that the add-on no longer has are dropped. Labels and descriptions come from Blender's own registry (so the
generated options are in it), all else from the calls that show a text.
"""

from __future__ import annotations

import ast
import json
import os
import sys
from pathlib import Path

REPO = Path(__file__).resolve().parents[1]
ADDON = REPO / "mgf_blender"
sys.path.insert(0, str(REPO))
#: Calls that take a text first, and keywords of interface calls that take one.
_FIRST = {"tr", "N_", "UserError"}
_KEYWORDS = {"text", "title", "message", "confirm_text", "heading"}
_SHOWING = {"label", "column", "row", "operator", "prop", "progress", "invoke_confirm", "operator_menu_enum", "report"}


def source_texts() -> dict[str, str]:
    """Text -> where it stands, from the calls in the add-on's files; the headless script speaks English."""
    found: dict[str, str] = {}
    for path in sorted(ADDON.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call):
                for text in _constants(node):
                    found.setdefault(text, f"{path.relative_to(ADDON)}:{node.lineno}")
    return found


def schema_texts() -> dict[str, str]:
    """Text -> where it stands, from what the engine says of its stages and options."""
    schema = json.loads((ADDON / "options.json").read_text(encoding="utf-8"))
    return {text: f"options.json: {kind}" for kind in ("sections", "stages") for text in schema[kind].values()}


def untranslatable() -> list[str]:
    """Places where a text with values in it is shown without ``tr``: no dictionary could hold it."""
    wrong = []
    for path in sorted(ADDON.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.Call):
                continue
            shown = _arguments(node)
            plain = any(k.arg == "translate" and getattr(k.value, "value", True) is False for k in node.keywords)
            for value in shown:
                mixed = isinstance(value, ast.JoinedStr | ast.BinOp)
                if mixed and not (plain and not _words(value)):
                    wrong.append(f"{path.relative_to(ADDON)}:{node.lineno}")
    return wrong


def registered_texts() -> dict[str, str]:
    """Text -> class, from what Blender registered; the add-on must be on."""
    import bpy

    from mgf_blender import preferences, properties

    found: dict[str, str] = {}
    kinds = [getattr(bpy.types, n) for n in dir(bpy.types) if n.startswith("MGF_")]
    for kind in [*kinds, *properties.CLASSES, preferences.MGF_Preferences]:
        name = kind.__name__
        for text in (getattr(kind, "bl_label", ""), getattr(kind, "bl_description", "")):
            found.setdefault(text, name)
        if issubclass(kind, bpy.types.Operator):
            rna = getattr(bpy.ops.mgf, kind.bl_idname.split(".")[1]).get_rna_type()
            found.setdefault(rna.description, name)
        else:
            rna = kind.bl_rna
        for prop in rna.properties:
            hidden = prop.is_hidden or prop.identifier in {"filepath", "directory"}
            if hidden or prop.identifier not in getattr(kind, "__annotations__", {}):
                continue
            found.setdefault(prop.name, name)
            found.setdefault(prop.description, name)
            for item in prop.enum_items if prop.type == "ENUM" else ():
                found.setdefault(item.name, name)
                found.setdefault(item.description, name)
    return {text: where for text, where in found.items() if text and any(c.isalpha() for c in text)}


def main() -> int:
    """Write the file; returns the exit code."""
    if len(sys.argv) != 2 or sys.argv[1].startswith("-"):
        print(__doc__)
        return 2
    import mgf_blender

    mgf_blender.register()
    path = ADDON / "languages" / f"{sys.argv[1]}.json"
    known = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    texts = sorted({**registered_texts(), **source_texts(), **schema_texts()})
    path.parent.mkdir(exist_ok=True)
    content = {text: known.get(text, "") for text in texts}
    path.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    print(f"{path}: {sum(bool(t) for t in content.values())} of {len(texts)} texts translated")
    return 0


def _constants(node: ast.Call) -> list[str]:
    values = _arguments(node)
    texts = [v.value for v in values if isinstance(v, ast.Constant) and isinstance(v.value, str)]
    return [t for t in texts if any(c.isalpha() for c in t)]


def _arguments(node: ast.Call) -> list[ast.expr]:
    """The arguments of a call that people read."""
    name = node.func.id if isinstance(node.func, ast.Name) else getattr(node.func, "attr", "")
    values = [node.args[0]] if name in _FIRST and node.args else []
    if name in _SHOWING:
        values += [k.value for k in node.keywords if k.arg in _KEYWORDS]
    return values + (node.args[1:2] if name in {"report", "needs"} else [])


def _words(value: ast.expr) -> bool:
    """Whether a mixed text has letters of its own beside its values."""
    return any(
        isinstance(n, ast.Constant) and isinstance(n.value, str) and any(c.isalpha() for c in n.value)
        for part in ast.iter_child_nodes(value)
        if not isinstance(part, ast.FormattedValue)
        for n in ast.walk(part)
    )


if __name__ == "__main__":
    code = main()
    sys.stdout.flush()
    os._exit(code)  # some versions of the bpy module crash or hang while the interpreter ends
