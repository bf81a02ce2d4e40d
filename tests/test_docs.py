# SPDX-License-Identifier: GPL-3.0-or-later
"""What the documents name is there: files, options, variables and modules; generated pages are current."""

from __future__ import annotations

import importlib.util
import re
from dataclasses import fields
from pathlib import Path

import pytest

from mgf_engine.config import Config

ROOT = Path(__file__).parents[1]
DOCUMENTS = [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").glob("*.md"))]
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
OTHERS = {"--command", "--python"}  # Blender's own
SOURCES = "\n".join(
    path.read_text(encoding="utf-8")
    for folder in ("mgf_engine", "mgf_blender", "benchmarks", "tools", "tests")
    for path in sorted((ROOT / folder).rglob("*.py"))
    if path != Path(__file__)
)


def options() -> set[str]:
    """Every flag that some command of ours takes."""
    named = {"--" + f.name.replace("_", "-") for f in fields(Config)}
    switches = {"--no-" + f.name.replace("_", "-") for f in fields(Config) if isinstance(f.default, bool)}
    return named | switches | set(re.findall(r'add_argument\(\s*"(--[a-z0-9-]+)"', SOURCES))


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda p: p.name)
def test_links_lead_to_files(document: Path) -> None:
    text = document.read_text(encoding="utf-8")
    links = [link for link in re.findall(r"\]\(([^)#\s]+)", text) if "://" not in link]
    assert [link for link in links if not (document.parent / link).exists()] == []


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda p: p.name)
def test_files_of_the_code_are_where_they_are_said_to_be(document: Path) -> None:
    named = re.findall(r"`([\w./-]+\.(?:py|c|h|cu|cuh))`", document.read_text(encoding="utf-8"))
    assert [name for name in named if not any((ROOT / room / name).exists() for room in ROOMS)] == []


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda p: p.name)
def test_options_exist(document: Path) -> None:
    named = set(re.findall(r"(?<![\w-])--[a-z][a-z0-9-]+", document.read_text(encoding="utf-8")))
    assert sorted(named - options() - OTHERS) == []


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda p: p.name)
def test_variables_and_modules_exist(document: Path) -> None:
    text = document.read_text(encoding="utf-8")
    assert [name for name in re.findall(r"MGF_[A-Z_]+", text) if name not in SOURCES] == []
    modules = re.findall(r"python -m (mgf_engine[\w.]*|benchmarks[\w.]*)", text)
    places = [ROOT / name.replace(".", "/") for name in modules]
    assert [str(place) for place in places if not (place.is_dir() or place.with_suffix(".py").exists())] == []


def test_the_command_line_page_is_current() -> None:
    spec = importlib.util.spec_from_file_location("write_cli_docs", ROOT / "tools" / "write_cli_docs.py")
    assert spec is not None and spec.loader is not None
    tool = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tool)
    assert tool.PAGE.read_text(encoding="utf-8") == tool.cli_page(), "run tools/write_cli_docs.py"
