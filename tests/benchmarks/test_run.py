# SPDX-License-Identifier: GPL-3.0-or-later
"""Suites, measured runs and the page, on a scene made by hand (no Blender) with a stand-in for the tool."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest
import trimesh

from benchmarks.buildings import BUILDINGS
from benchmarks.camera_path import Ring, plan
from benchmarks.charts import summary_tables, write_page
from benchmarks.job_scores import held_out_scores, mean_mask_iou
from benchmarks.measure import _source, prepare_scene
from benchmarks.run import bench_main
from benchmarks.shapes import true_mesh
from benchmarks.suites import (
    ABLATION,
    MASK_PARTS,
    OURS,
    PARTS_OF_OURS,
    SCHEDULES,
    SUITES,
    SWITCHES,
    SuiteSettings,
    paper_setting,
    peers,
    suite_runs,
)
from mgf_engine.errors import BadInput
from mgf_engine.options.config import as_dict, make_config
from mgf_engine.scene.colmap import find_model


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A 10 x 6 x 8 m box seen by six cameras: what the generator leaves behind, without photos."""
    folder = tmp_path / "box scene"
    (folder / "masks").mkdir(parents=True)
    (folder / "sparse_truth").mkdir()
    box = trimesh.creation.box((10.0, 6.0, 8.0))
    box.apply_translation([0, 0, 4])
    box.export(folder / "truth.ply")
    model = pycolmap.Reconstruction()
    camera = pycolmap.Camera(model="PINHOLE", width=96, height=64, params=[80, 80, 48, 32], camera_id=1)
    model.add_camera_with_trivial_rig(camera)
    shots = plan(6, np.array([[-5.0, -3], [5, 3]]), (Ring(1.0, 10.0, 14.0, 4.0),), None, 0, 0, np.random.default_rng(0))
    for i, shot in enumerate(shots, 1):
        image = pycolmap.Image(name=shot.name, camera_id=1, image_id=i)
        model.add_image_with_trivial_frame(
            image, pycolmap.Rigid3d(pycolmap.Rotation3d(shot.rotation), shot.translation)
        )
        cv2.imwrite(str(folder / "masks" / (Path(shot.name).stem + ".png")), np.ones((64, 96), np.uint8))
    model.write(folder / "sparse_truth")
    (folder / "scene.json").write_text(json.dumps({"ground_pixel": 0.2}))
    (folder / "prompts.json").write_text("{}")
    return folder


COPY = f"{sys.executable} -c 'import shutil,sys; shutil.copy(sys.argv[1], sys.argv[2])' {{scene}}/truth.ply {{mesh}}"


def test_every_option_of_every_suite_exists() -> None:
    for suite in SUITES:
        for run in suite_runs(suite):
            make_config(run.options)
    for suite, start in {"ablation": paper_setting(), "ablation-ours": OURS}.items():
        changed = {run.variant.partition(": ")[2]: run for run in suite_runs(suite)}
        further = PARTS_OF_OURS | SCHEDULES if suite == "ablation" else MASK_PARTS
        parts = ABLATION | further | {"no second level": MASK_PARTS["no second level"]}
        assert set(parts) <= set(changed)
        for what, options in parts.items():  # one thing at a time, from the setting's own values
            full, one = (as_dict(make_config(o)) for o in (start, changed[what].options))
            assert {k for k in full if full[k] != one[k]} == set(options)
            assert one["use_masks"]  # without any masks (b), (c) and (d) are gone as well
    for options in PARTS_OF_OURS.values():  # each as it is by default
        assert all(getattr(make_config(), name) == value for name, value in options.items())
    assert set(SWITCHES) <= {run.variant for run in suite_runs("switches")}
    assert set(peers()) == {run.variant for run in suite_runs("peers")}


def test_shorter_runs_of_the_paper_keep_its_ratio_and_leave_ours_alone() -> None:
    short = SuiteSettings(["a"], paper_iterations=1400)
    runs = [run for suite in ("ablation", "ablation-ours") for run in suite_runs(suite, short)]
    by_name = {run.variant: run.options for run in runs}
    lengths = {name: make_config(options).iterations for name, options in by_name.items()}
    assert lengths["paper: (e) full"] == 1400 and lengths["paper: (f) 30/7 of the iterations"] == 6000
    assert lengths["ours: (e) full"] == make_config().iterations
    names = {run.variant for run in suite_runs("peers", short)}
    assert {f"GOF-like, {n} iterations, sparse start" for n in (1400, 6000)} | {"ours, paper"} <= names
    same = [suite_runs("ablation", SuiteSettings(["a"], paper_iterations=n))[0].key() for n in (7000, 1400)]
    assert same[0] == suite_runs("ablation", SuiteSettings(["a"]))[0].key() != same[1]
    shared = [run.key() for run in suite_runs("pareto", short) if "(a)" in run.variant]
    assert shared == [run.key() for run in suite_runs("ablation", replace(short, only=["paper: (a)"]))]


