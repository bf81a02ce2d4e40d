# SPDX-License-Identifier: GPL-3.0-or-later
"""The list of options reads well: every option in its section, wrapped to the terminal, in the field's terms."""

from __future__ import annotations

import re
import subprocess
import sys

import pytest

from mgf_engine.cli.option_list import default_text, option_meaning, options_text
from mgf_engine.options.config import option_fields, options_schema
from mgf_engine.stages import SECTIONS

OPTIONS = options_schema()["options"]


def test_every_option_stands_in_its_section_with_its_default() -> None:
    sections = re.split(r"\n\n(\w+)\n", options_text(options_schema(), 100))
    lists = dict(zip(sections[1::2], sections[2::2], strict=True))
    assert list(lists) == list(SECTIONS)
    for entry in OPTIONS:
        line = f"  {entry['name']:<19} {default_text(entry['default'], entry['unit'])} "
        assert line in lists[entry["section"]], entry["name"]


@pytest.mark.parametrize("width", [20, 60, 100, 200])
def test_lines_fit_and_lose_no_word(width: int) -> None:
    text = options_text(options_schema(), width)
    assert max(map(len, text.splitlines())) <= max(width, 60)
    words = text.split()
    assert all(word in words for entry in OPTIONS for word in option_meaning(entry).split())


def test_defaults_are_written_as_people_write_them() -> None:
    values = [(True, ""), (False, ""), (0.008, ""), (60.0, "s"), (0, ""), (750, "px"), ("auto", ""), ("", "")]
    written = ["on", "off", "0.008", "60 s", "0", "750 px", "auto", "-"]
    assert [default_text(value, unit) for value, unit in values] == written


@pytest.mark.parametrize("entry", OPTIONS, ids=lambda entry: entry["name"])
def test_help_is_a_phrase_of_at_most_two_sentences(entry: dict[str, str]) -> None:
    text = entry["help"]
    assert text[0].isupper() or text.startswith("w_edge")
    assert not text.endswith(".") and len(re.findall(r"\. [A-Z]", text)) <= 1
    assert not re.match(r"(What|Which|Where|How|Whether)\b", text), "name the thing: 'Number of …', 'Folder of …'"
    assert len(text) <= 160


def test_options_that_name_files_say_so() -> None:
    paths = {f.name: f.metadata["path"] for f in option_fields() if f.metadata["path"]}
    assert paths == {"weights": "folder", "control": "file", "marks": "file", "scale_bars": "file"}


WITHOUT_EXTRAS = """
import sys
from mgf_engine.cli.doctor import EXTRAS

class NotInstalled:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in modules:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

modules = {module for _, packages in EXTRAS.values() for module in packages}
sys.meta_path.insert(0, NotInstalled())
from mgf_engine.cli.main import main
sys.exit(main(["options", "--algorithms"]))
"""


def test_options_of_algorithms_are_listed_without_the_extra_packages() -> None:
    """After 'pip install .', as the page on installing has it first; those of the solid need shapely."""
    run = subprocess.run([sys.executable, "-c", WITHOUT_EXTRAS], capture_output=True, text=True)
    assert (run.returncode, run.stderr) == (0, "") and "roof_seen" in run.stdout
