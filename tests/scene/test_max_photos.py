# SPDX-License-Identifier: GPL-3.0-or-later
"""A job on some of many photos: those that are spread out, and all that the user clicked on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.synthetic.colmap_scene import Messages, config, reconstruction, reprojection, write_scene
from mgf_engine.masks.prompts import clicked_names
from mgf_engine.model.scene import Scene
from mgf_engine.scene.load import load_scene
from mgf_engine.scene.names import named_like


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_scene(reconstruction(frames=12, points=200), tmp_path_factory.mktemp("many") / "scene")


@pytest.fixture(autouse=True)
def no_doubts(monkeypatch: pytest.MonkeyPatch) -> None:
    """The photos of these scenes are alike in shape, not in content, and might be taken for those of another place."""
    monkeypatch.setattr("mgf_engine.scene.load.filter_outliers", lambda scene, *others: scene)


def names_in(source: Path) -> list[str]:
    return sorted(p.relative_to(source / "images").as_posix() for p in (source / "images").rglob("*.*"))


def load(source: Path, tmp_path: Path, limit: int, clicked: list[str]) -> Scene:
    return load_scene(source, tmp_path / "job/scene", config(max_photos=limit), Messages().reporter, clicked)


def test_clicked_photos_are_among_those_that_are_used(source: Path, tmp_path: Path) -> None:
    names = names_in(source)
    clicked = [names[1], Path(names[4]).stem.upper(), "no such photo.jpg"]
    scene = load(source, tmp_path, 5, clicked)
    used = [view.name for view in scene.views]
    assert len(used) == 5 and {names[1], names[4]} <= set(used)
    assert set(scene.left_out) == set(names) - set(used)
    files = {p.name for p in (tmp_path / "job/scene/images").iterdir()}
    assert files == {Path(view.file).name for view in scene.views}  # the others are not even decoded
    assert np.bincount(scene.track_view, minlength=5).min() > 10 and np.diff(scene.track_start).min() >= 2
    assert reprojection(scene).max() < 0.1
    assert set(scene.roots) | set(scene.held_out) <= set(range(5))


@pytest.mark.parametrize("limit", [0, 12, 50])
def test_all_are_used_where_they_are_not_too_many(source: Path, tmp_path: Path, limit: int) -> None:
    scene = load(source, tmp_path, limit, [])
    assert len(scene.views) == 12 and scene.left_out == ()


def test_every_clicked_photo_is_used_even_beyond_the_limit(source: Path, tmp_path: Path) -> None:
    names = names_in(source)
    assert [view.name for view in load(source, tmp_path, 3, names[2:7]).views] == names[2:7]


def test_names_of_a_prompts_file_that_cannot_be_read_are_none(tmp_path: Path) -> None:
    path = tmp_path / "prompts.json"
    assert clicked_names(None) == clicked_names(path) == []
    path.write_text("{")
    assert clicked_names(path) == []
    path.write_text('{"b.jpg": {}, "a.jpg": {}}')
    assert clicked_names(path) == ["a.jpg", "b.jpg"]


def test_names_are_compared_strictly_first() -> None:
    names = ["left/A.jpg", "right/a.jpg", "right/b.png"]
    assert named_like("right\\a.jpg", names) == [1]
    assert named_like("A.jpg", names) == [0]
    assert named_like("a.JPG", names) == [0, 1]
    assert named_like("B.tif", names) == [2]
    assert named_like("c", names) == []
