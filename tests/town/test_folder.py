# SPDX-License-Identifier: GPL-3.0-or-later
"""A town goes into a folder of its own, and leaves none where it was refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from mgf_engine.cli.main import main


@pytest.fixture
def photos(tmp_path: Path) -> Path:
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "a.jpg").write_bytes(b"x")
    return tmp_path / "photos"


@pytest.mark.parametrize("command", ["town", "buildings"])
def test_a_folder_of_something_else_is_left_alone(photos: Path, tmp_path: Path, capsys, command: str) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter.txt").write_text("mine")
    (tmp_path / "file").write_text("mine")
    cases = {photos: "is the scene itself", tmp_path / "mine": "holds no town", tmp_path / "file": "is a file"}
    for out, part in cases.items():
        assert main([command, str(photos), "--find", "--out", str(out)]) == 2
        assert part in capsys.readouterr().err
    assert [p.name for p in photos.iterdir()] == ["a.jpg"]
    assert [p.name for p in (tmp_path / "mine").iterdir()] == ["letter.txt"]


@pytest.mark.parametrize("command", ["town", "buildings"])
@pytest.mark.parametrize("extra", [[], ["--find"], ["--footprints", "nowhere.geojson"]])
def test_a_refused_town_leaves_no_folder(photos: Path, tmp_path: Path, capsys, command: str, extra: list[str]) -> None:
    assert main([command, str(photos), *extra, "--out", str(tmp_path / "town")]) == 2  # one photo is too few
    assert "Error: " in capsys.readouterr().err and not (tmp_path / "town").exists()


def test_a_place_that_cannot_be_written_to_is_named(photos: Path, tmp_path: Path, capsys) -> None:
    (tmp_path / "file").write_text("mine")
    assert main(["town", str(photos), "--find", "--out", str(tmp_path / "file" / "town")]) == 2
    assert "Cannot write to" in capsys.readouterr().err