def test_runs_are_scenes_times_variants_times_seeds_with_distinct_keys() -> None:
    runs = suite_runs("resolution", SuiteSettings(["a", "b"], seeds=3, base={"iterations": 10}))
    assert len(runs) == 2 * 6 * 3
    assert len({run.key() for run in runs}) == len(runs)
    assert all(run.options["iterations"] == 10 for run in runs)
    assert runs[0].key() == suite_runs("resolution", SuiteSettings(["a"], base={"iterations": 10}))[0].key()
    assert runs[0].key() != runs[0].key("again")
    with pytest.raises(BadInput, match="No variant"):
        suite_runs("resolution", SuiteSettings(only=["9000"]))


def test_a_setting_at_its_own_resolution_is_the_run_of_the_other_suites() -> None:
    known = {run.variant: run.key() for run in suite_runs("pareto", SuiteSettings(["a"]))}
    found = {run.variant: run for run in suite_runs("resolution", SuiteSettings(["a"], base={"resolution": 100}))}
    assert found["paper's setting, 750 px"].key() == known["preset paper"]
    assert found["standard, 750 px"].key() == known["preset standard"]
    assert found["standard, 375 px"].options["resolution"] == 375


@pytest.mark.parametrize(("poses", "photos"), [("sfm", 4), ("true", 6)])
def test_runs_see_the_wanted_cameras_alone(scene: Path, tmp_path: Path, poses: str, photos: int) -> None:
    found = pycolmap.Reconstruction(scene / "sparse_truth")
    for number in (1, 2):  # structure from motion does not place every photo
        found.deregister_frame(found.images[number].frame_id)
    (scene / "sparse" / "0").mkdir(parents=True)
    found.write(scene / "sparse" / "0")
    model = find_model(_source(scene, poses, tmp_path / "job"))
    assert model is not None and pycolmap.Reconstruction(model).num_reg_images() == photos


