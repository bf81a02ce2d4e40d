# SPDX-License-Identifier: GPL-3.0-or-later
"""The truth of a scene: materials per face, and depth, normal and material per pixel."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest

from benchmarks.buildings import BUILDINGS
from benchmarks.camera_path import look_at
from benchmarks.catalogue import SCENES, SURFACES, SceneSpec
from benchmarks.develop import photo_frame, pixel_rays
from benchmarks.scenes import building_parts, scene_folder
from benchmarks.shapes import Builder
from benchmarks.truth import read_truth, true_pixels, write_pixels, write_truth
from mgf_engine.errors import BadInput

SPEC = SceneSpec(width=64, lens=(-0.1, 0.0, 0.0, 0.0))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A brick box of 4 m with a slate lid, seen from the south at 10 m."""
    b = Builder()
    b.box((-2, -2, 0), (2, 2, 4), "brick")
    b.box((-2, -2, 4), (2, 2, 4.5), "slate")
    write_truth(tmp_path, b.parts())
    frame, model = photo_frame(SPEC), pycolmap.Reconstruction()
    camera = pycolmap.Camera(
        model="OPENCV", width=frame.width, height=frame.height, params=[*frame[2:], *SPEC.lens], camera_id=1
    )
    model.add_camera_with_trivial_rig(camera)
    rotation, translation = look_at(np.array([0.0, -12.0, 3.0]), np.array([0.0, 0.0, 3.0]))
    pose = pycolmap.Rigid3d(pycolmap.Rotation3d(rotation), translation)
    model.add_image_with_trivial_frame(pycolmap.Image(name="a.jpg", camera_id=1, image_id=1), pose)
    (tmp_path / "sparse_truth").mkdir()
    model.write(tmp_path / "sparse_truth")
    return tmp_path


def test_pixels_know_depth_normal_and_material(folder: Path) -> None:
    truth = read_truth(folder)
    rotation, translation = look_at(np.array([0.0, -12.0, 3.0]), np.array([0.0, 0.0, 3.0]))
    rays = pixel_rays(SPEC)
    seen = true_pixels(truth, rotation, translation, rays)
    assert seen.depth[seen.mask] == pytest.approx(10.0)
    assert seen.normal[seen.mask] == pytest.approx(np.tile([0.0, -1.0, 0.0], (int(seen.mask.sum()), 1)))
    height = 3.0 - 10.0 * rays[..., 1]  # of what is met, since the camera looks level
    inside = (np.abs(10.0 * rays[..., 0]) < 2) & (height > 0) & (height < 4.5)
    assert np.array_equal(seen.mask, inside)
    names = np.array([*truth.materials.names, "nothing"])[seen.material]
    assert set(names[inside & (height > 4)]) == {"slate"} and set(names[inside & (height < 4)]) == {"brick"}
    assert set(names[~inside]) == {"nothing"} and np.isinf(seen.depth[~inside]).all()


def test_pixels_are_written_for_each_photo(folder: Path) -> None:
    with np.load(write_pixels(folder, SPEC) / "a.npz") as found:
        assert found["mask"].shape == (SPEC.height, SPEC.width)
        assert found["depth"][found["mask"]] == pytest.approx(10.0, abs=1e-5)
        assert np.array_equal(found["material"] >= 0, found["mask"])


def test_a_truth_without_materials_is_one_sentence(folder: Path) -> None:
    for name in ("truth_materials.json", "truth_materials.npy"):
        (folder / name).unlink()
    with pytest.raises(BadInput, match="has no materials"):
        read_truth(folder)


def test_half_of_the_surfaces_are_held_out() -> None:
    held_out = [name for name, spec in SURFACES.items() if spec.held_out]
    assert abs(2 * len(held_out) - len(SURFACES)) <= 1
    assert len({spec.building for spec in SURFACES.values()}) >= 9
    assert all(spec.building in BUILDINGS for spec in SURFACES.values())
    assert sum(any(spec.lens) for spec in SURFACES.values()) >= len(SURFACES) // 2


def test_a_roof_of_another_material_leaves_the_rest() -> None:
    plain, other = (building_parts(SCENES[name]) for name in ("white_house", "ochre_house"))
    assert {p.material for p in plain if p.element.startswith("roof.")} != {"clean_grey"}
    assert {p.material for p in other if p.element.startswith("roof.")} == {"clean_grey"}
    assert len(plain) == len(other)


def test_what_a_scene_is_for_does_not_change_its_pictures() -> None:
    assert scene_folder("a", SPEC) == scene_folder("a", replace(SPEC, held_out=True))
    assert scene_folder("a", SPEC) != scene_folder("a", replace(SPEC, jpeg=50))
