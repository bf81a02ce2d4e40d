# SPDX-License-Identifier: GPL-3.0-or-later
"""The default segmenter on a painted house with true masks: quality, wrong clicks, files, bad input."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from benchmarks.synthetic.house import OFFSET, House, build_house
from mgf_engine.errors import BadInput
from mgf_engine.masks import build
from mgf_engine.masks.build import build_masks
from mgf_engine.masks.prompts import Clicks as PhotoClicks
from mgf_engine.masks.propagation.prompt_outliers import OutlierPrompt, ignored_outliers
from mgf_engine.masks.propagation.propagate import Propagation
from mgf_engine.masks.store import read_masks
from mgf_engine.messages import Message, Reporter
from mgf_engine.model.masks import IGNORE, MaskSet, building
from mgf_engine.model.scene import Scene
from mgf_engine.options.config import make_config
from mgf_engine.scene.load import load_scene
from tests.masks.conftest import quiet

CONFIG = make_config({"segmenter": "random_walker", "device": "cpu", "second_level": "off"})
Clicks = dict[str, dict[str, Any]]


def run(
    scene: Scene, clicks: Clicks, folder: Path, sink: Callable[[Message], None] | None = None, **options: Any
) -> MaskSet:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "prompts.json"
    path.write_text(json.dumps(clicks))
    reporter = Reporter(*([sink] if sink else []))
    reporter.stage("masks")
    return build_masks(scene, path, None, folder / "masks", replace(CONFIG, **options), reporter)


def ious(masks: MaskSet, scene: Scene, house: House) -> np.ndarray:
    pairs = [(building(m), house.masks[v.name]) for m, v in zip(masks.labels, scene.views, strict=True)]
    return np.array([(a & b).sum() / (a | b).sum() for a, b in pairs])


@pytest.fixture(scope="module")
def house(tmp_path_factory: pytest.TempPathFactory) -> House:
    """Ten photos: what clicks do shows in them as in more."""
    return build_house(tmp_path_factory.mktemp("house"), 10)


@pytest.fixture(scope="module")
def scene(house: House, tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return load_scene(house.folder, tmp_path_factory.mktemp("job") / "scene", make_config(), quiet())


@pytest.fixture(scope="module")
def clicks(house: House) -> Clicks:
    return json.loads(house.prompts.read_text())


@pytest.fixture(scope="module")
def plain(scene: Scene, clicks: Clicks, tmp_path_factory: pytest.TempPathFactory) -> tuple[MaskSet, Path]:
    folder = tmp_path_factory.mktemp("plain")
    return run(scene, clicks, folder), folder / "masks"


@pytest.fixture
def first_level(plain: tuple[MaskSet, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs begin with the masks of the whole building as ``plain`` has them: they are about the elements."""
    masks = replace(plain[0], labels=tuple(label.copy() for label in plain[0].labels))
    made = Propagation(masks, ["" for _ in masks.labels], [], 1.0)
    monkeypatch.setattr(build, "propagate", lambda *_: made)


def test_every_photo_gets_a_good_mask(plain: tuple[MaskSet, Path], scene: Scene, house: House):
    masks, _ = plain
    scores = ious(masks, scene, house)
    assert scores.mean() > 0.95 and scores.min() > 0.9
    assert masks.used.all() and (masks.scores > 0.9).all()


def test_points_of_the_house_are_kept_and_those_of_the_lawn_dropped(plain: tuple[MaskSet, Path], scene: Scene):
    height = scene.to_normalised.invert(scene.points)[:, 2] - OFFSET[2]
    kept = plain[0].point_mask
    assert kept[height > 0.1].mean() > 0.97
    # Masks grow by 3 px for the test, which at 240 px takes in a strip of lawn along the walls.
    assert kept[height < 0.01].mean() < 0.08


def test_what_is_written_is_what_is_read(plain: tuple[MaskSet, Path], scene: Scene):
    masks, folder = plain
    again = read_masks(folder, scene)
    assert all((a == b).all() for a, b in zip(again.labels, masks.labels, strict=True))
    assert (again.used == masks.used).all() and (again.point_mask == masks.point_mask).all()
    assert np.allclose(again.scores, masks.scores, atol=1e-4)
    assert sum(len(c) for c in masks.clicks) >= 8
    assert all(np.allclose(a, b, atol=0.01) for a, b in zip(again.clicks, masks.clicks, strict=True))
    sheet = cv2.imread(str(folder / "contact_sheet.jpg"))
    assert sheet is not None and sheet.shape[1] >= 320
    figures = json.loads((folder / "scores.json").read_text())
    assert figures["segmenter"] == "random_walker" and figures["consistency"] >= 0.98
    assert not list(folder.rglob(".part-*"))


