# SPDX-License-Identifier: GPL-3.0-or-later
"""A painted house, loaded as a scene, shared by the tests of the masks."""

from pathlib import Path

import pytest

from benchmarks.synthetic.house import House, build_house
from mgf_engine.messages import Reporter
from mgf_engine.model.scene import Scene
from mgf_engine.options.config import make_config
from mgf_engine.scene.load import load_scene


def quiet() -> Reporter:
    reporter = Reporter()
    reporter.stage("masks")
    return reporter


@pytest.fixture(scope="session")
def house(tmp_path_factory: pytest.TempPathFactory) -> House:
    return build_house(tmp_path_factory.mktemp("house"))


@pytest.fixture(scope="session")
def scene(house: House, tmp_path_factory: pytest.TempPathFactory) -> Scene:
    folder: Path = tmp_path_factory.mktemp("job") / "scene"
    return load_scene(house.folder, folder, make_config(), quiet())
