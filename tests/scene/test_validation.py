# SPDX-License-Identifier: GPL-3.0-or-later
"""Foreign photos and stray points are found and taken out, bad cameras and thin sets of photos are spoken of."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.small_scene import make_scene, view

from benchmarks.perturb import perturb
from benchmarks.synthetic.colmap_scene import Messages
from benchmarks.synthetic.house_scene import PHOTOS, house_scene
from mgf_engine.errors import BadInput
from mgf_engine.masks.prompts import read_prompts
from mgf_engine.model.scene import Scene
from mgf_engine.options.config import make_config
from mgf_engine.scene.exposure import observed_colors
from mgf_engine.scene.load import load_scene
from mgf_engine.scene.store import read_saved_scene
from mgf_engine.scene.validation import (
    diagnose,
    drop_views,
    find_outlier_points,
    find_outlier_views,
    keep_points,
    photo_consistency,
    reprojection_errors,
    surround_angle,
    triangulation_angle,
)


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return house_scene(tmp_path_factory)


def loaded(source: Path, tmp_path: Path, name: str = "noise", level: float = 0.0) -> tuple[Scene, list[str], Path]:
    folder = perturb(source, tmp_path / "copy", name, level)
    messages = Messages()
    scene = load_scene(folder, tmp_path / "job/scene", make_config({}), messages.reporter)
    return scene, messages.warnings, folder


def test_a_sound_scene_is_left_alone(source: Path, tmp_path: Path) -> None:
    scene, warnings, _ = loaded(source, tmp_path)
    assert warnings == []
    assert len(scene.views) == PHOTOS
    assert scene.left_out == ()
    assert not find_outlier_points(scene).any()
    assert find_outlier_views(observed_colors(scene, scene.folder / "images").mean(1), scene)[0] == []
    assert np.median(reprojection_errors(scene)) < 0.01


@pytest.mark.parametrize("count", [1, 4])
def test_foreign_photos_are_left_out_by_name_and_their_clicks_passed_over(
    source: Path, tmp_path: Path, count: int
) -> None:
    scene, warnings, folder = loaded(source, tmp_path, "foreign", count)
    changed = {p.name for p in (folder / "images").iterdir() if not p.is_symlink()}
    assert set(scene.left_out) == changed
    assert len(scene.views) == PHOTOS - count
    assert f"{count} of {PHOTOS} photos" in warnings[0]
    assert sorted(changed)[0] in warnings[0]
    again = read_saved_scene(scene.folder)
    assert again.left_out == scene.left_out
    clicks = json.loads((folder / "prompts.json").read_text())
    clicks[sorted(changed)[0]] = {"positive": [[5, 5]]}
    prompts = tmp_path / "prompts.json"
    prompts.write_text(json.dumps(clicks))
    assert len(read_prompts(prompts, again)) == len(set(clicks) - changed)


@pytest.mark.parametrize("count", [0, 1, 8])
def test_the_majority_tells_the_foreign_photos(count: int) -> None:
    """Twenty photos see the same sixty points; ``count`` of them show something else there."""
    rng = np.random.default_rng(8)
    points = rng.uniform(30, 220, 60)
    seen = points + rng.normal(0, 15, (20, 60))
    wrong = rng.permutation(20)[:count]
    seen[wrong] = rng.uniform(30, 220, (count, 60))
    views = [view(f"{i:02d}.jpg", i) for i in range(20)]
    scene = make_scene(views, np.zeros((60, 3)), [[(v, 5.0, 5.0) for v in range(20)]] * 60)
    found, others = find_outlier_views(seen.T.ravel(), scene)
    assert found == sorted(wrong.tolist())
    assert np.nanmin(others) > 0.8
    assert np.isnan(others[found]).all()


def test_consistency_is_the_correlation_with_the_mean_of_the_others() -> None:
    """Against its definition, written out; some photos see a point twice, and one is not trusted."""
    rng = np.random.default_rng(9)
    tracks = [[(int(v), 5.0, 5.0) for v in np.sort(rng.integers(0, 6, rng.integers(2, 7)))] for _ in range(300)]
    scene = make_scene([view(f"{i}.jpg", i) for i in range(7)], np.zeros((300, 3)), tracks)
    brightness, trusted = rng.uniform(0, 255, len(scene.track_view)), scene.track_view != 2
    found = photo_consistency(brightness, scene, trusted)
    for index in range(6):
        mine, rest = [], []
        for row in np.flatnonzero(scene.track_view == index):
            same = scene.track_point == scene.track_point[row]
            others = brightness[same & trusted & (scene.track_view != index)]
            if len(others):
                mine.append(brightness[row])
                rest.append(others.mean())
        assert found[index] == pytest.approx(np.corrcoef(mine, rest)[0, 1], abs=1e-9)
    assert np.isnan(found[6])  # sees nothing


def test_too_many_foreign_photos_are_spoken_of_and_none_dropped(source: Path, tmp_path: Path) -> None:
    scene, warnings, _ = loaded(source, tmp_path, "foreign", 11)
    assert len(scene.views) == PHOTOS
    assert any("photos of another place" in text for text in warnings)


@pytest.mark.parametrize("share", [0.5, 0.8])
def test_points_that_no_photo_sees_where_they_lie_are_left_out(source: Path, tmp_path: Path, share: float) -> None:
    sound, _, _ = loaded(source, tmp_path / "sound")
    scene, warnings, _ = loaded(source, tmp_path, "points_outliers", share)
    assert abs(len(scene.points) / len(sound.points) - (1 - share)) < 0.03
    assert reprojection_errors(scene).max() < 20
    assert "sparse points have large reprojection errors" in warnings[0]


@pytest.mark.parametrize(("name", "level"), [("pose", 8.0), ("focal", 10.0)])
def test_cameras_that_disagree_with_the_points_are_adjusted(
    source: Path, tmp_path: Path, name: str, level: float
) -> None:
    sound, _, _ = loaded(source, tmp_path / "sound")
    scene, warnings, _ = loaded(source, tmp_path, name, level)
    assert np.median(reprojection_errors(scene)) < 0.05
    assert scene.views[0].fx == pytest.approx(sound.views[0].fx, rel=0.01)
    assert any("bundle adjustment reduced it" in text for text in warnings)


def test_cameras_that_cannot_be_adjusted_are_spoken_of(source: Path, tmp_path: Path) -> None:
    scene, _, _ = loaded(source, tmp_path)
    shaken = replace(scene, track_uv=scene.track_uv + np.float32(2.0) * np.sign(scene.track_uv % 2 - 1))
    assert any("bundle adjustment did not help" in text for text in diagnose(shaken))
    assert diagnose(scene) == []


def test_few_photos_and_photos_from_one_side_are_spoken_of(source: Path, tmp_path: Path) -> None:
    few, warnings, _ = loaded(source, tmp_path / "few", "photos", 4)
    assert abs(triangulation_angle(few) - 80) < 25
    assert any("Photos 5 to 15 degrees apart" in text for text in warnings)
    side, warnings, _ = loaded(source, tmp_path / "side", "side", 120)
    assert 80 < surround_angle(side) < 140
    assert any("degrees around the building" in text for text in warnings)
    whole, _, _ = loaded(source, tmp_path / "whole")
    assert surround_angle(whole) > 320


def test_few_points_are_spoken_of(source: Path, tmp_path: Path) -> None:
    _, warnings, _ = loaded(source, tmp_path, "points_missing", 0.97)
    assert any("sparse points; masks and mesh will be poor" in text for text in warnings)


def test_moving_shadows_are_spoken_of_and_drop_no_photo(source: Path, tmp_path: Path) -> None:
    scene, warnings, _ = loaded(source, tmp_path, "shadows", 0.85)
    assert len(scene.views) == PHOTOS
    assert any("moving shadows" in text for text in warnings)


def test_exposures_alone_make_no_photo_foreign(source: Path, tmp_path: Path) -> None:
    scene, _, _ = loaded(source, tmp_path, "exposure", 2.0)
    assert len(scene.views) == PHOTOS


def test_views_are_dropped_with_their_observations(source: Path, tmp_path: Path) -> None:
    scene, _, _ = loaded(source, tmp_path)
    smaller = drop_views(scene, [0, 5], every=4)
    assert [v.name for v in smaller.views] == [v.name for i, v in enumerate(scene.views) if i not in (0, 5)]
    assert smaller.left_out == (scene.views[0].name, scene.views[5].name)
    assert (np.diff(smaller.track_start) >= 2).all()
    assert reprojection_errors(smaller).max() < 0.1  # every observation still belongs to its point and view
    assert max(*smaller.roots, *smaller.held_out) < PHOTOS - 2
    with pytest.raises(BadInput, match="two photos"):
        drop_views(scene, list(range(PHOTOS - 1)), every=4)


def test_no_point_left_is_refused(source: Path, tmp_path: Path) -> None:
    scene, _, _ = loaded(source, tmp_path)
    with pytest.raises(BadInput, match="No sparse point"):
        keep_points(scene, np.zeros(len(scene.points), bool))
    kept = keep_points(replace(scene), np.arange(len(scene.points)) % 2 == 0)
    assert reprojection_errors(kept).max() < 0.1


@pytest.mark.parametrize("factor,warned", [(0.94, True), (1.06, True), (1.01, False)])
def test_unequal_focal_lengths_are_told(factor: float, warned: bool) -> None:
    views = [view(f"{i}.jpg", float(i), fy=10.0 * factor) for i in range(3)]
    texts = diagnose(make_scene(views, np.zeros((0, 3)), []))
    assert any("focal lengths in x and y differ by 6." in text for text in texts) == warned
