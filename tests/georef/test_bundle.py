# SPDX-License-Identifier: GPL-3.0-or-later
"""Control points straighten a model that bundle adjustment alone bent."""

import sys

import numpy as np
import pytest

from georef.strip import write_strip
from mgf_engine.config import make_config
from mgf_engine.errors import BadInput
from mgf_engine.georef import bundle
from mgf_engine.georef.adjust import fit_to_control
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
    adjust = fit_to_control if config.control_adjust else None
    scene = load_scene(folder, tmp_path / "scene", config, reporter, adjust=adjust)
    return scene, find_georeference(scene, config, pytest.fail)


def test_check_points_come_nearer(strip, tmp_path):
    """Check points are known to a centimetre in each direction themselves."""
    _, before = _survey(strip, tmp_path / "a", control_adjust="off")
    _, after = _survey(strip, tmp_path / "b")
    first, last = (np.sqrt((s.control.rms("check") ** 2).sum()) for s in (before, after))
    assert last < 0.03 and last < 0.85 * first


def test_the_model_stays_in_its_frame(strip, tmp_path):
    plain, _ = _survey(strip, tmp_path / "a", control_adjust="off")
    moved, _ = _survey(strip, tmp_path / "b")
    before, after = (
        np.array([s.to_normalised.invert(v.centre) for v in s.views]) for s in (plain, moved)
    )  # fmt: skip
    size = np.linalg.norm(np.ptp(before, axis=0))
    assert 1e-4 * size < np.linalg.norm(after - before, axis=1).max() < 0.02 * size


def test_without_pyceres_the_command_says_how_to_get_it(strip, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyceres", None)
    monkeypatch.setattr(bundle.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(BadInput, match=r"pip install 'mgf-engine\[survey\]'"):
        _survey(strip, tmp_path)
