# SPDX-License-Identifier: GPL-3.0-or-later
"""Where points should appear in photos, against a site whose truth is known."""

from __future__ import annotations

import argparse
import json

import numpy as np
import pytest
from support.survey_site import CRS, ORIGIN, TARGETS, make_site, write_gps

from mgf_engine.errors import BadInput
from mgf_engine.georef.command import add_arguments, read_options
from mgf_engine.georef.control_points import read_marks
from mgf_engine.georef.find import find_georeference
from mgf_engine.georef.model import write_georeference
from mgf_engine.georef.options import GeoreferenceOptions, MarkOptions
from mgf_engine.georef.predict import write_places
from mgf_engine.georef.triangulate import place_points
from mgf_engine.messages import Reporter
from mgf_engine.options.config import make_config
from mgf_engine.scene.cameras import to_original
from mgf_engine.scene.store import save_scene


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """A job folder with nothing but its scene."""
    made = make_site(tmp_path_factory.mktemp("job") / "scene")
    write_gps(made)
    save_scene(made.scene)
    return made


def predict(site, **given):
    out = site.folder.parent / "places.json"
    write_places(site.folder.parent, {k: str(v) for k, v in given.items()}, out, Reporter())
    points = json.loads(out.read_text(encoding="utf-8"))["points"]
    return {p["name"]: p for p in points}


def errors(site, point) -> np.ndarray:
    """Pixels from each predicted place to the true one."""
    at, views = site.normalised(ORIGIN + TARGETS[point["name"]]), {v.name: v for v in site.scene.views}
    true = {name: to_original(views[name], views[name].project(at[None])[0])[0] for name in point["photos"]}
    return np.array([np.hypot(*(np.array(point["photos"][name][:2]) - true[name])) for name in true])


def test_points_alone_have_names_and_roles_and_no_place(site):
    (site.folder.parent / "georef.json").unlink(missing_ok=True)
    found = predict(site, control=site.write_control())
    assert {n: p["role"] for n, p in found.items()} == {n: "check" if n[0] == "C" else "control" for n in TARGETS}
    assert all(p["photos"] == {} and p["by"] == "" for p in found.values())


def test_two_marks_tell_where_the_point_is_in_the_other_photos(site):
    marks = [m for m in site.marks() if m[0] == "P1"][:2]
    found = predict(site, control=site.write_control(), marks=site.write_marks(marks, "two.csv"))
    assert found["P1"]["by"] == "marks" and found["P2"]["photos"] == {}
    assert len(found["P1"]["photos"]) > 8 and errors(site, found["P1"]).max() < 0.1


def test_three_marked_points_tell_where_the_others_are(site):
    marks = [m for name in ("P1", "P2", "P4") for m in [m for m in site.marks(0.5) if m[0] == name][:3]]
    found = predict(site, control=site.write_control(), marks=site.write_marks(marks, "three.csv"))
    for name in ("P3", "P5", "C1", "C2", "C3"):
        assert found[name]["by"] == "other points"
        radius = max(r for *_, r in found[name]["photos"].values())
        assert errors(site, found[name]).max() < 25 and 4 <= radius < 60


@pytest.mark.parametrize("crs", [CRS, ""])
def test_gps_tells_roughly_where_all_of_them_are(site, crs):
    options = make_config({"crs": crs}).algorithm(GeoreferenceOptions)
    georeference = find_georeference(site.scene, options, pytest.fail).georeference
    write_georeference(georeference, site.folder.parent)
    found = predict(site, control=site.write_control(), crs=CRS)
    assert all(p["by"] == "georeference" and errors(site, p).max() < 25 for p in found.values())
    (site.folder.parent / "georef.json").unlink()


def test_a_wrong_mark_is_named(site):
    marks = site.marks()
    k = next(k for k, m in enumerate(marks) if m[0] == "P1")
    marks[k] = (*marks[k][:2], marks[k][2] + 200, marks[k][3])
    found = predict(site, control=site.write_control(), marks=site.write_marks(marks, "wrong.csv"))
    assert found["P1"]["wrong"] == [marks[k][1]] and found["P1"]["pixels"] < 0.1 and found["P2"]["wrong"] == []


def test_without_points_or_scene_it_is_refused(site, tmp_path):
    with pytest.raises(BadInput, match="--predict needs control points"):
        predict(site)
    with pytest.raises(BadInput):
        write_places(tmp_path, {"control": str(site.write_control())}, tmp_path / "out.json", Reporter())


def test_options_of_the_command_reach_the_algorithms(site, tmp_path):
    """``--set`` and ``--config`` as in other commands; flags win, and options of other stages are refused."""
    (tmp_path / "options.json").write_text('{"gps_fit.outlier": 6, "crs": "EPSG:1"}')
    parser = argparse.ArgumentParser(argument_default=argparse.SUPPRESS)
    add_arguments(parser)
    parser.add_argument("--crs")
    given = ["job", "--config", str(tmp_path / "options.json"), "--set", "control_points.accuracy=0.02", "--crs", CRS]
    given += ["--set", "gravity.tag_sd=2"]
    options = make_config(read_options(parser.parse_args(given))).algorithm(GeoreferenceOptions)
    assert (options.crs, options.point.accuracy, options.position.outlier) == (CRS, 0.02, 6.0)
    assert options.gravity.tag_sd == 2.0
    for wrong in ("tsdf.band=3", "passes=3"):
        with pytest.raises(BadInput, match=f"does not use the option .{wrong[:-2]}."):
            read_options(parser.parse_args(["job", "--set", wrong]))


def test_a_mark_is_an_outlier_beyond_the_option(site):
    """One of P1's marks is 30 px off in photos of about 1000 px: wrong by default, right at 40 px per 1000."""
    marks = [m for m in site.marks() if m[0] == "P1"]
    name, photo, x, y = marks[0]
    path = site.write_marks([(name, photo, x + 30, y), *marks[1:]], "off.csv")
    found, _ = read_marks(path, [v.name for v in site.scene.views])
    for options, wrong in ((MarkOptions(), 1), (MarkOptions(outlier=60), 0)):
        placed, _ = place_points(site.scene, found, options)
        assert np.count_nonzero(~placed["P1"].good) == wrong
