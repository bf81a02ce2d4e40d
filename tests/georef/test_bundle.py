# SPDX-License-Identifier: GPL-3.0-or-later
"""Control points straighten a model that bundle adjustment alone bent."""

import sys

import numpy as np
import pytest

from georef.strip import ORIGIN, TARGETS, write_strip
from mgf_engine.errors import BadInput
from mgf_engine.georef import bundle
from mgf_engine.georef.adjust import fit_to_control
from mgf_engine.georef.find import find_georeference
from mgf_engine.georef.options import GeoreferenceOptions
from mgf_engine.messages import Reporter
from mgf_engine.options.config import make_config
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
    return scene, find_georeference(scene, config.algorithm(GeoreferenceOptions), pytest.fail)


def test_check_points_come_nearer(strip, tmp_path):
    """Check points are known to a centimetre in each direction themselves."""
    _, before = _survey(strip, tmp_path / "a", control_adjust="off")
    _, after = _survey(strip, tmp_path / "b")
    first, last = (np.sqrt((s.control.rms("check") ** 2).sum()) for s in (before, after))
    assert last < 0.03 and last < 0.85 * first


def test_check_points_are_where_they_truly_are_to_two_centimetres(strip, tmp_path):
    """In each direction, against the places without the noise of the file; every control point takes part."""
    _, fit = _survey(strip, tmp_path)
    rows = {row.point.name: row for row in fit.control.rows}
    off = np.array(
        [r.residual + np.array(r.point.position) - ORIGIN - TARGETS[n] for n, r in rows.items() if n[0] == "C"]
    )
    assert (np.sqrt((off**2).mean(0)) < 0.02).all()
    assert all(row.used for name, row in rows.items() if name[0] == "P")


def test_a_crash_is_one_sentence_and_no_end_of_the_job(strip, tmp_path, monkeypatch):
    monkeypatch.setattr(bundle, "COMMAND", (sys.executable, "-c", "import os; os.abort()"))
    folder, points, marks = strip
    config = make_config({"control": str(points), "marks": str(marks), "resolution": 800})
    reporter = Reporter()
    reporter.stage("scene")
    scene = load_scene(folder, tmp_path / "scene", config, reporter, adjust=fit_to_control)
    (text,) = [text for text in reporter.warnings if text.startswith("The bundle adjustment with control points")]
    assert "ended with code -6; the cameras stay as they are" in text
    assert find_georeference(scene, config.algorithm(GeoreferenceOptions), pytest.fail).georeference.method == "control"


def test_one_wrong_point_is_left_out_and_bends_nothing(strip, tmp_path):
    folder, points, marks = strip
    lines = points.read_text().splitlines()
    name, east, *rest = lines[2].split(",")
    lines[2] = ",".join([name, f"{float(east) + 1.0:.4f}", *rest])
    (tmp_path / "points.csv").write_text("\n".join(lines))
    _, fit = _survey((folder, tmp_path / "points.csv", marks), tmp_path)
    rows = {row.point.name: row for row in fit.control.rows}
    assert [n for n, r in rows.items() if n[0] == "P" and not r.used] == [name]
    assert rows[name].distance == pytest.approx(1.0, abs=0.1)
    assert np.sqrt((fit.control.rms("check") ** 2).sum()) < 0.06


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
    monkeypatch.setattr(bundle, "is_installed", lambda module: False)
    with pytest.raises(BadInput, match=r"pip install 'mgf-engine\[survey\]'"):
        _survey(strip, tmp_path)
