# SPDX-License-Identifier: GPL-3.0-or-later
import contextlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

from mgf_engine import system
from mgf_engine.masks.segmenters.download import default_folder
from mgf_engine.native.cuda.gpu import cache_folder
from mgf_engine.system import atomic_path, peak_memory, versions, write_json


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    write_json(path, [1])
    with pytest.raises(ValueError, match="half way"), atomic_path(path) as temporary:
        temporary.write_text("half")
        raise ValueError("half way")
    assert path.read_text().split() == ["[", "1", "]"]
    assert [p.name for p in tmp_path.iterdir()] == ["a.json"]


@pytest.mark.parametrize(("windows", "tries", "written"), [(True, 3, True), (True, 1000, False), (False, 1, False)])
def test_on_windows_a_file_that_is_being_read_is_waited_for(tmp_path, monkeypatch, windows, tries, written) -> None:
    write_json(tmp_path / "a.json", [1])
    held, waited, replace = [tries], [], os.replace

    def held_open(new: Path, old: Path) -> None:
        held[0] -= 1
        if held[0] >= 0:
            raise PermissionError(13, "The process cannot access the file")
        replace(new, old)

    monkeypatch.setattr(system, "_WINDOWS", windows)
    monkeypatch.setattr(os, "replace", held_open)
    monkeypatch.setattr(system.time, "sleep", waited.append)
    with contextlib.nullcontext() if written else pytest.raises(PermissionError):
        write_json(tmp_path / "a.json", [2])
    assert (tmp_path / "a.json").read_text().split() == ["[", "2" if written else "1", "]"]
    assert sum(waited) < 2.5
    assert (len(waited) > 0) == windows
    assert [p.name for p in tmp_path.iterdir()] == ["a.json"]


@pytest.mark.skipif(os.name != "posix", reason="rights of files are a matter of POSIX systems")
@pytest.mark.parametrize("umask", ["022", "077"])
def test_files_get_the_rights_the_user_wants(tmp_path: Path, umask: str) -> None:
    code = "import sys, pathlib, mgf_engine.system as s; s.write_json(pathlib.Path(sys.argv[1]), 1)"
    subprocess.run(["sh", "-c", f'umask {umask}; "$0" -c "$1" "$2"', sys.executable, code, tmp_path / "a"], check=True)
    assert (tmp_path / "a").stat().st_mode & 0o777 == 0o666 & ~int(umask, 8)


def test_figures_of_the_machine() -> None:
    assert peak_memory() > 10 << 20
    assert versions()["numpy"] != "missing"


def test_a_program_started_by_a_large_one_is_not_taken_for_large() -> None:
    child = "from mgf_engine.system import peak_memory; print(peak_memory())"
    parent = (
        "import subprocess, sys; big = b'x' * (600 << 20); "
        f"print(subprocess.run([sys.executable, '-c', {child!r}], capture_output=True, text=True).stdout)"
    )
    run = subprocess.run([sys.executable, "-c", parent], capture_output=True, text=True, check=True)
    assert 10 << 20 < int(run.stdout) < 400 << 20


def test_all_that_is_cached_goes_where_the_variable_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The page on the command line says so of the whole folder; the variable moved compiled GPU kernels alone."""
    monkeypatch.setenv("MGF_CACHE", str(tmp_path))
    places = (system.user_cache(), default_folder().parent, cache_folder().parent)
    assert set(places) == {tmp_path}