def test_without_finishing_the_masks_are_what_the_segmenter_drew(
    plain: tuple[MaskSet, Path], scene: Scene, house: House, clicks: Clicks, tmp_path: Path
):
    masks = run(scene, clicks, tmp_path, algorithms={"propagation.finish": False})
    assert not any((labels == IGNORE).any() for labels in masks.labels)  # nobody said what stands in front
    assert any((a != b).any() for a, b in zip(masks.labels, plain[0].labels, strict=True))
    assert ious(masks, scene, house).mean() > 0.9
    assert masks.used.all() and masks.point_mask.any()


def test_clicks_off_by_ten_pixels(scene: Scene, house: House, clicks: Clicks, tmp_path: Path):
    rng = np.random.default_rng(3)
    shaken = json.loads(json.dumps(clicks))
    for entry in shaken.values():
        for kind in ("positive", "negative"):
            entry[kind] = [np.clip(np.add(p, 5 * rng.normal(size=2)), 0, (239, 179)).tolist() for p in entry[kind]]
    assert ious(run(scene, shaken, tmp_path), scene, house).mean() > 0.94


def test_a_wrong_click_is_left_out_and_said(scene: Scene, house: House, clicks: Clicks, tmp_path: Path):
    wrong = json.loads(json.dumps(clicks))
    names = sorted(wrong)
    wrong[names[1]]["positive"].append(wrong[names[1]]["negative"][0])  # the lawn called building
    wrong[names[1]]["negative"] = []
    messages: list[Message] = []
    masks = run(scene, wrong, tmp_path, messages.append)
    scores = ious(masks, scene, house)
    assert (scores[masks.used] > 0.9).all()
    texts = [m["text"] for m in messages if m["type"] == "warning"]
    assert any(names[1] in t and "are ignored" in t for t in texts)


def test_a_doubted_click_beside_the_building_counts_and_is_said(
    scene: Scene, house: House, clicks: Clicks, tmp_path: Path
):
    wrong = json.loads(json.dumps(clicks))
    name = sorted(wrong)[1]
    spot = wrong[name]["positive"].pop()
    wrong[name]["negative"].append(spot)
    messages: list[Message] = []
    masks = run(scene, wrong, tmp_path, messages.append)
    texts = [m["text"] for m in messages if m["type"] == "warning" and name in m["text"]]
    assert any("still used" in t and f"({spot[0]:.0f}, {spot[1]:.0f})" in t for t in texts)
    others = np.array([v.name != name for v in scene.views])
    assert (ious(masks, scene, house)[masks.used & others] > 0.9).all()


def test_clicks_beside_the_building_are_left_out_of_photos_of_another_building():
    prompts = {3: PhotoClicks(np.zeros((2, 2)), np.zeros((2, 2))), 5: PhotoClicks(np.zeros((2, 2)), np.zeros((2, 2)))}
    of_another = [OutlierPrompt(3, True, 0, 0.1), OutlierPrompt(3, True, 1, 0.1), OutlierPrompt(3, False, 0, 0.9)]
    slips = [OutlierPrompt(5, True, 0, 0.1), OutlierPrompt(5, False, 1, 0.9)]
    assert ignored_outliers(of_another + slips, prompts) == [*of_another, slips[0]]


def test_a_photo_clicked_the_other_way_round(scene: Scene, house: House, clicks: Clicks, tmp_path: Path):
    wrong = json.loads(json.dumps(clicks))
    name = sorted(wrong)[2]
    wrong[name] = {"positive": wrong[name]["negative"], "negative": wrong[name]["positive"]}
    messages: list[Message] = []
    masks = run(scene, wrong, tmp_path, messages.append)
    assert (ious(masks, scene, house)[masks.used] > 0.9).all()
    assert any(m["type"] == "warning" and name in m["text"] for m in messages)


def test_suggest_for_one_photo_only(scene: Scene, house: House, clicks: Clicks, tmp_path: Path):
    name = sorted(clicks)[0]
    masks = run(scene, {name: clicks[name]}, tmp_path)
    scores = ious(masks, scene, house)
    assert (scores[masks.used] > 0.8).all() and masks.used.sum() > len(scores) / 2


def test_what_nobody_clicked_around_the_house_is_not_the_house(
    scene: Scene, house: House, clicks: Clicks, tmp_path: Path
):
    name = sorted(clicks)[1]
    sky = {name: {"positive": clicks[name]["positive"], "negative": [[5, 5]]}}
    masks = run(scene, sky, tmp_path)
    scores = ious(masks, scene, house)
    assert masks.used.all() and scores.mean() > 0.93 and scores.min() > 0.85


