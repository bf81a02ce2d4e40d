# SPDX-License-Identifier: GPL-3.0-or-later
"""Control points straighten a model that bundle adjustment alone bent."""

import builtins

import numpy as np
import pytest

from georef.strip import ORIGIN, write_strip
from mgf_engine.config import make_config
from mgf_engine.errors import BadInput
from mgf_engine.georef.find import find_georeference
from mgf_engine.messages import Reporter
from mgf_engine.scene.load import load_scene


@pytest.fixture(scope="module")
def strip(tmp_path_factory):
    folder = tmp_path_factory.mktemp("strip")
    return folder, *write_strip(folder)


def _survey(strip, tmp_path, **options):
    folder, points, marks = strip
    config = make_config({"control": str(points), "marks": str(marks), "resolution": 800, **options})
    reporter = Reporter()
    reporter.stage("scene")
    scene = load_scene(folder, tmp_path / "scene", config, reporter)
    return scene, find_georeference(scene, config, pytest.fail)


def test_check_points_come_below_two_centimetres(strip, tmp_path):
    _, before = _survey(strip, tmp_path / "a", control_adjust="off")
    scene, after = _survey(strip, tmp_path / "b")
    first, last = (np.sqrt((s.control.rms("check") ** 2).sum()) for s in (before, after))
    print(first, last, before.control.rms("control"), after.control.rms("control"))
    assert first > 0.04  # the bent front
    assert last < 0.02 and last < 0.4 * first
    front = after.georeference.world(scene.to_normalised.invert(scene.points)) - ORIGIN
    wall = front[np.abs(front[:, 1]) < 0.15]
    assert len(wall) > 100 and np.sqrt((wall[:, 1] ** 2).mean()) < 0.03


def test_the_model_stays_in_its_frame(strip, tmp_path):
    plain, _ = _survey(strip, tmp_path / "a", control_adjust="off")
    moved, _ = _survey(strip, tmp_path / "b")
    before, after = (
        np.array([s.to_normalised.invert(v.centre) for v in s.views]) for s in (plain, moved)
    )  # fmt: skip
    size = np.linalg.norm(np.ptp(before, axis=0))
    assert 1e-4 * size < np.linalg.norm(after - before, axis=1).max() < 0.02 * size


def test_without_pyceres_the_command_says_how_to_get_it(strip, tmp_path, monkeypatch):
    real = builtins.__import__

    def refuse(name, *args, **kwargs):
        if name == "pyceres":
            raise ImportError(name)
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", refuse)
    with pytest.raises(BadInput, match=r"pip install 'mgf-engine\[survey\]'"):
        _survey(strip, tmp_path)
