# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel's options are the engine's options."""

from __future__ import annotations

import re
import subprocess

import pytest
from conftest import REPO

from mgf_blender.common import options


def test_committed_schema_is_the_engines():
    python = REPO / ".venv" / "bin" / "python"
    if not python.is_file():
        pytest.skip("the engine's environment (.venv) is not here; make test builds it")
    command = [str(python), "-m", "mgf_engine", "options", "--json"]
    engine = subprocess.run(command, capture_output=True, text=True, cwd=REPO, check=True).stdout
    committed = (REPO / "mgf_blender" / "options.json").read_text(encoding="utf-8")
    assert engine == committed, "run tools/build_extension.py --options to refresh mgf_blender/options.json"


def test_defaults_pass_the_preset_alone(addon):
    assert options.arguments(addon.options) == ["--set", "preset=standard"]


def test_preset_sets_what_it_governs_and_nothing_else(addon):
    addon.options.opacity_level = 0.4
    addon.options.preset = "draft"
    for name, value in options.PRESETS["draft"].items():
        assert getattr(addon.options, name) == value
    assert options.changed(addon.options) == {"opacity_level": 0.4}


def test_changes_become_arguments(addon):
    addon.options.resolution = 600
    addon.options.screening = False
    addon.options.device = "cpu"
    text = options.arguments(addon.options)
    for wanted in ("resolution=600", "screening=false", "device=cpu"):
        assert wanted in text
    iterations = options.default_of("iterations", "standard")
    assert f"iterations={iterations}" in options.arguments(addon.options, also=["iterations", "gone_option"])


def test_values_of_an_earlier_job_come_back(addon):
    options.set_values(addon.options, {"preset": "fine", "resolution": 900, "no_such": 1, "iterations": "many"})
    assert addon.options.preset == "fine" and addon.options.resolution == 900
    assert addon.options.iterations == options.default_of("iterations", "fine")
    texts = {"resolution": "320", "opacity_level": "0.25", "screening": "off", "device": "cpu", "iterations": "1.5"}
    options.set_values(addon.options, texts)
    assert addon.options.resolution == 320 and addon.options.opacity_level == 0.25
    assert addon.options.screening is False and addon.options.device == "cpu"
    options.set_values(addon.options, {"screening": "perhaps", "device": "abacus", "opacity_level": "nan"})
    assert addon.options.screening is False and addon.options.device == "cpu" and addon.options.opacity_level == 0.25
    assert addon.options.iterations == options.default_of("iterations", "fine")


def test_limits_hold(addon):
    addon.options.resolution = 1
    assert addon.options.resolution == options.OPTIONS["resolution"]["low"]


def test_tooltips_call_options_by_their_names_in_the_panel(addon):
    shown = addon.options.bl_rna.properties
    assert "Max Faces" in shown["face_error"].description and "max_faces" not in shown["face_error"].description
    preset = {item.identifier: item.description for item in shown["preset"].enum_items}
    assert "Max Photos 60" in preset["draft"] and "Passes 13" in preset["draft"]
    for prop in shown:
        words = set(re.findall(r"[a-z]+(?:_[a-z]+)+", prop.description))
        assert not words & set(options.OPTIONS), prop.identifier


def test_numbers_say_their_unit_in_the_panel(addon):
    shown = addon.options.bl_rna.properties
    assert shown["memory"].name == "Memory (GB)" and shown["memory"].precision == 1
    pixels = {name for name, option in options.OPTIONS.items() if option["unit"] == "px"}
    assert pixels >= {"resolution", "texture_size"} and all(shown[name].subtype == "PIXEL" for name in pixels)
