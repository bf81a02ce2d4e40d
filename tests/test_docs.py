# SPDX-License-Identifier: GPL-3.0-or-later
"""What the documents name is there: files, options, variables and modules; generated pages are current."""

from __future__ import annotations

import importlib
import importlib.util
import re
from pathlib import Path

import pytest

from mgf_engine.options.config import option_fields

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md", *sorted(DOCS.glob("*.md"))]
#: Decisions are never changed: what they name may be gone.
DECISIONS = sorted((DOCS / "decisions").glob("*.md"))
KERNELS = "mgf_engine/native/csrc"
SUBJECTS = [str(p.relative_to(ROOT)) for p in (ROOT / KERNELS).iterdir()]
ROOMS = (
    "",
    "mgf_engine",
    "mgf_engine/masks",
    "mgf_engine/raster",
    "mgf_engine/native",
    KERNELS,
    *SUBJECTS,
    "mgf_blender",
)
#: Options of Blender, pip and pytest-xdist.
OTHERS = {"--help", "--command", "--python", "--index-url", "--no-deps", "--require-hashes", "--dist"}
SOURCES = "\n".join(
    path.read_text(encoding="utf-8")
    for folder in ("mgf_engine", "mgf_blender", "benchmarks", "tools", "tests")
    for path in sorted((ROOT / folder).rglob("*.py"))
    if path != Path(__file__)
)


def options() -> set[str]:
    """Every flag that some command of ours takes."""
    named = {"--" + f.name.replace("_", "-") for f in option_fields()}
    switches = {"--no-" + f.name.replace("_", "-") for f in option_fields() if isinstance(f.default, bool)}
    return named | switches | set(re.findall(r'add_argument\(\s*"(--[a-z0-9-]+)"', SOURCES))


@pytest.mark.parametrize("document", [*PAGES, *DECISIONS], ids=lambda p: p.name)
def test_links_lead_to_files(document: Path) -> None:
    text = document.read_text(encoding="utf-8")
    links = [link for link in re.findall(r"\]\(([^)#\s]+)", text) if "://" not in link]
    assert [link for link in links if not (document.parent / link).exists()] == []


@pytest.mark.parametrize("document", PAGES, ids=lambda p: p.name)
def test_files_of_the_code_are_where_they_are_said_to_be(document: Path) -> None:
    named = re.findall(r"`([\w./-]+\.(?:py|c|h|cu|cuh))`", document.read_text(encoding="utf-8"))
    assert [name for name in named if not any((ROOT / room / name).exists() for room in ROOMS)] == []


@pytest.mark.parametrize("document", PAGES, ids=lambda p: p.name)
def test_options_exist(document: Path) -> None:
    named = set(re.findall(r"(?<![\w-])--[a-z][a-z0-9-]+", document.read_text(encoding="utf-8")))
    assert sorted(named - options() - OTHERS) == []


@pytest.mark.parametrize("document", PAGES, ids=lambda p: p.name)
def test_variables_and_modules_exist(document: Path) -> None:
    text = document.read_text(encoding="utf-8")
    assert [name for name in re.findall(r"MGF_[A-Z_]+", text) if name not in SOURCES] == []
    modules = re.findall(r"python -m (mgf_engine[\w.]*|benchmarks[\w.]*)", text)
    places = [ROOT / name.replace(".", "/") for name in modules]
    assert [str(place) for place in places if not (place.is_dir() or place.with_suffix(".py").exists())] == []


def anchors(document: Path) -> set[str]:
    """The anchors of a document's headings, as GitHub and the docs site make them."""
    text = re.sub(r"^```.*?^```", "", document.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    titles = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\s-]", "", title).strip().lower().replace(" ", "-") for title in titles}


@pytest.mark.parametrize("document", [*PAGES, *DECISIONS], ids=lambda p: p.name)
def test_links_to_headings_lead_there(document: Path) -> None:
    links = re.findall(r"\]\(([\w./-]*)#([\w-]+)\)", document.read_text(encoding="utf-8"))
    targets = [(document.parent / path if path else document, anchor) for path, anchor in links]
    assert [(p.name, anchor) for p, anchor in targets if p.suffix == ".md" and anchor not in anchors(p)] == []


def test_the_readme_is_one_page() -> None:
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 120


def test_every_page_is_in_the_menu() -> None:
    menu = set(re.findall(r"[\w/-]+\.md", (ROOT / "mkdocs.yml").read_text(encoding="utf-8")))
    assert {p.relative_to(DOCS).as_posix() for p in DOCS.rglob("*.md")} == menu, "list it in mkdocs.yml"


def test_the_tour_names_every_file_once_and_each_is_there() -> None:
    text = (DOCS / "architecture.md").read_text(encoding="utf-8")
    tour = re.findall(r"`(mgf_engine/[\w./]+)`", text.partition("tour: begin")[2].partition("tour: end")[0])
    assert len(tour) > 40 and len(set(tour)) == len(tour)
    assert [path for path in tour if not (ROOT / path).is_file()] == []


def test_generated_pages_are_current() -> None:
    spec = importlib.util.spec_from_file_location("write_docs", ROOT / "tools" / "write_docs.py")
    assert spec is not None and spec.loader is not None
    tool = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tool)
    assert tool.CLI.read_text(encoding="utf-8") == tool.cli_page(), "run tools/write_docs.py"
    assert tool.ALGORITHMS.read_text(encoding="utf-8") == tool.algorithms_page(), "run tools/write_docs.py"
    assert tool.ARCHITECTURE.read_text(encoding="utf-8") == tool.architecture_page(), "run tools/write_docs.py"


def test_the_python_page_shows_every_public_name_and_each_is_there() -> None:
    import mgf_engine

    shown = re.findall(r"^::: ([\w.]+)$", (DOCS / "api.md").read_text(encoding="utf-8"), re.MULTILINE)
    names = [name.rpartition(".")[2] for name in shown]
    assert {*mgf_engine.__all__} - {"__version__"} <= {*names}
    for module, _, name in (path.rpartition(".") for path in shown):
        assert getattr(importlib.import_module(module), name).__doc__
