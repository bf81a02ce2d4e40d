# SPDX-License-Identifier: GPL-3.0-or-later
"""A job repeats only what is missing: after kills, cancelling, deleted results, a full disk; messages go forward."""

from __future__ import annotations

import itertools
import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from support.house_jobs import OPTIONS, copy_until
from support.jobs import ENVIRONMENT, finish, run_here, start

from benchmarks.synthetic.house import House
from mgf_engine.console.terminal import _sentence


def test_a_scene_that_was_read_names_the_photos_to_click(house: House, tmp_path: Path, capsys) -> None:
    """A fifth of them, and three at least; nobody needs that who has clicks."""
    names = {p.name for p in (house.folder / "images").iterdir()}
    for clicks, wanted in (((), True), (("--prompts", house.prompts), False)):
        given = (house.folder, "--out", tmp_path / f"job{wanted}", "--resolution", "160", *clicks)
        code, (*_, message) = run_here(capsys, "scene", *given)
        assert code == 0 and message["type"] == "result"
        assert ("suggested" in message) == wanted
        if wanted:
            assert len(message["suggested"]) >= 3 and set(message["suggested"]) <= names
            assert f"in some of these photos: {message['suggested'][0]}, " in _sentence(message)


def test_messages_go_through_all_stages_and_never_backwards(finished) -> None:
    _, messages = finished
    assert [m["stage"] for m in messages if m["type"] == "stage"] == ["scene", "masks", "field", "mesh", "deliver"]
    overall = [m["overall"] for m in messages if m["type"] == "progress"]
    assert all(b >= a - 1e-6 for a, b in itertools.pairwise(overall))


def test_a_finished_job_is_not_done_again(house: House, finished, capsys) -> None:
    job, _ = finished
    before = (job / "mesh.ply").stat().st_mtime_ns
    code, messages = run_here(capsys, "reconstruct", "--out", job, "--resume")
    assert code == 0 and all(m["cached"] for m in messages if m["type"] == "stage")
    assert (job / "mesh.ply").stat().st_mtime_ns == before


def test_what_was_deleted_is_made_again_alone(house: House, finished, tmp_path: Path, capsys) -> None:
    job = tmp_path / "job"
    shutil.copytree(finished[0], job)
    (job / "mesh.ply").unlink()
    _, messages = run_here(capsys, "reconstruct", "--out", job, "--resume")
    assert [m["stage"] for m in messages if m["type"] == "stage" and not m["cached"]] == ["mesh"]
    assert (job / "mesh.ply").read_bytes() == (finished[0] / "mesh.ply").read_bytes()


def test_a_damaged_result_is_named_and_made_again_by_the_next_run(finished, tmp_path: Path, capsys) -> None:
    job = tmp_path / "job"
    shutil.copytree(finished[0], job)
    next(iter(sorted((job / "masks" / "labels").iterdir()))).write_bytes(b"x")
    code, messages = run_here(capsys, "deliver", "--out", job, "--export-obj")
    assert "again" in messages[-1]["text"]
    assert code == 2
    _, messages = run_here(capsys, "deliver", "--out", job)
    assert [m["stage"] for m in messages if m["type"] == "stage" and not m["cached"]] == ["masks", "deliver"]
    assert (job / "mesh.obj").exists()


#: Stage that is killed -> up to which stage the job then goes on, and what is the same as without a kill.
KILLED = {
    "scene": ("mesh", "mesh.ply"),  # all in an empty folder: the same job gives the same mesh
    "masks": ("masks", "masks/labels/*"),
    "field": ("field", "field.ply"),
    "mesh": ("mesh", "mesh.ply"),
    "deliver": ("deliver", "texture.jpg"),
}


