# SPDX-License-Identifier: GPL-3.0-or-later
"""Every message that people can get, read from the sources: what docs/faq.md has to answer."""

from __future__ import annotations

import ast
import functools
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
GAP = "…"  # where a value goes
#: Calls that say their first text to people, and those that do so with whole sentences only.
_SAYING, _SENTENCES = {"BadInput", "UnreadablePhoto", "UserError", "warning", "warn", "_warn", "Choice"}, {"tr", "N_"}
#: Functions that make sentences for somebody else to say.
_MAKING = {"describe_misfits", "describe_flags", "low_texture_warning", "small_building_warning",
           "missing_text", "sentences", "_ignored_text", "_used_text", "_missed_text", "low_confidence_warning",
           "renamed_values", "choose_device", "poor_photos", "shortage", "diagnose", "check_gpu",
           "_misfit_text", "_outside_text", "_far_text", "_wrong_mark_text", "wrong_marks", "_mistake",
           "unseen_text", "veto_text"}  # fmt: skip
#: A file whose every sentence is said.
_ALL_SAID = ROOT / "mgf_engine" / "errors.py"


@functools.cache
def messages() -> dict[str, str]:
    """Message, with a gap for each value -> the file it stands in."""
    found: dict[str, str] = {}
    for package in ("mgf_engine", "mgf_blender"):
        for path in sorted((ROOT / package).rglob("*.py")):
            for text in _texts(ast.parse(path.read_text(encoding="utf-8")), path == _ALL_SAID):
                found.setdefault(text, str(path.relative_to(ROOT)))
    return found


def _texts(tree: ast.Module, all_said: bool) -> Iterator[str]:
    constants = {
        target.id: template(part.value)
        for part in tree.body
        if isinstance(part, ast.Assign)
        for target in part.targets
        if isinstance(target, ast.Name)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef) and node.name in _MAKING:
            parts = [template(part) for statement in node.body[1:] for part in ast.walk(statement)]
            texts = {t for t in parts if t is not None and t.endswith(".") and len(t.replace(GAP, "").split()) > 5}
            yield from sorted(t for t in texts if not any(t in other and t != other for other in texts))
        text = None
        if isinstance(node, ast.Call) and node.args and _name(node.func) in _SAYING | _SENTENCES:
            text = template(node.args[0]) or constants.get(_name(node.args[0]))
            if text is not None and _name(node.func) in _SENTENCES and not text.endswith("."):
                continue
        elif isinstance(node, ast.Call) and _name(node.func) == "needs" and len(node.args) == 2:
            text = template(node.args[1])
        elif all_said and isinstance(node, ast.Tuple) and len(node.elts) == 2:
            text = template(node.elts[1])
        if text is not None and "%s" not in text and len(text.replace(GAP, "").split()) >= 3:
            yield text


def _name(node: ast.expr) -> str:
    return node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""


def template(node: ast.expr) -> str | None:
    """The text of an expression with a gap for each value; None for what is no text of its own."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return re.sub(r"\{\w+(?:![rs])?(?::[^}]*)?\}", GAP, node.value)  # the add-on's {name}
    if isinstance(node, ast.JoinedStr):
        return "".join(str(p.value) if isinstance(p, ast.Constant) else GAP for p in node.values)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return "".join(GAP if side is None else side for side in (template(node.left), template(node.right)))
    return None
