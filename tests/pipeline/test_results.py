# SPDX-License-Identifier: GPL-3.0-or-later
"""A whole job finds the house and only the house, and its folder holds all results."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import igl
import numpy as np
import pytest
import trimesh
from support.house_jobs import OPTIONS, copy_until, f1
from support.jobs import run_here
from support.survey import write_survey

from benchmarks.synthetic.house import House
from mgf_engine.cli.main import main
from mgf_engine.stages import STAGE_NAMES


def test_the_mesh_is_the_house(house: House, finished) -> None:
    job, _ = finished
    assert f1(job / "mesh.ply", house, 0.1) > 0.9


@pytest.mark.parametrize("stage", [name for name in STAGE_NAMES if name != "deliver"])
def test_each_stage_ends_with_a_line_to_read(stage: str, finished, capsys) -> None:
    code = main([stage, "--out", str(finished[0]), "--progress", "plain"])
    said = capsys.readouterr().err
    assert code == 0 and "\nDone. " in said, said


def test_georef_gives_a_finished_job_true_coordinates(house: House, finished, tmp_path: Path, capsys) -> None:
    job, true = Path(shutil.copytree(finished[0], tmp_path / "job")), write_survey(tmp_path, house)
    before = (job / "mesh.ply").read_bytes()
    given = ("--crs", "EPSG:25832", "--control", tmp_path / "points.csv", "--marks", tmp_path / "marks.csv")
    code, messages = run_here(capsys, "georef", job, *given)
    assert code == 0 and messages[-1]["type"] == "result"
    assert messages[-1]["figures"]["RMSE of check points"] in {f"{k / 10:.1f} mm" for k in range(6)}
    found = json.loads((job / "georef.json").read_text())
    assert found["crs"] == "EPSG:25832" and found["method"] == "control"
    local = trimesh.load(job / "georeferenced" / "mesh.ply", process=False).vertices
    world = trimesh.load(job / "mesh.ply", process=False).vertices @ true[:3, :3].T + true[:3, 3]
    assert np.abs(local + found["offset"] - world).max() < 2e-3
    assert (job / "mesh.ply").read_bytes() == before and "EPSG:25832" in (job / "report.html").read_text()
    rows = json.loads((job / "report.json").read_text())["georeference"]["points"]
    assert len(rows) == 7 and all(np.abs(row["residual"]).max() < 1e-3 for row in rows)
    text = (tmp_path / "points.csv").read_text().splitlines()
    swapped = [",".join([name, north, east, *rest]) for name, east, north, *rest in (row.split(",") for row in text)]
    swapped[0] = text[0]
    (tmp_path / "points.csv").write_text("\n".join(swapped))
    kept = {p: p.read_bytes() for p in (job / "georef.json", job / "job.json", job / "report.json")}
    code, messages = run_here(capsys, "georef", job, *given)
    assert code == 2 and messages[-1]["type"] == "failed" and "seem swapped" in messages[-1]["text"]
    assert {p: p.read_bytes() for p in kept} == kept
    (tmp_path / "points.csv").write_text("\n".join(text))
    record = json.loads((job / "job.json").read_text())
    record["stages"]["scene"]["key"] = "that of a scene whose cameras other points moved"
    (job / "job.json").write_text(json.dumps(record))
    code, messages = run_here(capsys, "georef", job, *given)
    assert code == 0 and messages[-1]["type"] == "result"
    kept = json.loads((job / "job.json").read_text())["stages"]["deliver"]["key"]
    assert kept == record["stages"]["deliver"]["key"]  # the next run makes all of it anew


def _write_masks(folder: Path, house: House) -> Path:
    """The true masks, as a user draws them."""
    folder.mkdir()
    for name, mask in house.masks.items():
        cv2.imwrite(str(folder / name), (mask * 255).astype(np.uint8))
    return folder


def test_quick_gives_the_mesh_without_training(house: House, tmp_path: Path, capsys) -> None:
    masks = _write_masks(tmp_path / "masks", house)
    given = (house.folder, "--masks", masks, "--out", tmp_path / "job", "--preset", "quick")
    code, messages = run_here(capsys, "reconstruct", *given)
    assert code == 0, messages[-1]
    assert f1(tmp_path / "job" / "mesh.ply", house, 0.1) > 0.85
    made = json.loads((tmp_path / "job" / "deliver.json").read_text())
    assert not any(view["render"] for view in made["views"])
    assert (tmp_path / "job" / "texture.jpg").exists()


def test_the_paper_s_method_gives_a_mesh_and_a_report(house: House, tmp_path: Path, capsys) -> None:
    """All of section 3 in one run, only shorter: both losses, second-level masks, opacity, eight bisections."""
    job = tmp_path / "job"
    small = ["--preset", "paper", "--iterations", "150", "--max-gaussians", "5000"]
    given = (house.folder, "--prompts", house.prompts, "--out", job, *small)
    code, messages = run_here(capsys, "reconstruct", *given)
    assert code == 0, messages[-1]
    assert f1(job / "mesh.ply", house, 0.25) > 0.5  # sparse points and 150 iterations go no further
    config = json.loads((job / "report.json").read_text())["config"]
    assert (config["preset"], config["surface"], config["multilevel_loss"]) == ("paper", "opacity", True)
    labels = cv2.imread(str(next((job / "masks" / "labels").glob("*.png"))), cv2.IMREAD_UNCHANGED)
    assert ((labels > 1) & (labels < 255)).any()


def test_the_masks_are_the_house(house: House, finished) -> None:
    job, _ = finished
    for file in sorted((job / "masks" / "labels").glob("*.png")):
        labels = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
        true = next(m for name, m in house.masks.items() if Path(name).stem in file.stem)
        found = (labels > 0) & (labels < 255)
        assert (found & true).sum() / (found | true).sum() > 0.85, file.name


def test_everything_promised_is_in_the_job_folder(finished) -> None:
    job, messages = finished
    results = ("mesh.ply", "field.ply", "report.html", "report.json", "deliver.json", "masks/contact_sheet.jpg")
    for name in (*results, "texture.jpg", "mesh_texture.npz"):
        assert (job / name).stat().st_size > 0, name
    report = json.loads((job / "report.json").read_text())
    assert report["held_out"]["psnr"] > 17
    assert [s["name"] for s in report["stages"]] == ["scene", "masks", "field", "mesh"]
    assert sum(report["confidence"].values()) == pytest.approx(1) and report["confidence"]["agreed"] > 0.2
    manifest = json.loads((job / "deliver.json").read_text())
    held_out = [v for v in manifest["views"] if v["held_out"]]
    assert held_out
    for view in held_out:
        render = cv2.imread(str(job / view["render"]), cv2.IMREAD_UNCHANGED)
        assert render.shape == (view["height"], view["width"], 4)
    assert (manifest["texture"], manifest["texture_uv"]) == ("runs/1/texture.jpg", "runs/1/mesh_texture.npz")
    for name in ("mesh.ply", "field.ply", "report.html", "texture.jpg"):
        assert (job / "runs/1" / name).read_bytes() == (job / name).read_bytes()
    assert report["counts"]["PSNR of the textured mesh, held-out photos (dB)"] > 15
    assert report["machine"]["segmenter of the masks"].startswith("random walker")
    assert messages[0]["type"] == "started"
    (said,) = (m["text"] for m in messages if m["type"] == "segmenter")
    assert "random walker" in said and "mgf weights" in said and "\n" not in said
    assert messages[-1]["type"] == "result"
    assert not list(job.rglob(".part-*"))


def test_other_formats_hold_the_same_mesh(finished, tmp_path: Path, capsys) -> None:
    job = tmp_path / "job"
    shutil.copytree(finished[0], job)
    code, messages = run_here(capsys, "reconstruct", "--out", job, "--resume", "--export-obj", "--export-glb")
    assert code == 0 and messages[-1]["type"] == "result"
    mesh = trimesh.load(job / "mesh.ply")
    for name in ("mesh.obj", "mesh.glb"):
        other = trimesh.load(job / name, force="mesh")
        assert len(other.faces) == len(mesh.faces), name
        np.testing.assert_allclose(other.bounds, mesh.bounds, atol=1e-3, err_msg=name)


def test_masks_of_the_user_are_taken_as_they_are(house: House, tmp_path: Path, capsys) -> None:
    masks = _write_masks(tmp_path / "masks", house)
    code, messages = run_here(capsys, "masks", house.folder, "--masks", masks, "--out", tmp_path / "job")
    assert code == 0 and messages[-1]["type"] == "result"
    labels = cv2.imread(str(next((tmp_path / "job/masks/labels").glob("*photo_03*"))), cv2.IMREAD_UNCHANGED)
    assert ((labels > 0) == house.masks["photo_03.png"]).mean() > 0.995


def test_a_crop_box_limits_the_mesh_and_keeps_the_field(house: House, finished, tmp_path: Path, capsys) -> None:
    job = tmp_path / "job"
    copy_until(finished[0], job, "deliver")
    low, high = house.mesh.vertices.min(0) - 0.2, house.mesh.vertices.max(0) + 0.2
    high[0] = house.mesh.vertices[:, 0].mean()  # half the house
    (tmp_path / "box.txt").write_text(" ".join(map(str, [*low, *high])))
    given = (house.folder, "--prompts", house.prompts, "--out", job, *OPTIONS)
    code, messages = run_here(capsys, "reconstruct", *given, "--resume", "--crop-box", tmp_path / "box.txt")
    assert code == 0, messages[-1]
    cached = {m["stage"]: m["cached"] for m in messages if m["type"] == "stage"}
    assert cached == {"scene": True, "masks": True, "field": True, "mesh": False, "deliver": False}
    mesh = trimesh.load(job / "mesh.ply")
    assert high[0] - 0.05 < mesh.vertices[:, 0].max() < high[0] + 1e-4
    assert (mesh.vertices > low - 1e-4).all()
    points = trimesh.sample.sample_surface(mesh, 2000, seed=1)[0]
    apart = np.sqrt(igl.point_mesh_squared_distance(points, house.mesh.vertices, house.mesh.faces.astype(np.int64))[0])
    assert (apart < 0.1).mean() > 0.9  # no lid on the cut, nothing of the other half
