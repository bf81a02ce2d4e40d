# SPDX-License-Identifier: GPL-3.0-or-later
"""Structure from motion is put onto the true frame by the cameras that are right; too few photos are no model."""

from pathlib import Path

import numpy as np
import pycolmap
import pytest

from benchmarks import features
from benchmarks.camera_path import Ring, Shot, plan
from benchmarks.develop import Frame, Lens
from benchmarks.features import NoModel, _similarity, sfm_model

FRAME = Frame(96, 64, 80.0, 80.0, 49.0, 31.0)
LENS = (-0.1, 0.02, 0.001, 0.0)


def test_one_camera_placed_wrong_does_not_move_the_model() -> None:
    rng = np.random.default_rng(0)
    true = rng.uniform(-20, 20, (24, 3))
    wanted = pycolmap.Sim3d(2.5, pycolmap.Rotation3d(np.array([0.3, -0.2, 1.1])), np.array([4.0, -1.0, 9.0]))
    found = wanted.inverse() * (true + rng.normal(scale=0.01, size=true.shape))
    found[7] += 1.0
    placed = _similarity(found, true) * found
    off = np.linalg.norm(placed - true, axis=1)
    assert off[7] > 2.0
    assert np.delete(off, 7).max() < 0.05
    # Least squares would have moved all of it by a tenth of that camera's error.


def shots() -> list[Shot]:
    extent = np.array([[-5.0, -3], [5, 3]])
    return plan(4, extent, (Ring(1.0, 10.0, 14.0, 4.0),), None, 0, 0, np.random.default_rng(0))


def found_model(
    folder: Path, monkeypatch: pytest.MonkeyPatch, photos: int, refine_focal: bool = True, lens: Lens = LENS
) -> tuple[pycolmap.Reconstruction, Path, pycolmap.IncrementalPipelineOptions]:
    """What ``sfm_model`` makes of a mapping that places so many of four photos; the database and options it had."""
    (folder / "work").mkdir()
    camera = pycolmap.Camera(
        model="OPENCV" if any(lens) else "PINHOLE", width=FRAME.width, height=FRAME.height,
        params=[*FRAME[2:], *([0.0] * 4 if any(lens) else [])], camera_id=1,
    )  # fmt: skip
    camera.has_prior_focal_length = True
    with pycolmap.Database.open(folder / "work/features.db") as db:
        db.write_camera(camera, use_camera_id=True)
    used: list[tuple[Path, pycolmap.IncrementalPipelineOptions]] = []

    def mapping(
        database: Path, *_: object, options: pycolmap.IncrementalPipelineOptions
    ) -> dict[int, pycolmap.Reconstruction]:
        used.append((Path(database), options))
        model = pycolmap.Reconstruction()
        with pycolmap.Database.open(database) as db:
            model.add_camera_with_trivial_rig(db.read_all_cameras()[0])
        for number, shot in enumerate(shots()[:photos], 1):
            pose = pycolmap.Rigid3d(pycolmap.Rotation3d(shot.rotation), shot.translation)
            model.add_image_with_trivial_frame(pycolmap.Image(name=shot.name, camera_id=1, image_id=number), pose)
        return {0: model}

    monkeypatch.setattr(features.pycolmap, "incremental_mapping", mapping)
    return sfm_model(folder, shots(), FRAME, lens, refine_focal), *used[0]


def test_photos_with_a_lens_are_mapped_with_few_parameters(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    model, used, options = found_model(tmp_path, monkeypatch, 4)
    (camera,) = model.cameras.values()
    assert camera.model.name == "RADIAL" and list(camera.params) == [80.0, 49.0, 31.0, 0.0, 0.0]
    assert camera.has_prior_focal_length
    with pycolmap.Database.open(tmp_path / "work/features.db") as db:  # which true cameras are triangulated with
        assert db.read_all_cameras()[0].model.name == "OPENCV"
    assert options.ba_refine_focal_length
    assert used.name == "one_focal_length.db" and (tmp_path / "sparse/0/cameras.bin").exists()


def test_photos_without_a_lens_are_mapped_with_one_focal_length(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    model, *_ = found_model(tmp_path, monkeypatch, 4, lens=(0.0, 0.0, 0.0, 0.0))
    (camera,) = model.cameras.values()
    assert camera.model.name == "SIMPLE_PINHOLE" and list(camera.params) == [80.0, 49.0, 31.0]
    with pycolmap.Database.open(tmp_path / "work/features.db") as db:
        assert db.read_all_cameras()[0].model.name == "PINHOLE"


def test_a_known_focal_length_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert not found_model(tmp_path, monkeypatch, 4, refine_focal=False)[2].ba_refine_focal_length


def test_two_photos_are_no_model(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(NoModel, match="found no model"):
        found_model(tmp_path, monkeypatch, 2)
    assert not (tmp_path / "sparse").exists()
