# SPDX-License-Identifier: GPL-3.0-or-later
"""Imports of the engine and of the add-on go one way: down a declared order of packages, and never in a circle.

Read from the source, so that imports inside functions count like all others: they would only hide a circle.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from mgf_engine.cli.doctor import EXTRAS

ROOT = Path(__file__).resolve().parents[1]
#: Packages and modules of ``mgf_engine``, from the bottom up: each may import those before it.
ORDER = (
    *("errors", "stages", "costs", "system", "files"),  # the machine, its files
    *("options", "messages", "console", "weights"),  # what users ask for, and what they are told
    *("native", "model", "raster", "geometry"),  # kernels, data, drawing, meshes as such
    *("scene", "masks", "start", "field", "openings", "mesh", "texture", "evaluation"),  # the work
    "jobs",  # the job folder, time and memory
    *("georef", "export", "drawings", "models", "runners", "pipeline", "town", "api"),  # whole jobs
    *("cli", "__main__"),
)


#: The same of ``mgf_blender``.
ADD_ON_ORDER = (
    *("common", "compat", "engine"),  # what knows no scene: processes, texts, the engine's environment
    *("scene_keys", "operator_calls", "job_folder", "jobs"),  # a scene's jobs
    *("scene_import", "prompts", "results", "reconstruct"),  # the work
    *("georef", "drawings", "models", "town"),  # tools of finished jobs
    *("properties", "translations", "preferences", "headless", "cli", "batch"),
)


def modules(package: Path) -> dict[str, Path]:
    """Dotted name -> file of every module of a package."""
    found = {}
    for path in sorted(package.rglob("*.py")):
        parts = path.relative_to(package.parent).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imports_of(name: str, path: Path, known: dict[str, Path]) -> Iterator[str]:
    """Modules of the same package that a module imports anywhere, those in functions and for types alone too."""
    package = name.split(".")[0]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == package:
            for alias in node.names:
                whole = f"{node.module}.{alias.name}"
                yield whole if whole in known else str(node.module)
        elif isinstance(node, ast.Import):
            yield from (a.name for a in node.names if a.name in known)


def circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """One circle for each way back that a walk from every node finds, as a list of names; empty where there is none."""
    found: list[list[str]] = []
    done: set[str] = set()

    def walk(node: str, path: list[str]) -> None:
        if node in path:
            found.append([*path[path.index(node) :], node])
        elif node not in done:
            for target in sorted(graph.get(node, ())):
                walk(target, [*path, node])
            done.add(node)

    for node in sorted(graph):
        walk(node, [])
    return found


def part_of(name: str) -> str:
    """The entry of :data:`ORDER` a module belongs to; empty for the package itself, which holds the version."""
    return [*name.split("."), ""][1]


def upwards(graph: dict[str, set[str]], order: tuple[str, ...]) -> list[str]:
    """The imports of packages that come later in the order."""
    place = {part: k for k, part in enumerate(("", *order))}
    return [
        f"{name} imports {target}"
        for name, targets in graph.items()
        for target in targets
        if place.get(part_of(target), 0) > place.get(part_of(name), len(place))
    ]


@pytest.fixture(scope="module")
def graph() -> dict[str, set[str]]:
    known = modules(ROOT / "mgf_engine")
    del known["mgf_engine"]  # hands out the functions of mgf_engine.api when they are asked for
    return {name: {t for t in imports_of(name, path, known) if t != name} for name, path in known.items()}


def test_every_package_has_its_place(graph: dict[str, set[str]]) -> None:
    assert {part_of(name) for name in graph} == set(ORDER), "give a new package its place in ORDER"
    assert len(set(ORDER)) == len(ORDER)


def test_no_module_imports_upwards(graph: dict[str, set[str]]) -> None:
    assert upwards(graph, ORDER) == []


def test_no_circle_of_modules(graph: dict[str, set[str]]) -> None:
    assert not [" -> ".join(circle) for circle in circles(graph)]


def test_circles_are_found_behind_function_level_imports(tmp_path: Path) -> None:
    package = tmp_path / "house"
    package.mkdir()
    texts = {"__init__": "", "wall": "from house.roof import tile", "door": "import house.wall"}
    for name, text in {**texts, "roof": "def f():\n    from house import wall"}.items():
        (package / f"{name}.py").write_text(text)
    known = modules(package)
    graph = {name: set(imports_of(name, path, known)) for name, path in known.items()}
    assert circles(graph) == [["house.wall", "house.roof", "house.wall"]]
    assert graph["house.door"] == {"house.wall"}


def test_the_add_on_imports_no_engine_and_the_engine_no_blender() -> None:
    for package, forbidden in (("mgf_blender", {"mgf_engine", "torch"}), ("mgf_engine", {"bpy", "mgf_blender"})):
        for path in (ROOT / package).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
                names += [node.module or ""] if isinstance(node, ast.ImportFrom) and not node.level else []
                assert not {n.split(".")[0] for n in names} & forbidden, path


@pytest.fixture(scope="module")
def add_on_graph() -> dict[str, set[str]]:
    """Module -> those it imports; a relative import inside a function would hide a circle and is refused."""
    paths = {path.relative_to(ROOT).with_suffix("").as_posix().replace("/", "."): path
             for path in (ROOT / "mgf_blender").rglob("*.py") if path.name != "__init__.py"}  # fmt: skip
    found: dict[str, set[str]] = {}
    for name, path in paths.items():
        tree, targets = ast.parse(path.read_text(encoding="utf-8")), set()
        for node in ast.walk(tree):
            if not isinstance(node, ast.ImportFrom) or not node.level:
                continue
            assert node in tree.body, f"{name}:{node.lineno}"
            base = ".".join([*name.split(".")[: -node.level], *([node.module] if node.module else [])])
            targets |= {t for alias in node.names for t in (f"{base}.{alias.name}", base) if t in paths}
        found[name] = targets
    assert len(found) > 100 and any(found.values())
    return found


def test_the_add_on_has_no_circle(add_on_graph: dict[str, set[str]]) -> None:
    assert not [" -> ".join(circle) for circle in circles(add_on_graph)]


def test_every_package_of_the_add_on_has_its_place(add_on_graph: dict[str, set[str]]) -> None:
    assert {part_of(name) for name in add_on_graph} == set(ADD_ON_ORDER), "give a new package its place in ADD_ON_ORDER"


def test_no_module_of_the_add_on_imports_upwards(add_on_graph: dict[str, set[str]]) -> None:
    assert upwards(add_on_graph, ADD_ON_ORDER) == []


#: Modules that import a package of an extra without a check of their own -> what refuses before they run.
CHECKED = {
    "mgf_engine/georef/bundle_worker.py": "mgf_engine/georef/bundle.py",
    "mgf_engine/town/submit.py": "mgf_engine/town/run.py",
    "mgf_engine/town/result.py": "mgf_engine/town/run.py",
}
#: Their commands name all packages that are missing before they begin.
CHECKED_BY_COMMANDS = ("mgf_engine/drawings", "mgf_engine/models")


def test_packages_of_extras_are_used_only_where_their_lack_is_said() -> None:
    """'mgf suggest-clicks' and 'mgf buildings' took shapely for granted, which only extras brought."""
    extra = {module for _, packages in EXTRAS.values() for module in packages}
    unchecked = []
    for path in sorted((ROOT / "mgf_engine").rglob("*.py")):
        name, text = path.relative_to(ROOT).as_posix(), path.read_text(encoding="utf-8")
        nodes = [n for n in ast.walk(ast.parse(text)) if isinstance(n, ast.Import | ast.ImportFrom)]
        tops = {(n.module or "") if isinstance(n, ast.ImportFrom) else a.name for n in nodes for a in n.names}
        if extra & {top.split(".")[0] for top in tops} and not name.startswith(CHECKED_BY_COMMANDS):
            checker = (ROOT / CHECKED.get(name, name)).read_text(encoding="utf-8")
            if "except ImportError" not in checker and "is_installed" not in checker:
                unchecked.append(name)
    assert unchecked == []