def test_an_external_tool_is_run_scored_and_not_repeated(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    command = ["peers", "--scenes", str(scene), "--external", f"copy={COPY}", "--only", "copy", "--samples", "5000"]
    assert bench_main([*command, "--out", str(out)]) == 0
    (result,) = (out / "results").glob("*.json")
    row = json.loads(result.read_text())
    assert row["geometry"]["f1"] == [100.0] * len(row["geometry"]["f1"])
    # The cameras at 10 m see the walls and the roof; the floor they cannot see is outside the crop.
    assert row["geometry"]["truth_seen"] == pytest.approx(100.0)
    assert row["geometry"]["outside_crop"] > 10
    assert {0.05, 0.1, 0.2, 0.4} == set(row["geometry"]["thresholds"])
    assert row["seconds"] > 0 and row["cpu_seconds"] > 0 and row["peak_memory"] > 1e6
    stamp = result.stat().st_mtime_ns
    assert bench_main([*command, "--out", str(out)]) == 0
    assert result.stat().st_mtime_ns == stamp
    page = (out / "peers.html").read_text(encoding="utf-8")
    assert "copy" in page and "charts/peers-box scene-f1-time.svg" in page
    assert (out / "charts/peers-box scene-f1-time.png").stat().st_size > 1000


def test_a_tool_that_fails_is_reported_and_tried_again_next_time(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    broken = f"broken={sys.executable} -c 'import sys; sys.exit(\"no luck today\")'"
    code = bench_main(["peers", "--scenes", str(scene), "--external", broken, "--only", "broken", "--out", str(out)])
    assert code == 1
    assert not list((out / "results").glob("*.json"))
    assert "no luck today" in capsys.readouterr().out
    assert "no luck today" in (out / "peers.html").read_text(encoding="utf-8")


def test_photos_are_not_measured_at_more_pixels_than_they_have(scene: Path, tmp_path: Path, capsys) -> None:
    assert bench_main(["resolution", "--scenes", str(scene), "--out", str(tmp_path / "out")]) == 0
    assert capsys.readouterr().out.count("left out: its photos have 96 pixels") == 6
    assert not list((tmp_path / "out").glob("jobs/*"))


def test_unknown_names_are_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert bench_main(["resolution", "--scenes", "nowhere", "--out", str(tmp_path)]) == 2
    assert "There is no scene 'nowhere'" in capsys.readouterr().err
    assert bench_main(["peers", "--external", "oops", "--out", str(tmp_path)]) == 2


@pytest.mark.parametrize(
    ("args", "part"),
    [
        (["smoke", "--set", "iterations=many"], "a whole number"),
        (["ablation", "--set", "iterations=many"], "a whole number"),
        (["smoke", "--set", "iterationz=3"], "Unknown option"),
        (["smoke", "--out", __file__], "Cannot write"),
        (["masks", "--out", __file__], "Cannot write"),
        (["stability", "--out", __file__], "Cannot write"),
        (["smoke", "--photos", "2"], "at least 3 photos"),
        (["scenes", "smoke", "--photos", "0"], "at least 3 photos"),
        (["scenes", "smoke", "--resolution", "-1"], "64 pixels"),
        (["scenes", "smoke", "--samples", "0"], "sample"),
        (["stability", "--set", "iterationz=3"], "Unknown option"),
        (["stability", "--only", "noise", "--levels", "77"], "levels"),
    ],
)
def test_impossible_measurements_are_one_sentence(tmp_path, monkeypatch, capsys, args, part) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MGF_SCENES", str(tmp_path / "scenes"))
    assert bench_main(args) == 2
    said = capsys.readouterr().err
    assert part in said and said.count("\n") == 1
    assert not (tmp_path / "scenes").exists()


@pytest.mark.parametrize("option", ["--seeds", "--samples"])
@pytest.mark.parametrize("value", ["0", "-3", "1.5", "many"])
def test_counts_are_whole_numbers_from_one(option: str, value: str, capsys: pytest.CaptureFixture[str]) -> None:
    for suite in ("smoke", "stability"):
        with pytest.raises(SystemExit, match="2"):
            bench_main([suite, f"{option}={value}"])
        assert "a whole number from 1" in capsys.readouterr().err


@pytest.mark.parametrize("content", ["{", "[]", "{}", '{"ground_pixel": "small"}'])
def test_damaged_scene_records_are_one_sentence(scene: Path, content: str) -> None:
    (scene / "scene.json").write_text(content)
    with pytest.raises(BadInput, match=r"scene\.json"):
        prepare_scene(str(scene))


def test_scenes_without_true_cameras_are_one_sentence(scene: Path) -> None:
    (scene / "sparse_truth" / "images.bin").unlink()
    with pytest.raises(BadInput, match="sparse_truth"):
        prepare_scene(str(scene))


def test_mask_iou_of_a_job_ignores_unknown_pixels(scene: Path, tmp_path: Path) -> None:
    job = tmp_path / "job"
    (job / "masks").mkdir(parents=True)
    for path in (scene / "masks").glob("*.png"):
        truth = np.zeros((64, 96), np.uint8)
        truth[:, :48], truth[:, 90:] = 1, 255
        cv2.imwrite(str(path), truth)
        found = np.zeros((32, 48), np.uint8)
        found[:, :12], found[:, 45:] = 5, 1
        cv2.imwrite(str(job / "masks" / path.name), found)
    value = mean_mask_iou(job, scene)
    assert value == pytest.approx(50.0)
    assert prepare_scene(str(scene)).crop[0, 2] == pytest.approx(0.1)


def test_held_out_renders_are_scored_inside_the_true_masks(scene: Path, tmp_path: Path) -> None:
    """A grey wall whose render is 10 levels off where the true mask is; elsewhere all is wrong and does not count."""
    job = tmp_path / "job"
    (job / "renders").mkdir(parents=True)
    (job / "scene" / "images").mkdir(parents=True)
    names = sorted(path.stem for path in (scene / "masks").glob("*.png"))[:2]
    views = []
    for name in names:
        truth = np.zeros((64, 96), np.uint8)
        truth[:, :48], truth[:, 80:] = 2, 255
        cv2.imwrite(str(scene / "masks" / f"{name}.png"), truth)
        cv2.imwrite(str(job / "scene" / "images" / f"{name}.png"), np.full((32, 48, 3), 110, np.uint8))
        render = np.zeros((32, 48, 4), np.uint8)
        render[:, :24] = (200, 200, 200, 128)  # half transparent: 100 over black
        cv2.imwrite(str(job / "renders" / f"{name}.png"), render)
        views.append({"name": f"{name}.jpg", "file": f"scene/images/{name}.png", "render": f"renders/{name}.png",
                      "held_out": True})  # fmt: skip
    views.append({"name": "other.jpg", "file": "", "render": None, "held_out": False})
    (job / "deliver.json").write_text(json.dumps({"views": views}))
    scores = held_out_scores(job, scene)
    assert scores.psnr == pytest.approx(-20 * np.log10(10 / 255))
    assert scores.psnr_frame == pytest.approx(scores.psnr + 10 * np.log10(2))
    (job / "deliver.json").write_text(json.dumps({"views": views[2:]}))
    assert held_out_scores(job, scene).psnr is None


def test_tables_average_over_seeds(tmp_path: Path) -> None:
    hygiene = {"faces": 10, "components": 1, "holes": 0}
    rows = [
        {
            "variant": "full", "scene": "s", "seed": seed, "group": "g", "psnr": 30.0 + seed, "ssim": None,
            "seconds": 10.0, "cpu_seconds": 18.0, "peak_memory": 1e9, "gaussians": 5000, "faces": 10,
            "stages": {"scene": 1.0, "field": 8.0, "mesh": 1.0},
            "ground_pixel": 0.05,
            "geometry": {"thresholds": [0.05, 0.1, 0.2], "f1": [90.0 + 2 * seed, 95.0, 99.0], "accuracy": [90.0],
                         "completeness": [90.0], "outside_crop": 3.0, "hygiene": hygiene},
        }
        for seed in range(3)
    ]  # fmt: skip
    (table,) = summary_tables(rows)
    line = dict(zip(table["columns"], table["lines"][0], strict=True))
    assert line["F1 5 cm"] == "92.0 ±2.0" and line["PSNR"] == "31.00" and line["SSIM"] == "–"
    page = write_page(
        "pareto", [*rows, {"variant": "x", "scene": "s", "seed": 0, "failed": "out of <memory>"}], tmp_path
    )
    text = page.read_text(encoding="utf-8")
    assert "out of &lt;memory&gt;" in text and "92.0 ±2.0" in text
    assert len(list((tmp_path / "charts").glob("*.svg"))) == 7
    earlier = [{**row, "scene": "elsewhere/s", "cpu_seconds": 60.0} for row in rows]
    write_page("pareto", rows, tmp_path / "two", earlier)
    assert (tmp_path / "two/charts/pareto-s-moved.svg").exists()
    assert len(list((tmp_path / "two/charts").glob("*.svg"))) == 8


@pytest.mark.parametrize("text", [None, "{", "{}", '[{"variant": "full"}]'])
def test_an_earlier_table_that_is_none_is_refused_before_anything_runs(text, tmp_path: Path, capsys) -> None:
    path = tmp_path / "earlier.json"
    if text is not None:
        path.write_text(text)
    assert bench_main(["pareto", "--before", str(path), "--out", str(tmp_path / "out")]) == 2
    assert "give a suite's OUT/<suite>.json" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_steelwork_is_scored_with_the_rest_and_left_out(scene: Path, tmp_path: Path) -> None:
    parts = BUILDINGS["steel_frame"]("brick")
    trimesh.Trimesh(*true_mesh(parts), process=False).export(scene / "truth.ply")
    (scene / "scene.json").write_text(
        json.dumps({"ground_pixel": 0.2, "spec": {"building": "steel_frame", "wall": "brick"}})
    )
    hall = [part for part in parts if not part.element.startswith("frame.")]
    trimesh.Trimesh(*true_mesh(hall), process=False).export(scene / "hall.ply")
    out = tmp_path / "out"
    args = ["peers", "--only", "copy", "--scenes", str(scene), "--samples", "20000", "--out", str(out)]
    assert bench_main([*args, "--external", "copy=" + COPY.replace("truth.ply", "hall.ply")]) == 0
    (row,) = json.loads((out / "peers.json").read_text())
    assert row["geometry"]["f1"][0] < 95 and row["without_steelwork"]["f1"][0] > 99.9
    (table,) = summary_tables([row])
    assert "F1 without steelwork 5 cm" in table["columns"]
    assert len(table["columns"]) == len(table["lines"][0])


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (["smoke", "--bad"], "Error: Unrecognized arguments: --bad; 'mgf bench --help' lists all.\n"),
        (["masks", "--bad"], "Error: Unrecognized arguments: --bad; 'mgf bench masks --help' lists all.\n"),
        (["scenes", "smoke", "--bad"], "Error: Unrecognized arguments: --bad; 'mgf bench scenes --help' lists all.\n"),
        (["stability", "--bad"], "Error: Unrecognized arguments: --bad; 'mgf bench stability --help' lists all.\n"),
        (
            ["peers", "--seeds", "x"],
            "Error: Argument --seeds takes a whole number from 1, not 'x'; 'mgf bench --help' lists all.\n",
        ),
    ],
)
def test_a_wrong_argument_is_one_sentence(args: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        bench_main(args)
    assert ended.value.code == 2 and capsys.readouterr().err == said
