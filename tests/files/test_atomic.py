# SPDX-License-Identifier: GPL-3.0-or-later
import contextlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

from mgf_engine.files import atomic
from mgf_engine.files.atomic import atomic_folder, atomic_path, sweep, write_json


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

    monkeypatch.setattr(atomic, "_WINDOWS", windows)
    monkeypatch.setattr(os, "replace", held_open)
    monkeypatch.setattr(atomic.time, "sleep", waited.append)
    with contextlib.nullcontext() if written else pytest.raises(PermissionError):
        write_json(tmp_path / "a.json", [2])
    assert (tmp_path / "a.json").read_text().split() == ["[", "2" if written else "1", "]"]
    assert sum(waited) < 2.5
    assert (len(waited) > 0) == windows
    assert [p.name for p in tmp_path.iterdir()] == ["a.json"]


@pytest.mark.skipif(os.name != "posix", reason="rights of files are a matter of POSIX systems")
@pytest.mark.parametrize("umask", ["022", "077"])
def test_files_get_the_rights_the_user_wants(tmp_path: Path, umask: str) -> None:
    code = "import sys, pathlib, mgf_engine.files.atomic as f; f.write_json(pathlib.Path(sys.argv[1]), 1)"
    subprocess.run(["sh", "-c", f'umask {umask}; "$0" -c "$1" "$2"', sys.executable, code, tmp_path / "a"], check=True)
    assert (tmp_path / "a").stat().st_mode & 0o777 == 0o666 & ~int(umask, 8)


def test_a_whole_folder_replaces_the_old_one(tmp_path: Path) -> None:
    out = tmp_path / "drawings"
    out.mkdir()
    (out / "old.txt").touch()
    with atomic_folder(out) as beside:
        (beside / "new.txt").touch()
        assert (out / "old.txt").exists()
    assert [p.name for p in out.iterdir()] == ["new.txt"] and list(tmp_path.iterdir()) == [out]


def test_a_failure_leaves_the_old_folder_and_nothing_else(tmp_path: Path) -> None:
    out = tmp_path / "drawings"
    out.mkdir()
    (out / "old.txt").touch()
    with pytest.raises(ZeroDivisionError), atomic_folder(out):
        raise ZeroDivisionError
    assert [p.name for p in out.iterdir()] == ["old.txt"] and list(tmp_path.iterdir()) == [out]


def test_ctrl_c_while_the_folders_change_places_leaves_the_old_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "drawings"
    out.mkdir()
    (out / "old.txt").touch()
    replace = os.replace

    def interrupted(source: Path, target: Path) -> None:
        if (source / "new.txt").exists():
            raise KeyboardInterrupt
        replace(source, target)

    monkeypatch.setattr(os, "replace", interrupted)
    with pytest.raises(KeyboardInterrupt), atomic_folder(out) as beside:
        (beside / "new.txt").touch()
    assert [p.name for p in out.iterdir()] == ["old.txt"] and list(tmp_path.iterdir()) == [out]


def test_what_a_killed_process_left_is_swept_away(tmp_path: Path) -> None:
    (tmp_path / "scene" / ".part-images-x").mkdir(parents=True)
    for name in (".part-a.json", "scene/.part-images-x/1.jpg", "scene/scene.npz"):
        (tmp_path / name).touch()
    sweep(tmp_path)
    assert [p.relative_to(tmp_path).as_posix() for p in sorted(tmp_path.rglob("*"))] == ["scene", "scene/scene.npz"]
