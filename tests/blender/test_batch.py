# SPDX-License-Identifier: GPL-3.0-or-later
"""The headless script, run as people run it: a process of its own."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import bpy
import pytest
import synthetic
from conftest import REPO

from mgf_blender.results import picture

BATCH = REPO / "mgf_blender" / "batch.py"


def run(*arguments: object) -> subprocess.CompletedProcess:
    command = [sys.executable, str(BATCH), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120)


def test_scene_and_job_become_a_blend(house, tmp_path):
    out = tmp_path / "a folder" / "démo.blend"
    png = tmp_path / "picture.png"
    done = run("--scene", house.folder, "--job", house.job, "--out", out, "--picture", png,
               "--picture-engine", "cycles", "--picture-samples", 1, "--picture-size", 64, 48)  # fmt: skip
    assert done.returncode == 0, done.stderr
    bpy.ops.wm.open_mainfile(filepath=str(out))
    scene = bpy.context.scene
    top = next(c for c in scene.collection.children if c.name == house.folder.name)
    assert {c.name for c in top.children} == {"Cameras", "Points", "Mesh", "Renders"}
    assert [len(top.children[k].objects) for k in ("Cameras", "Points", "Mesh", "Renders")] == [12, 1, 1, 4]
    assert all(o.parent is not None for c in top.children for o in c.objects)
    assert [s.name for s in bpy.data.scenes] == ["Scene"]  # the stage of the picture is gone
    image = bpy.data.images.load(str(png))
    assert tuple(image.size) == (64, 48)
    pixels = list(image.pixels)
    assert max(pixels[0::4]) - min(pixels[0::4]) > 0.1
    assert sorted(p.name for p in out.parent.iterdir()) == ["démo.blend"]


def test_a_picture_that_fails_costs_nothing_else(house, tmp_path):
    out, file = tmp_path / "a.blend", tmp_path / "file"
    file.write_text("no folder")
    done = run("--scene", house.folder, "--job", house.job, "--out", out, "--picture", file / "p.png")
    assert done.returncode != 0 and out.is_file()


@pytest.mark.parametrize("there", [True, False])
def test_a_build_without_denoiser_makes_pictures(monkeypatch, there):
    """Debian's Blender ended with "Failed to denoise"."""
    monkeypatch.setitem(sys.modules, "_cycles", SimpleNamespace(with_openimagedenoise=there))
    stage = bpy.data.scenes.new("stage")
    picture._settings(stage, Path("p.png"), (32, 24), 1, "CYCLES")
    assert stage.cycles.use_denoising == there


def test_photos_alone_give_the_collection_its_name(house, tmp_path):
    model = tmp_path / "job" / "scene" / "sfm" / "model"
    shutil.copytree(house.job, tmp_path / "job")
    shutil.copytree(house.model, model)
    out = tmp_path / "a.blend"
    assert run("--scene", house.folder / "images", "--job", tmp_path / "job", "--out", out).returncode == 0
    bpy.ops.wm.open_mainfile(filepath=str(out))
    assert house.folder.name in [c.name for c in bpy.context.scene.collection.children]


def test_scene_alone(house, tmp_path):
    assert run("--scene", house.model, "--out", tmp_path / "a.blend").returncode == 0
    assert (tmp_path / "a.blend").is_file()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--scene", "{nowhere}"], "does not exist"),
        (["--job", "{nowhere}"], "does not exist"),
        ([], "Nothing to import"),
        (["--scene", "{house}", "--picture", "{nowhere}/p.png"], "no mesh"),
        (["--scene", "{house}", "--set", "preset=quick", "resolution=400"], "Unrecognized arguments: resolution=400"),
        (["--scene", "{house}", "--picture-engine", "luxcore"], "invalid choice: 'luxcore'"),
    ],
)
def test_bad_input_is_one_sentence_and_code_2(tmp_path, arguments, words):
    house = synthetic.write_house(tmp_path / "house")
    places = {"nowhere": tmp_path / "nowhere", "house": house.folder}
    out = tmp_path / "out" / "a.blend"
    done = run(*[a.format(**places) for a in arguments], "--out", out)
    assert done.returncode == 2
    assert words in done.stderr and "Traceback" not in done.stderr and len(done.stderr.strip().splitlines()) == 1
    assert not out.exists()


