# SPDX-License-Identifier: GPL-3.0-or-later
"""Short forms of ``python -m benchmarks.stability_faults``; kills are in tests/pipeline/test_resume.py."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.full_disk import run as run_on_full_disk
from benchmarks.synthetic.house_scene import PHOTOS, house_scene
from mgf_engine.errors import EXIT_BAD_INPUT, EXIT_FAULT, BadInput, explain
from mgf_engine.files.atomic import json_text, write_json
from mgf_engine.jobs.job import Job
from mgf_engine.jobs.job_folder import read_job
from mgf_engine.messages import encode

BROKEN = os.fsdecode(b"caf\xe9")  # a name in Latin-1, as an old disk may hold


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return house_scene(tmp_path_factory)


def test_a_disk_full_at_every_file_ends_with_one_sentence_and_resumes(source: Path, tmp_path: Path) -> None:
    args = ["scene", str(source), "--prompts", str(source / "prompts.json"), "--out", str(tmp_path / "job")]
    assert run_on_full_disk(tmp_path / "failed.json", [*args, "--resolution", "100", "--threads", "1"]) == 0
    failed = json.loads((tmp_path / "failed.json").read_text())
    assert len(failed) > PHOTOS + 3  # every photo, the scene, the job file several times
    assert "scene" in read_job(tmp_path / "job")["stages"]
    assert not [p for p in (tmp_path / "job").rglob("*") if p.name.startswith(".part-") or p.suffix == ".part"]


def test_what_a_kill_left_half_written_is_swept_away(source: Path, tmp_path: Path) -> None:
    job = tmp_path / "job"
    Job.start(job, source).close()
    (job / "masks/labels").mkdir(parents=True)
    for name in (".part-abc.json", "masks/labels/.part-x.png"):
        (job / name).write_bytes(b"half")
    (job / "masks/labels/whole.png").write_bytes(b"whole")
    Job.start(job, source, resume=True).close()
    assert not list(job.rglob(".part-*"))
    assert (job / "masks/labels/whole.png").exists()


def test_nothing_is_swept_away_while_another_process_writes(source: Path, tmp_path: Path) -> None:
    job = tmp_path / "job"
    with Job.start(job, source):
        (job / ".part-abc.json").write_bytes(b"half")
        with pytest.raises(BadInput, match="in use"):
            Job.start(job, source, resume=True)
        assert (job / ".part-abc.json").exists()


@pytest.mark.parametrize(
    "text",
    [
        "[enforce fail at alloc_cpu.cpp:127] err == 0. DefaultCPUAllocator: can't allocate memory: you tried",
        "OpenCV(5.0.0) alloc.cpp:73: error: (-4:Insufficient memory) Failed to allocate 80000 bytes",
        "std::bad_alloc",
        "libtorch_cpu.so: failed to map segment from shared object",
        "can't start new thread",
    ],
)
def test_libraries_without_memory_are_understood(text: str) -> None:
    code, said = explain(RuntimeError(text))
    assert code == EXIT_BAD_INPUT
    assert said.startswith("Out of memory")
    assert explain(RuntimeError("something else"))[0] == EXIT_FAULT


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="asks Linux for the process's memory")
def test_strange_errors_near_the_memory_limit_are_understood() -> None:
    code = (
        "import resource; from mgf_engine.errors import explain; from mgf_engine.errors import near_memory_limit;"
        "error = SystemError('error return without exception set'); print(explain(error)[0], near_memory_limit());"
        "resource.setrlimit(resource.RLIMIT_AS, (4 << 30, 4 << 30)); print(explain(error)[0]);"
        "block = bytearray(3500 << 20); del block; print(explain(error)[0])"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.split() == ["1", "False", "1", "2"]


@pytest.mark.skipif(os.name == "nt", reason="Windows has no such names")
def test_folders_with_names_in_another_encoding_work(source: Path, tmp_path: Path) -> None:
    folder = tmp_path / BROKEN
    with Job.start(folder / "job", source) as job:
        job.finish("scene", job.begin("scene"), 1.0, 2.0, 1, {}, [f"about '{folder}'."])
    data = read_job(folder / "job")
    assert data["stages"]["scene"]["warnings"] == [f"about '{folder}'."]


def test_json_holds_any_name(tmp_path: Path) -> None:
    assert json_text({"name": "Köln"}) == '{"name": "Köln"}'
    assert json_text({"name": "Köln"}, "ascii") == '{"name": "K\\u00f6ln"}'
    write_json(tmp_path / "x.json", {"name": BROKEN})
    assert json.loads((tmp_path / "x.json").read_text(encoding="utf-8")) == {"name": BROKEN}
    assert json.loads(encode({"type": "warning", "text": BROKEN}))["text"] == BROKEN


@pytest.mark.parametrize(
    "change",
    [
        lambda d: d.update(format=0),
        lambda d: d["stages"].update(polish={}),
        lambda d: d["stages"].update(scene=5),
        lambda d: d["stages"]["scene"].pop("figures"),
        lambda d: d["stages"]["scene"].update(key=["x"]),
    ],
)
def test_job_files_of_other_versions_are_refused(source: Path, tmp_path: Path, change) -> None:
    with Job.start(tmp_path / "job", source) as job:
        job.finish("scene", job.begin("scene"), 1.0, 2.0, 1, {}, [])
    data = json.loads((tmp_path / "job/job.json").read_text())
    change(data)
    (tmp_path / "job/job.json").write_text(json.dumps(data))
    with pytest.raises(BadInput):
        Job.start(tmp_path / "job", source, resume=True)
