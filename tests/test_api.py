# SPDX-License-Identifier: GPL-3.0-or-later
"""The Python interface: its examples run, its names are stable, and importing it loads nothing heavy."""

from __future__ import annotations

import doctest
import inspect
import os
import shutil
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from typing import get_type_hints

import pytest

import mgf_engine as mgf
from benchmarks.synthetic.house import House, build_house
from mgf_engine.geometry.mesh_files import write_ply
from mgf_engine.model.masks import MaskSet
from mgf_engine.model.scene import Scene

STEPS = ("reconstruct", "read_scene", "make_masks", "train", "extract_mesh", "render", "evaluate")


@pytest.fixture(scope="module")
def house(tmp_path_factory: pytest.TempPathFactory) -> House:
    return build_house(tmp_path_factory.mktemp("house"), 8)


@pytest.fixture(scope="module")
def masks_made() -> dict[str, MaskSet]:
    """What ``make_masks`` has made of which arguments: four examples make the same masks of the same house."""
    return {}


@pytest.fixture
def masks_once(masks_made: dict[str, MaskSet], monkeypatch: pytest.MonkeyPatch) -> None:
    """The masks are made the first time that a process asks for them."""
    real = mgf.make_masks

    def make_masks(scene: Scene, prompts: str) -> MaskSet:
        sizes = [(view.name, view.width, view.height) for view in scene.views]
        given = f"{sizes} {Path(prompts).read_text()}"
        if given not in masks_made:
            masks_made[given] = real(scene, prompts)
        return masks_made[given]

    monkeypatch.setattr(mgf, "make_masks", make_masks)


@pytest.mark.parametrize("name", STEPS)
def test_the_example_of_each_function_runs(name: str, house: House, masks_once, tmp_path: Path, monkeypatch) -> None:
    shutil.copytree(house.folder, tmp_path / "house")
    write_ply(house.mesh, tmp_path / "truth.ply")
    monkeypatch.chdir(tmp_path)
    function = getattr(import_module("mgf_engine.api"), name)
    (example,) = doctest.DocTestFinder(recurse=False).find(function, name, globs={})
    assert len(example.examples) >= 2
    said: list[str] = []
    assert doctest.DocTestRunner(verbose=False).run(example, out=said.append).failed == 0, "".join(said)


@pytest.mark.parametrize("name", STEPS)
def test_every_function_is_typed_and_says_what_it_takes(name: str) -> None:
    function = getattr(mgf, name)
    parameters = inspect.signature(function).parameters
    assert set(get_type_hints(function, vars(sys.modules[function.__module__]) | {"Any": object})) == {
        *parameters,
        "return",
    }
    for parameter in parameters:
        assert f"\n        {parameter}: " in function.__doc__, parameter


def test_names_are_those_that_are_promised() -> None:
    assert {*STEPS, "Reconstruction", "BadInput", "Cancelled", "__version__"} == set(mgf.__all__) == set(dir(mgf))
    with pytest.raises(AttributeError, match="no attribute 'segment'"):
        mgf.segment  # noqa: B018


def test_importing_the_package_loads_neither_numpy_nor_torch() -> None:
    code = "import sys, mgf_engine; print(sorted({'numpy', 'torch', 'cv2', 'scipy'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env={**os.environ})
    assert done.stdout.strip() == "[]", done.stderr


def test_bad_input_is_one_sentence_and_leaves_nothing(tmp_path: Path) -> None:
    for call in (
        lambda: mgf.reconstruct(tmp_path / "nowhere", out=tmp_path / "job"),
        lambda: mgf.read_scene(tmp_path / "nowhere", tmp_path / "job"),
        lambda: mgf.read_scene(tmp_path, tmp_path / "job", color=3),
        lambda: mgf.evaluate(tmp_path / "a.ply", tmp_path / "b.ply"),
    ):
        with pytest.raises(mgf.BadInput) as error:
            call()
        assert str(error.value).endswith(".") and "\n" not in str(error.value)
    assert not list(tmp_path.iterdir())


def test_messages_reach_the_listener_and_warnings_come_with_them(house: House, tmp_path: Path) -> None:
    kinds: list[str] = []
    mgf.read_scene(house.folder, tmp_path, on_message=lambda message: kinds.append(message["type"]), resolution=100)
    assert {"device", "stage", "progress"} <= set(kinds)
