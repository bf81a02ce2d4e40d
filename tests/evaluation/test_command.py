# SPDX-License-Identifier: GPL-3.0-or-later
"""``mgf evaluate``: scores against a true mesh, evenness, and refusals in one sentence."""

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from benchmarks.synthetic.colmap_scene import reconstruction, write_model
from mgf_engine.cli.main import main


@pytest.fixture
def triangle(tmp_path: Path) -> str:
    path = tmp_path / "triangle.ply"
    trimesh.Trimesh(np.eye(3), [[0, 1, 2]]).export(path)
    return str(path)


@pytest.mark.parametrize(
    ("args", "part"),
    [
        (["--thresholds", "nan"], "A threshold must be a finite distance above 0, not nan."),
        (["--thresholds", "0.1", "inf"], "A threshold must be a finite distance above 0, not inf."),
        (["--thresholds", "0.1", "-5", "1"], "A threshold must be a finite distance above 0, not -5."),
        (["--samples", "0"], "The number of samples must be 1 to 100000000, not 0."),
        (["--samples", "10000000000000"], "The number of samples must be 1 to 100000000, not 10000000000000."),
        (["--json", "{}"], "Cannot write the figures"),
        (["--json", __file__ + "/figures.json"], "Cannot write the figures"),
        (["--picture", "{}"], "Cannot write the picture"),
        (["--leave-out", "{}/triangle.ply"], "to be scored"),
        (["--leave-out", "{}/nothing.ply"], "There is no mesh"),
        (["--scene", "{}"], "There is no COLMAP model"),
        (["--photo-size", "0"], "--photo-size must be"),
    ],
)
def test_evaluate_refuses_in_one_sentence(tmp_path: Path, triangle: str, capsys, args, part) -> None:
    filled = [a.format(tmp_path) for a in args]
    assert main(["evaluate", triangle, "--truth", triangle, "--samples", "100", *filled]) == 2
    said = capsys.readouterr().err
    assert part in said and said.count("\n") == 1
    assert [p.name for p in tmp_path.iterdir()] == ["triangle.ply"]


def test_evaluate_leaves_a_part_of_the_truth_out(tmp_path: Path, triangle: str, capsys) -> None:
    far = np.eye(3) + 5
    trimesh.Trimesh(far, [[0, 1, 2]]).export(tmp_path / "far.ply")
    trimesh.Trimesh(np.r_[np.eye(3), far], [[0, 1, 2], [3, 4, 5]]).export(tmp_path / "both.ply")
    command = ["evaluate", triangle, "--truth", str(tmp_path / "both.ply"), "--samples", "1000"]
    assert main(command) == 0 and " 50.00%" in capsys.readouterr().out
    assert main([*command, "--leave-out", str(tmp_path / "far.ply")]) == 0
    assert " 50.00%" not in (said := capsys.readouterr().out) and said.count("100.00%") == 3


def test_evaluate_says_what_it_needs(triangle: str, capsys) -> None:
    for given, part in (
        ([], "Nothing to compare"),
        (["--scene", "x", "--picture", "a.png"], "compare with a true mesh"),
    ):
        assert main(["evaluate", triangle, *given]) == 2
        said = capsys.readouterr().err
        assert part in said and said.count("\n") == 1


def test_evaluate_gives_materials_and_evenness(tmp_path: Path, triangle: str, capsys) -> None:
    (tmp_path / "triangle_materials.json").write_text('["brick", "glass"]', encoding="utf-8")
    np.save(tmp_path / "triangle_materials.npy", np.array([1], np.int32))
    scene, figures = tmp_path / "scene", tmp_path / "figures.json"
    write_model(reconstruction(), scene / "sparse" / "0")
    assert main(["evaluate", triangle, "--truth", triangle, "--samples", "100", "--json", str(figures)]) == 0
    said = capsys.readouterr().out
    assert "glass" in said and "brick" not in said and "normals: median 0.0" in said and "plane" not in said
    assert json.loads(figures.read_text())["materials"]["glass"]["f1"] == [100.0]
    assert main(["evaluate", triangle, "--scene", str(scene), "--json", str(figures)]) == 0
    said = capsys.readouterr().out
    assert "  all 100.0%         0.000            0.0   0.0" in said and "accuracy" not in said
    (plane,) = json.loads(figures.read_text())["evenness"]["planes"]
    assert plane["share"] == 1.0 and plane["rms"] < 1e-6


def test_evaluate_measures_a_job_in_the_coordinates_of_its_photos(tmp_path: Path) -> None:
    """Its georeferenced mesh, a thousand times as large, is not in the units of the COLMAP model."""
    scene, job, figures = tmp_path / "scene", tmp_path / "job", tmp_path / "figures.json"
    write_model(reconstruction(), scene / "sparse" / "0")
    (job / "georeferenced").mkdir(parents=True)
    mesh = trimesh.creation.icosphere(subdivisions=2)
    mesh.export(job / "mesh.ply")
    mesh.apply_scale(1000).export(job / "georeferenced" / "mesh.ply")
    (job / "georeferenced" / "georef.json").write_text('{"offset": [0, 0, 0]}', encoding="utf-8")
    found = []
    for mesh_or_job in (job / "mesh.ply", job):
        assert main(["evaluate", str(mesh_or_job), "--scene", str(scene), "--json", str(figures)]) == 0
        found.append(json.loads(figures.read_text())["evenness"]["planes"])
    assert found[0] and found[0] == found[1]


def test_evaluate_refuses_a_folder_for_its_figures_before_it_measures(tmp_path: Path, triangle: str, capsys) -> None:
    assert main(["evaluate", triangle, "--truth", triangle, "--samples", "100", "--json", str(tmp_path)]) == 2
    said = capsys.readouterr()
    assert "Cannot write the figures" in said.err and said.out == ""


def test_evaluate_writes_its_figures_where_no_folder_is_yet(tmp_path: Path, triangle: str) -> None:
    figures = tmp_path / "new" / "figures.json"
    assert main(["evaluate", triangle, "--truth", triangle, "--samples", "100", "--json", str(figures)]) == 0
    assert json.loads(figures.read_text())["f1"] == [100.0]