def test_positive_clicks_alone(scene: Scene, house: House, clicks: Clicks, tmp_path: Path):
    only = {name: {"positive": entry["positive"]} for name, entry in clicks.items()}
    masks = run(scene, only, tmp_path)
    assert ious(masks, scene, house)[masks.used].mean() > 0.9


def test_user_parts_are_named_in_every_photo_that_clicked_them(
    scene: Scene, clicks: Clicks, first_level: None, tmp_path: Path
):
    named = json.loads(json.dumps(clicks))
    for name in sorted(named)[:2]:
        named[name]["parts"] = {"roof": [named[name]["positive"][1]]}
    run(scene, named, tmp_path, second_level="auto")
    parts = json.loads((tmp_path / "masks/parts.json").read_text())["parts"]
    roof = [p for p in parts if p["name"] == "roof"]
    assert len(roof) == 1 and {e[0] for e in roof[0]["elements"]} >= set(sorted(named)[:2])


@pytest.mark.parametrize(
    ("options", "elements"), [({}, False), ({"boundary_loss": True}, True), ({"second_level": "on"}, True)]
)
def test_elements_are_found_only_where_something_uses_them(scene, clicks, first_level, tmp_path, options, elements):
    masks = run(scene, clicks, tmp_path, **{"second_level": "auto", **options})
    assert any(((m >= 2) & (m < 255)).any() for m in masks.labels) == elements


def test_masks_off(scene: Scene, tmp_path: Path):
    config = make_config({"use_masks": False})
    masks = build_masks(scene, None, None, tmp_path, config, quiet())
    assert all((m == 1).all() for m in masks.labels) and masks.used.all() and masks.point_mask.all()


def test_supplied_masks_are_used_as_they_are(scene: Scene, house: House, tmp_path: Path):
    given = tmp_path / "given"
    given.mkdir()
    for view in scene.views[1:]:
        cv2.imwrite(str(given / f"{view.name[:-4]}.png"), house.masks[view.name].astype(np.uint8) * 255)
    messages: list[Message] = []
    reporter = Reporter(messages.append)
    reporter.stage("masks")
    masks = build_masks(scene, None, given, tmp_path / "masks", CONFIG, reporter)
    assert not masks.used[0] and masks.used[1:].all()
    for view, labels in list(zip(scene.views, masks.labels, strict=True))[1:]:
        assert (building(labels) == house.masks[view.name]).all()
    assert any(m["type"] == "warning" and scene.views[0].name in m["text"] for m in messages)


def test_no_clicks_and_no_masks(scene: Scene, tmp_path: Path):
    with pytest.raises(BadInput, match="--prompts FILE, or --masks FOLDER"):
        build_masks(scene, None, None, tmp_path / "masks", CONFIG, quiet())
    assert not (tmp_path / "masks").exists()


def test_damaged_results_have_a_sentence(plain: tuple[MaskSet, Path], scene: Scene, tmp_path: Path):
    import shutil

    def copy(name: str) -> Path:
        return Path(shutil.copytree(plain[1], tmp_path / name))

    with pytest.raises(BadInput, match="run the masks stage again"):
        read_masks(tmp_path / "none", scene)
    for clicks in ("[[1]]", '[["a", 2]]', "[[1, NaN]]", "3"):
        odd = copy(f"odd{len(clicks)}{clicks[-3:-2]}") / "scores.json"
        odd.write_text(odd.read_text().replace('"clicks": []', f'"clicks": {clicks}'))
        with pytest.raises(BadInput, match="run the masks stage again"):
            read_masks(odd.parent, scene)
    cut = copy("cut")
    label = next((cut / "labels").glob("*.png"))
    label.write_bytes(label.read_bytes()[:40])
    with pytest.raises(BadInput, match="missing, damaged or of another size"):
        read_masks(cut, scene)
    short = copy("short")
    (short / "points.bin").write_bytes(b"\x01")
    with pytest.raises(BadInput, match="another scene"):
        read_masks(short, scene)
    wrong = copy("wrong")
    (wrong / "scores.json").write_text("[]")
    with pytest.raises(BadInput, match="Cannot read the masks"):
        read_masks(wrong, scene)


def test_masks_of_something_else_are_refused_before_the_field_is_trained(
    plain: tuple[MaskSet, Path], scene: Scene, clicks: Clicks, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    masks, _ = plain
    elsewhere = tuple(np.where(building(label), 0, 1).astype(np.uint8) for label in masks.labels)
    other = Propagation(replace(masks, labels=elsewhere), ["" for _ in elsewhere], [], 1.0)
    monkeypatch.setattr(build, "propagate", lambda *_: other)
    with pytest.raises(BadInput, match="clicks on the building"):
        run(scene, clicks, tmp_path)
    assert (tmp_path / "masks" / "contact_sheet.jpg").is_file()
