# SPDX-License-Identifier: GPL-3.0-or-later
"""Docstrings name what there is: cross references lead somewhere, and arguments and errors are described."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
FILES = sorted(path for name in ("mgf_engine", "mgf_blender") for path in (ROOT / name).rglob("*.py"))
REFERENCE = re.compile(r":(?:mod|func|class|data|meth|attr):`~?\.?([^`]+)`")
#: Functions from this many parameters on describe each of them.
MANY = 4
#: Methods whose arguments are those of a base class or of Blender.
INHERITED = {"draw_item"}


def dotted(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


def members(node: ast.ClassDef) -> set[str]:
    """Methods and fields of a class, those that its docstring lists as well."""
    listed = re.findall(r"^ +(\w+(?:, \w+)*):", ast.get_docstring(node) or "", re.M)
    fields = {f.target.id for f in node.body if isinstance(f, ast.AnnAssign) and isinstance(f.target, ast.Name)}
    methods = {f.name for f in node.body if isinstance(f, ast.FunctionDef)}
    return fields | methods | {name for names in listed for name in names.split(", ")}


def names_of(tree: ast.Module) -> dict[str, set[str] | None]:
    """What a module defines or imports: members of its classes, None for all else."""
    found: dict[str, set[str] | None] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef):
            found[node.name] = members(node)
        elif isinstance(node, ast.FunctionDef):
            found[node.name] = None
        elif isinstance(node, ast.Import | ast.ImportFrom):
            found |= {(a.asname or a.name).split(".")[0]: None for a in node.names}
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            found.setdefault(node.id, None)
    return found


MODULES = {dotted(path): names_of(ast.parse(path.read_text(encoding="utf-8"))) for path in FILES}
LAZY = {"read_scene", "make_masks", "train", "extract_mesh", "render", "evaluate"}  # of the package itself


def leads_somewhere(reference: str, module: str, package: str) -> bool:
    for start in ("", f"{module}.", f"{package}.", "mgf_engine."):
        parts = (start + reference).split(".")
        for k in range(len(parts), 0, -1):
            names, rest = MODULES.get(".".join(parts[:k])), parts[k:]
            if names is None:
                continue
            if not rest or (rest[0] in names and (len(rest) == 1 or rest[1] in (names[rest[0]] or (rest[1],)))):
                return True
            break
    owners = [owned for owned in MODULES[module].values() if owned is not None]
    return any(reference in owned for owned in owners) or (module == "mgf_engine" and reference in LAZY)


@pytest.mark.parametrize("path", FILES, ids=dotted)
def test_references_lead_somewhere(path: Path) -> None:
    module = dotted(path)
    package = module if path.name == "__init__.py" else module.rpartition(".")[0]
    found = REFERENCE.findall(path.read_text(encoding="utf-8"))
    assert not [name for name in found if not leads_somewhere(name, module, package)]


def public_functions(path: Path) -> Iterator[ast.FunctionDef]:
    """Functions of the module and methods of its classes, but for those that begin with an underscore."""
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        inside = node.body if isinstance(node, ast.ClassDef) and not node.name.startswith("_") else [node]
        yield from (f for f in inside if isinstance(f, ast.FunctionDef) and not f.name.startswith("_"))


@pytest.mark.parametrize("path", FILES, ids=dotted)
def test_many_arguments_are_described(path: Path) -> None:
    for function in public_functions(path):
        given = function.args
        names = [a.arg for a in (*given.posonlyargs, *given.args, *given.kwonlyargs) if a.arg not in ("self", "cls")]
        if len(names) < MANY or function.name in INHERITED:
            continue
        listed = (ast.get_docstring(function) or "").partition("Args:")[2]
        missing = [name for name in names if not re.search(rf"(^|[;,]) *{name}[:,]", listed, re.M)]
        assert not missing, f"{function.name}: {missing}"


@pytest.mark.parametrize("path", [path for path in FILES if "mgf_engine" in path.parts], ids=dotted)
def test_errors_are_described(path: Path) -> None:
    for function in public_functions(path):
        own = [n for part in function.body if not isinstance(part, ast.FunctionDef) for n in ast.walk(part)]
        if any(isinstance(node, ast.Raise) and node.exc is not None for node in own):
            assert "Raises:" in (ast.get_docstring(function) or ""), function.name


PACKAGES = [path for path in FILES if path.name == "__init__.py" and path.parent.parent != ROOT]


@pytest.mark.parametrize("path", PACKAGES, ids=dotted)
def test_packages_name_modules_that_they_have(path: Path) -> None:
    text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    named = re.findall(r"``(\w+)``", text)
    assert [name for name in named if not list(path.parent.glob(f"{name}*"))] == []