def test_reconstruct_runs_the_engine_and_passes_its_code_on(house, engine, tmp_path):
    engine("ok", FAKE_RESULT=house.job)
    job, out = tmp_path / "new job", tmp_path / "a.blend"
    arguments = ["--reconstruct", "--scene", house.folder, "--job", job, "--out", out, "--set", "preset=draft"]
    done = run(*arguments)
    assert done.returncode == 0, done.stderr
    assert "[3/5] field" in done.stdout and "Mesh of 16 faces" in done.stdout and out.is_file()
    given = json.loads((job / "arguments.json").read_text())
    assert "preset=draft" in given and "--resume" not in given
    done = run(*arguments, "--progress", "json")
    types = [json.loads(line)["type"] for line in done.stdout.splitlines() if line.startswith("{")]
    assert types[0] == "started" and types[-1] == "result"
    assert "--resume" in json.loads((job / "arguments.json").read_text())
    for mode, code, words in (
        ("bad", 2, "no photos"),
        ("silent", 1, "ended with code 77 (Segmentation fault in kernel)"),
    ):
        engine(mode)
        done = run(*arguments)
        assert done.returncode == code and words in done.stderr and "Traceback" not in done.stderr


def test_ctrl_c_cancels_the_engine(house, engine, tmp_path):
    engine("slow")
    job = tmp_path / "job"
    command = [sys.executable, str(BATCH), "--reconstruct", "--scene", str(house.folder), "--job", str(job)]
    process = subprocess.Popen(
        [*command, "--out", str(tmp_path / "a.blend")], stderr=subprocess.PIPE, text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # a shell's background jobs ignore Ctrl-C
    )  # fmt: skip
    while not (job / "arguments.json").exists() and process.poll() is None:
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 3 and "Cancelled" in errors and "Traceback" not in errors
    assert not (tmp_path / "a.blend").exists()


def test_unwritable_place(house):
    done = run("--scene", house.folder, "--out", Path("/proc/nowhere/a.blend"))
    assert done.returncode == 2 and "Cannot write" in done.stderr and "Traceback" not in done.stderr


def test_drawings_and_models_of_the_job_are_made_too(house, engine, tmp_path):
    engine("ok", FAKE_MODELS=house.folder / "sparse")
    out = tmp_path / "a.blend"
    arguments = ["--job", house.job, "--out", out]
    done = run(*arguments, "--drawings")
    assert done.returncode == 0, done.stderr
    given = json.loads((house.job / "arguments.json").read_text())
    assert given[:2] == ["drawings", str(house.job)] and "--draw" not in given and "--cancel-on-eof" in given
    assert (house.job / "drawings" / "orthophoto-A.png").is_file() and "Drawings in" in done.stdout
    assert out.is_file() and not (house.job / "models").exists()
    assert run(*arguments, "--drawings", "orthophotos", "sections", "--models", "solid", "ifc").returncode == 0
    given = json.loads((house.job / "arguments.json").read_text())
    assert given[0] == "models" and given[given.index("--only") + 1] == "solid,ifc"
    assert run(*arguments, "--drawings", "sections").returncode == 0
    given = json.loads((house.job / "arguments.json").read_text())
    assert [given[i + 1] for i, word in enumerate(given) if word == "--draw"] == ["sections"]


@pytest.mark.parametrize(("mode", "code", "words"), [("bad", 2, "no photos"), ("silent", 1, "ended with code 77")])
def test_drawings_that_fail_leave_the_blend_and_pass_the_code_on(house, engine, tmp_path, mode, code, words):
    engine(mode)
    done = run("--job", house.job, "--out", tmp_path / "a.blend", "--drawings", "--models")
    assert done.returncode == code and words in done.stderr and "Traceback" not in done.stderr
    assert (tmp_path / "a.blend").is_file() and not (house.job / "models").exists()


def test_drawings_without_a_job_or_of_an_unknown_kind_are_refused(house, tmp_path):
    done = run("--scene", house.folder, "--out", tmp_path / "a.blend", "--drawings")
    assert done.returncode == 2 and "give --job" in done.stderr and not (tmp_path / "a.blend").exists()
    done = run("--job", house.job, "--out", tmp_path / "a.blend", "--drawings", "plans")
    assert done.returncode == 2 and "plans" in done.stderr