@pytest.mark.parametrize("stage", KILLED)
def test_a_kill_in_any_stage_costs_nothing_but_time(house: House, finished, tmp_path: Path, capsys, stage: str) -> None:
    job = tmp_path / "job"
    if stage != "scene":
        copy_until(finished[0], job, stage)
    run = start("reconstruct", house.folder, "--prompts", house.prompts, "--out", job, *OPTIONS, "--resume",
                "--checkpoint-seconds", "1")  # fmt: skip
    assert run.stdout is not None
    for line in run.stdout:
        message = json.loads(line)
        if message["type"] == "progress" and message["stage"] == stage and message["fraction"] >= 0.2:
            break
    else:
        pytest.fail(f"the job came to its end before a fifth of '{stage}' was told")
    time.sleep(0.3)
    run.send_signal(signal.SIGKILL)
    run.communicate()
    until, made = KILLED[stage]
    code, messages = run_here(capsys, until, "--out", job)
    assert code == 0 and messages[-1]["type"] == "result", messages[-1]
    whole = {path.relative_to(finished[0]): path.read_bytes() for path in finished[0].glob(made)}
    assert whole and {path.relative_to(job): path.read_bytes() for path in job.glob(made)} == whole


def test_cancel_by_closing_standard_input_leaves_a_job_to_resume(house: House, finished, tmp_path: Path) -> None:
    job = tmp_path / "job"
    copy_until(finished[0], job, "field")
    command = [sys.executable, "-m", "mgf_engine", "reconstruct", "--out", str(job), "--resume", "--progress", "json",
               "--cancel-on-eof"]  # fmt: skip
    run = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=ENVIRONMENT)
    assert run.stdout is not None
    assert run.stdin is not None
    for line in run.stdout:
        message = json.loads(line)
        if message["type"] == "progress" and message["stage"] == "field" and message["fraction"] > 0.1:
            run.stdin.close()
            break
    rest = [json.loads(line) for line in run.stdout]
    assert run.wait(60) == 3
    assert rest[-1]["type"] == "failed"
    assert "--resume" in rest[-1]["text"]
    assert (job / "checkpoints" / "training.npz").exists()


def test_without_a_texture_none_is_left_and_a_lost_one_is_made_again(finished, tmp_path: Path, capsys) -> None:
    job = tmp_path / "job"
    shutil.copytree(finished[0], job)
    (job / "texture.jpg").unlink()
    _, messages = run_here(capsys, "deliver", "--out", job)
    assert [m["stage"] for m in messages if m["type"] == "stage" and not m["cached"]] == ["deliver"]
    assert (job / "texture.jpg").read_bytes() == (finished[0] / "texture.jpg").read_bytes()
    run_here(capsys, "deliver", "--out", job, "--no-texture")
    assert not (job / "texture.jpg").exists() and not (job / "mesh_texture.npz").exists()
    assert "texture" not in json.loads((job / "deliver.json").read_text())


@pytest.fixture
def small_disk(tmp_path: Path):
    """A folder on a disk of two megabytes."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=2m", "tmpfs", folder], capture_output=True)
    if mounted.returncode:
        pytest.skip("this user may not mount a small disk")
    yield folder
    subprocess.run(["umount", folder], check=True)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="mounts a small disk the way of Linux")
def test_a_full_disk_ends_with_one_sentence_and_the_job_resumes(
    house: House, finished, small_disk: Path, capsys
) -> None:
    (small_disk / "filler").write_bytes(b"0" * 1_400_000)
    job = small_disk / "job"
    run = start("reconstruct", house.folder, "--prompts", house.prompts, "--out", job, *OPTIONS)
    messages = finish(run)
    assert run.returncode == 2
    assert "space" in messages[-1]["text"]
    assert not list(job.rglob(".part-*"))
    roomy = small_disk.parent / "roomy"
    shutil.copytree(job, roomy)
    code, messages = run_here(capsys, "mesh", "--out", roomy)
    assert code == 0 and messages[-1]["type"] == "result"
    assert (roomy / "mesh.ply").read_bytes() == (finished[0] / "mesh.ply").read_bytes()
