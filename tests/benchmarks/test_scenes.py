# SPDX-License-Identifier: GPL-3.0-or-later
"""The generator: cache names, and (with a Python that has bpy) photos and masks that agree with the true mesh."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks import scenes
from benchmarks.camera_path import Ring
from benchmarks.catalogue import SCENES
from benchmarks.develop import photo_frame
from benchmarks.scenes import find_blender_python, make_scene, render_views, scene_folder, scenes_main
from benchmarks.shapes import true_mesh
from mgf_engine.errors import BadInput
from mgf_engine.evaluation.surfaces import Surface
from mgf_engine.model.masks import BUILDING, IGNORE
from mgf_engine.model.scene import View

TINY = replace(
    SCENES["demo"], building="tower", photos=2, width=120, samples=1, trees=1, trees_in_front=4, neighbours=1, cars=0,
    rings=(Ring(1.0, 9.0, 26.0, 12.0),), field_of_view=62.0, seed=5,
)  # fmt: skip


def test_every_control_has_its_own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MGF_SCENES", str(tmp_path))
    folders = {scene_folder("demo", replace(TINY, seed=seed, trees=trees)) for seed in (0, 1) for trees in (0, 5)}
    assert len(folders) == 4 and all(f.parent == tmp_path for f in folders)
    assert scene_folder("demo", TINY) == scene_folder("demo", replace(TINY))


def test_without_blender_the_user_is_told_what_to_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MGF_SCENES", str(tmp_path))
    monkeypatch.setenv("MGF_BPY_PYTHON", str(tmp_path / "nothing here"))
    with pytest.raises(BadInput, match="No Python with bpy"):
        make_scene("demo", TINY, say=lambda text: None)


def test_a_wrong_blender_is_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MGF_SCENES", str(tmp_path))
    with pytest.raises(BadInput, match="Cannot start '/nowhere/python'"):
        make_scene("demo", TINY, Path("/nowhere/python"), say=lambda text: None)


def test_a_link_takes_the_place_of_links_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scenes, "make_scene", lambda *args, **more: tmp_path / "made")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("mine")
    with pytest.raises(BadInput, match="is no link"):
        scenes_main(["smoke", "--link", str(tmp_path / "mine")])
    assert (tmp_path / "mine" / "thesis.txt").read_text() == "mine"
    for _ in range(2):
        assert scenes_main(["smoke", "--link", str(tmp_path / "link")]) == 0
        assert (tmp_path / "link").readlink() == tmp_path / "made"


@pytest.mark.slow
def test_rendered_masks_agree_with_the_true_mesh_to_the_pixel(tmp_path: Path) -> None:
    try:
        blender = find_blender_python()
    except BadInput as error:
        pytest.skip(str(error))
    said: list[str] = []
    folder = tmp_path / "tiny scene"
    building, _, shots, labels = render_views(folder, TINY, blender, 2, said.append)
    assert said[-1] == "rendered 6 of 6"
    vertices, faces = true_mesh(building)
    truth = Surface(vertices, faces.astype(np.int64))
    unknown = 0
    for shot, label in zip(shots, labels, strict=True):
        frame = photo_frame(TINY)
        camera = View("", "", *frame, shot.rotation, shot.translation, *frame[:2])
        assert np.array_equal(hits(truth, camera), label != 0)
        unknown += int((label == IGNORE).sum())
        elements = cv2.imread(str(folder / "elements" / (Path(shot.name).stem + ".png")), cv2.IMREAD_UNCHANGED)
        assert elements is not None
        assert np.array_equal(elements == IGNORE, label == IGNORE)
        assert np.array_equal((elements != 0) & (elements != IGNORE), label == BUILDING)
        assert len(np.unique(elements)) > 4
        photo = cv2.imread(str(folder / "images" / shot.name))
        assert photo is not None and photo.shape == (TINY.height, TINY.width, 3)
        assert 25 < photo.mean() < 230 and photo.std() > 15
    assert unknown > 20  # the trees in front hide a part

    # A stopped render goes on where it was: only the missing picture is made again.
    kept, gone = sorted((folder / "work/photos").glob("*.png"))
    stamp = kept.stat().st_mtime_ns
    gone.unlink()
    render_views(folder, TINY, blender, 2, said.append)
    assert kept.stat().st_mtime_ns == stamp and gone.exists()


def hits(surface: Surface, camera: View) -> np.ndarray:
    """Pixels whose centre's ray meets the surface, bool [height, width]."""
    v, u = np.mgrid[0 : camera.height, 0 : camera.width] + 0.5
    local = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], axis=-1)
    return (
        surface.first_hits(camera.centre, local.reshape(-1, 3) @ camera.rotation)[0].reshape(
            camera.height, camera.width
        )
        >= 0
    )
