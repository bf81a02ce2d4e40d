# SPDX-License-Identifier: GPL-3.0-or-later
"""The part of a COLMAP model that a building gets: its photos, points that two of them see, and links."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.synthetic.colmap_scene import reconstruction, write_model
from mgf_engine.errors import BadInput
from mgf_engine.scene.colmap import read_model
from mgf_engine.scene.sparse import NO_POINT, SparseModel, check_model
from mgf_engine.town import submodel
from mgf_engine.town.submodel import write_if_changed, write_submodel


@pytest.fixture
def model(tmp_path: Path) -> SparseModel:
    """Every fourth point is not seen by the second and the third photo."""
    model = read_model(write_model(reconstruction("PINHOLE", frames=6, points=80), tmp_path / "whole"))
    return without(model, np.arange(0, len(model.points.ids), 4), (1, 2))


def without(model: SparseModel, rows: np.ndarray, photos: tuple[int, ...]) -> SparseModel:
    """The model without the observations of some points in some photos."""
    points, images = model.points, list(model.images)
    for k in photos:
        hidden = np.isin(images[k].point_ids, points.ids[rows])
        images[k] = replace(images[k], point_ids=np.where(hidden, NO_POINT, images[k].point_ids))
    ids = [images[k].id for k in photos]
    kept = ~(np.isin(points.track_point, rows) & np.isin(points.image_ids, ids))
    counts = np.bincount(points.track_point[kept], minlength=len(points.ids))
    fewer = replace(
        points, start=np.concatenate([[0], np.cumsum(counts)]), image_ids=points.image_ids[kept],
        keypoint=points.keypoint[kept],
    )  # fmt: skip
    found = replace(model, images=tuple(images), points=fewer)
    check_model(found)
    return found


@pytest.fixture
def photos(model: SparseModel, tmp_path: Path) -> dict[str, Path]:
    found = {}
    for image in model.images:
        found[image.name] = tmp_path / "photos" / image.name
        found[image.name].parent.mkdir(parents=True, exist_ok=True)
        found[image.name].write_text(image.name)
    return found


def seen(model: SparseModel, names: list[str]) -> dict[int, set[str]]:
    """Point -> photos of these names that see it."""
    by_id = {image.id: image.name for image in model.images}
    found: dict[int, set[str]] = {}
    for row, image in zip(model.points.track_point.tolist(), model.points.image_ids.tolist(), strict=True):
        if by_id[image] in names:
            found.setdefault(int(model.points.ids[row]), set()).add(by_id[image])
    return found


def test_the_part_is_a_model_of_its_photos_and_of_points_that_two_of_them_see(
    model: SparseModel, photos: dict[str, Path], tmp_path: Path
) -> None:
    names = [image.name for image in model.images[1:4]]
    kept = np.arange(len(model.points.ids)) % 3 != 0
    count = write_submodel(model, names, kept, photos, tmp_path / "part")
    part = read_model(tmp_path / "part/sparse/0")
    assert [image.name for image in part.images] == names
    wanted = {
        k for k, who in seen(model, names).items() if len(who) >= 2 and kept[list(model.points.ids).index(k)]
    }  # fmt: skip
    assert set(part.points.ids.tolist()) == wanted and count == len(wanted)
    assert 0 < len(wanted) < kept.sum()  # some are seen by one of them alone
    assert seen(part, names) == {k: v for k, v in seen(model, names).items() if k in wanted}
    whole = {image.name: image for image in model.images}
    for image in part.images:
        assert image.quaternion.tolist() == whole[image.name].quaternion.tolist()
        assert image.translation.tolist() == whole[image.name].translation.tolist()
        used = np.isin(whole[image.name].point_ids, list(wanted))
        assert np.abs(image.keypoints - whole[image.name].keypoints[used]).max() < 1e-5
        assert image.point_ids.tolist() == whole[image.name].point_ids[used].tolist()
    rows = {int(k): n for n, k in enumerate(model.points.ids)}
    for own, k in enumerate(part.points.ids.tolist()):
        assert part.points.xyz[own].tolist() == model.points.xyz[rows[k]].tolist()
        assert part.points.rgb[own].tolist() == model.points.rgb[rows[k]].tolist()


def test_links_lead_to_the_photos_and_others_go(model: SparseModel, photos: dict[str, Path], tmp_path: Path) -> None:
    every, part = np.ones(len(model.points.ids), bool), tmp_path / "part"
    names = [image.name for image in model.images]
    write_submodel(model, names[:4], every, photos, part)
    before = (part / "images" / names[2]).lstat().st_mtime_ns
    write_submodel(model, names[2:], every, photos, part)
    assert sorted(p.relative_to(part / "images").as_posix() for p in (part / "images").rglob("*") if p.is_file()) == (
        sorted(names[2:])
    )
    assert (part / "images" / names[3]).read_text() == names[3]
    assert (part / "images" / names[2]).lstat().st_mtime_ns == before


def test_where_no_link_can_be_made_one_sentence_says_so(
    model: SparseModel, photos: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object) -> None:
        raise OSError(1, "Operation not permitted")

    monkeypatch.setattr(Path, "symlink_to", refused)
    names, every = [model.images[0].name], np.ones(len(model.points.ids), bool)
    write_submodel(model, names, every, photos, tmp_path / "hard")
    assert os.path.samefile(tmp_path / "hard/images" / names[0], photos[names[0]])
    monkeypatch.setattr(submodel.os, "link", refused)
    with pytest.raises(BadInput, match="Cannot link the photo"):
        write_submodel(model, names, every, photos, tmp_path / "none")


def test_what_stays_the_same_keeps_its_time(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "file.json"
    path.parent.mkdir()
    assert write_if_changed(path, "ä") and not write_if_changed(path, "ä") and write_if_changed(path, "b")
    assert path.read_text(encoding="utf-8") == "b"
