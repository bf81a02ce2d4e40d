# SPDX-License-Identifier: GPL-3.0-or-later
"""Job folders that are refused: of others, damaged, in use, not to be written to."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest
from filelock import FileLock

from mgf_engine.errors import BadInput
from mgf_engine.jobs.job import Job
from mgf_engine.jobs.job_folder import read_job
from tests.support.jobs import finish_all


@pytest.mark.parametrize("what", ["file", "foreign", "other scene", "no resume", "same as scene", "missing scene"])
def test_wrong_folders_are_refused_and_left_alone(tmp_path: Path, source: Path, what: str) -> None:
    out = tmp_path / "out"
    scene = source
    if what == "file":
        out.write_text("mine")
    elif what == "foreign":
        out.mkdir()
        (out / "thesis.txt").write_text("mine")
    elif what in ("other scene", "no resume"):
        with Job.start(out, source) as job:
            finish_all(job)
        if what == "other scene":
            scene = tmp_path
    elif what == "same as scene":
        out = source
    else:
        scene = tmp_path / "nowhere"
    before = sorted(str(p) for p in tmp_path.rglob("*"))
    with pytest.raises(BadInput):
        Job.start(out, scene, resume=what == "other scene")
    assert sorted(str(p) for p in tmp_path.rglob("*")) == before


@pytest.mark.parametrize("content", ["", "{", "[]", '{"format": 1}', '{"format": 99, "stages": {}, "given": {}, '
                                     '"source": "a", "prompts": null, "masks": null}', "[" * 50_000])  # fmt: skip
def test_damaged_job_files_are_refused(tmp_path: Path, content: str) -> None:
    (tmp_path / "job.json").write_text(content)
    with pytest.raises(BadInput):
        read_job(tmp_path)


def test_a_folder_in_use_is_refused_and_free_again_after_a_kill(tmp_path: Path, source: Path) -> None:
    code = (
        "import sys,time; from pathlib import Path; from mgf_engine.jobs.job import Job;"
        "job = Job.start(Path(sys.argv[1]), Path(sys.argv[2])); print('open', flush=True); time.sleep(60)"
    )
    other = subprocess.Popen(
        [sys.executable, "-c", code, str(tmp_path / "job"), str(source)], stdout=subprocess.PIPE, text=True
    )
    try:
        assert other.stdout is not None
        assert other.stdout.readline() == "open\n"
        with pytest.raises(BadInput, match="in use"):
            Job.start(tmp_path / "job", source, resume=True)
    finally:
        other.kill()
        other.wait()
    Job.start(tmp_path / "job", source, resume=True).close()


@pytest.mark.skipif(os.name == "nt" or os.geteuid() == 0, reason="rights do not bind the superuser or Windows folders")
def test_a_folder_without_write_permission_is_refused(tmp_path: Path, source: Path) -> None:
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(BadInput, match="Cannot write"):
            Job.start(tmp_path / "job", source)
    finally:
        tmp_path.chmod(0o700)


def test_an_unwritable_place_is_refused(source: Path) -> None:
    with pytest.raises(BadInput, match="Cannot write"):
        Job.start(Path("/proc/mgf-job"), source)


@pytest.mark.skipif(os.name == "nt", reason="making symbolic links takes rights that users of Windows lack")
@pytest.mark.parametrize("target", ["lock of elsewhere", "nowhere", ".lock"])
def test_a_lock_that_is_a_symbolic_link_is_refused_and_its_target_left_alone(tmp_path, source, target) -> None:
    (tmp_path / "lock of elsewhere").write_text("mine")
    (tmp_path / "job").mkdir()
    (tmp_path / "job" / ".lock").symlink_to(target if target == ".lock" else tmp_path / target)
    with pytest.raises(BadInput, match="symbolic link"):
        Job.start(tmp_path / "job", source)
    assert (tmp_path / "lock of elsewhere").read_text() == "mine"
    assert not (tmp_path / "nowhere").exists()


def test_a_file_system_without_locks_is_refused(tmp_path: Path, source: Path, monkeypatch) -> None:
    def no_locks(self: FileLock, timeout: float) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(FileLock, "acquire", no_locks)
    with pytest.raises(BadInput, match="No locks available"):
        Job.start(tmp_path / "job", source)


def test_what_another_process_finishes_before_it_lets_go_is_kept(tmp_path: Path, source: Path, monkeypatch) -> None:
    other = Job.start(tmp_path / "job", source)
    other.finish("scene", other.keys["scene"], 1.0, 2.0, 1, {}, [])
    acquire = FileLock.acquire

    def at_the_last_moment(self: FileLock, timeout: float) -> object:
        monkeypatch.undo()
        for stage in ("masks", "field"):
            other.finish(stage, other.keys[stage], 1.0, 2.0, 1, {}, [])
        other.close()
        return acquire(self, timeout=timeout)

    monkeypatch.setattr(FileLock, "acquire", at_the_last_moment)
    with Job.start(tmp_path / "job", resume=True):
        pass
    assert set(read_job(tmp_path / "job")["stages"]) == {"scene", "masks", "field"}


def test_a_job_folder_is_no_scene(tmp_path: Path, source: Path) -> None:
    """Its working photos would be taken for photos, small and cut as they are."""
    Job.start(tmp_path / "job", source).close()
    with pytest.raises(BadInput, match=f"is a job folder; give the scene of that job, '{source}'"):
        Job.start(tmp_path / "other", tmp_path / "job")
    assert not (tmp_path / "other").exists()
    (source / "job.json").write_text("{}")  # of some other program
    Job.start(tmp_path / "other", source).close()


def test_a_folder_without_a_job_is_said(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="holds no job; give the folder that 'mgf reconstruct' made"):
        read_job(tmp_path)
