# SPDX-License-Identifier: GPL-3.0-or-later
"""``mgf buildings`` on two houses and the footprint of a third that is gone."""

from __future__ import annotations

import json
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.live_terminal import bar_ended, live_terminal

from benchmarks.synthetic.house import OFFSET
from benchmarks.synthetic.street import PLACES, Street, write_footprints
from mgf_engine.cli.main import main
from mgf_engine.jobs.job import Job
from mgf_engine.jobs.results import load_scene_of
from mgf_engine.options.config import make_config
from mgf_engine.scene.colmap import find_model, read_model
from mgf_engine.scene.crop import parse_crop_box
from mgf_engine.town.clicks import ClickOptions, find_enclosed
from mgf_engine.town.footprints import read_footprints
from mgf_engine.town.place import place_footprints
from mgf_engine.town.plan import make_plan


@pytest.fixture
def street(short_street: Street) -> Street:
    return short_street


@pytest.fixture(scope="module")
def out(short_street: Street, tmp_path_factory: pytest.TempPathFactory) -> Path:
    street, place = short_street, tmp_path_factory.mktemp("buildings") / "town"
    assert buildings(street, place) == 0
    return place


def buildings(street: Street, place: Path, *more: object) -> int:
    map_ = ["--footprints", str(street.folder / "footprints.geojson")] if "--footprints" not in more else []
    options = [*map_, "--footprints-crs", "scene", "--preset", "quick"]
    return main(["buildings", str(street.folder), "--out", str(place), *options, *map(str, more)])


def rows(place: Path) -> dict[str, dict]:
    return {row["id"]: row for row in json.loads((place / "buildings.json").read_text())["buildings"]}


def test_houses_are_found_and_what_is_gone_is_not(out: Path) -> None:
    found = rows(out)
    assert {name: row["state"] for name, row in found.items()} == {
        "left": "ready", "right": "ready", "gone": "nothing there",
    }  # fmt: skip
    metre = json.loads((out / "buildings.json").read_text())["metre"]
    for name in PLACES:
        assert found[name]["height"] * metre == pytest.approx(3.2, abs=0.25)
        assert len(found[name]["photos"]) >= 12 and found[name]["seen"] > 0.9
        assert found[name]["estimate"]["seconds"] > 1 and found[name]["estimate"]["bytes"] > 1e8
    assert not (out / "buildings" / "gone").exists()
    features = json.loads((out / "buildings.geojson").read_text())["features"]
    assert [f["properties"]["state"] for f in features] == ["ready", "ready", "nothing there"]
    assert not any("seconds" in f["properties"] for f in features)  # they change with what is learned of the machine
    picture = cv2.imread(str(out / "map.png"))
    assert picture is not None and picture.std() > 10


@pytest.mark.parametrize("name", PLACES)
def test_clicks_lie_where_they_say(name: str, street: Street, out: Path) -> None:
    clicks = json.loads((out / "buildings" / name / "prompts.json").read_text())
    other = next(n for n in PLACES if n != name)
    assert len(clicks) >= 5
    on_other = 0
    for photo, entry in clicks.items():
        mask, neighbour = street.masks[name][photo], street.masks[other][photo]
        spots = {kind: np.array(entry[kind], int).reshape(-1, 2) for kind in ("positive", "negative")}
        assert len(spots["positive"]) >= 3 and len(spots["negative"]) >= 3
        grown = cv2.dilate(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0  # clicks are whole pixels
        assert grown[spots["positive"][:, 1], spots["positive"][:, 0]].all(), photo
        assert not mask[spots["negative"][:, 1], spots["negative"][:, 0]].any(), photo
        on_other += int(neighbour[spots["negative"][:, 1], spots["negative"][:, 0]].sum())
    assert on_other >= 3  # the neighbour is background


def test_a_building_gets_a_scene_of_its_own(street: Street, out: Path) -> None:
    folder = out / "buildings" / "left" / "scene"
    model = read_model(find_model(folder) or folder)
    row = rows(out)["left"]
    assert sorted(image.name for image in model.images) == sorted(row["photos"])
    assert len(model.points.ids) > 500
    assert {p.name for p in (folder / "images").iterdir()} == set(row["photos"])
    assert (folder / "images" / row["photos"][0]).read_bytes() == (
        street.folder / "images" / row["photos"][0]
    ).read_bytes()
    box = parse_crop_box(row["options"]["crop_box"])
    assert box is not None and box.contains(street.meshes["left"].vertices).all()
    assert not box.contains(street.meshes["right"].vertices).any()


def test_the_same_again_writes_nothing_and_clicks_by_hand_win(street: Street, out: Path, tmp_path: Path) -> None:
    written = [p for p in sorted((out / "buildings").rglob("*")) if p.is_file()]
    before = {p: p.lstat().st_mtime_ns for p in written}
    assert buildings(street, out) == 0
    assert {p: p.lstat().st_mtime_ns for p in written} == before
    clicks = out / "buildings" / "left" / "prompts.json"
    automatic = clicks.read_text()
    by_hand = {"photo_00.png": {"positive": [[100, 90]], "negative": []}}
    clicks.write_text(json.dumps(by_hand))
    assert buildings(street, out) == 0
    assert json.loads(clicks.read_text()) == by_hand and rows(out)["left"]["state"] == "by hand"
    assert buildings(street, out) == 0  # and again
    assert json.loads(clicks.read_text()) == by_hand
    clicks.unlink()
    (tmp_path / "right.json").write_text(json.dumps(by_hand))
    assert buildings(street, out, "--clicks", tmp_path) == 0
    assert clicks.read_text() == automatic
    assert json.loads((out / "buildings/right/prompts.json").read_text()) == by_hand


def test_clicks_by_hand_settle_what_points_do_not_show(
    street: Street, out: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    clicked = sorted(path.name for path in (street.folder / "images").iterdir())[:4]
    clicks = {name: {"positive": [[100, 90]], "negative": []} for name in clicked}
    (tmp_path / "gone.json").write_text(json.dumps(clicks))
    assert buildings(street, out, "--clicks", tmp_path) == 0
    row = rows(out)["gone"]
    assert row["state"] == "by hand" and row["photos"] == clicked and row["estimate"]["seconds"] > 0
    assert "Jobs: 3" in capsys.readouterr().out
    (out / "buildings" / "gone" / "prompts.json").unlink()


def test_ten_thousand_footprints_elsewhere_cost_little(street: Street, out: Path, tmp_path: Path) -> None:
    places = {"left": PLACES["left"], **{f"far{k}": (500.0 + 8 * (k % 100), 8.0 * (k // 100)) for k in range(10_000)}}
    write_footprints(tmp_path / "large.geojson", places)
    assert buildings(street, out, "--footprints", tmp_path / "large.geojson") == 0
    data = json.loads((out / "buildings.json").read_text())
    assert data["outside"] == 10_000 and {row["id"] for row in data["buildings"]} == {"left", "unmapped_1"}


def test_footprints_elsewhere_alone_are_refused(street: Street, out: Path, tmp_path: Path, capsys: object) -> None:
    write_footprints(tmp_path / "far.geojson", {"far": tuple(OFFSET[:2] + 9000)})
    assert buildings(street, out, "--footprints", tmp_path / "far.geojson") == 2
    assert "None of the 1 footprints lies near the photos" in capsys.readouterr().err  # type: ignore[attr-defined]


def test_what_the_map_lacks_is_listed_and_not_guessed(street: Street, out: Path, tmp_path: Path) -> None:
    write_footprints(tmp_path / "old.geojson", {"left": PLACES["left"]})
    assert buildings(street, out, "--footprints", tmp_path / "old.geojson") == 0
    found = rows(out)
    assert {name: row["state"] for name, row in found.items()} == {"left": "ready", "unmapped_1": "not in the map"}
    assert found["unmapped_1"]["photos"] == [] and not (out / "buildings" / "unmapped_1").exists()
    outline = json.loads((out / "buildings.geojson").read_text())["features"][1]["geometry"]["coordinates"][0]
    assert np.abs(np.mean(outline[:-1], axis=0) - OFFSET[:2] - PLACES["right"]).max() < 0.5


def test_what_two_photos_show_is_not_photographed(street: Street, out: Path) -> None:
    footprints = read_footprints(street.folder / "footprints.geojson", "")
    with Job.start(out / "scene", resume=True) as job:
        scene = load_scene_of(job)
    placed = place_footprints(footprints, scene, make_config({}), "scene")
    few = make_plan(replace(scene, views=scene.views[:2]), placed, footprints, 12)
    states = {building.hull.id: (building.hull.state, building.hull.reason) for building in few.buildings}
    seen = {"left": 1, "right": 2}  # which the other house hides from one of the two
    for name, count in seen.items():
        assert states[name] == (
            "not photographed",
            f"Photos that show it: {count}, where 3 are needed; fly there again.",
        )
    assert states["gone"][0] == "nothing there"
    assert not any(building.clicks or building.runs for building in few.buildings)


def test_buildings_are_found_without_a_map(street: Street, out: Path, tmp_path: Path, capsys: object) -> None:
    place = tmp_path / "found"
    shutil.copytree(out / "scene", place / "scene")
    options = [str(street.folder), "--find", "--out", str(place), "--preset", "quick"]
    assert main(["buildings", *options]) == 0
    found = rows(place)
    assert len(found) == 2 and all(row["state"] == "ready" for row in found.values())
    # what is found can be given as a map again
    again = ["--footprints", str(place / "buildings.geojson"), "--footprints-crs", "scene", *options[2:]]
    assert main(["buildings", options[0], *again]) == 0
    assert set(rows(place)) == set(found)
    assert main(["buildings", *options, "--footprints", "map.gpkg"]) == 2
    assert "Give either --footprints FILE, or --find" in capsys.readouterr().err  # type: ignore[attr-defined]


def test_the_terminal_shows_one_thing_after_the_other(
    street: Street, out: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The clicks are made, so nobody is asked for some; a building that no photo shows has no pixel."""
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    live_terminal(monkeypatch)
    assert buildings(street, out) == 0
    said = capsys.readouterr()
    assert bar_ended(said.err) and "Click the building" not in said.err
    assert "3 of 3 buildings" in said.err and said.err.endswith("\r\x1b[K")  # the table begins on a line of its own
    (gone,) = [line for line in said.out.splitlines() if line.startswith("gone ")]
    (left,) = [line for line in said.out.splitlines() if line.startswith("left ")]
    assert "cm" not in gone and left.endswith(" cm")


@pytest.mark.parametrize("command", ["buildings", "town"])
def test_a_refused_scene_ends_the_bar(
    command: str, street: Street, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    live_terminal(monkeypatch)
    scene = Path(shutil.copytree(street.folder, tmp_path / "scene"))
    for photo in (scene / "images").iterdir():
        photo.write_bytes(photo.read_bytes()[:400])  # sizes can be read, pixels cannot
    given = ["--footprints", str(street.folder / "footprints.geojson"), "--footprints-crs", "scene"]
    assert main([command, str(scene), "--out", str(tmp_path / "town"), *given]) == 2
    assert bar_ended(capsys.readouterr().err)


@pytest.mark.parametrize("wanted", ["point", "crop box"])
def test_clicks_are_suggested_for_one_building(
    wanted: str, street: Street, out: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    place = tmp_path / "one"
    shutil.copytree(out / "scene", place / "scene")
    middle = OFFSET + np.array([*PLACES["right"], 1.0])
    box = " ".join(map(str, (*(middle - np.array([2.3, 1.8, 1.1])), *(middle + np.array([2.3, 1.8, 2.6])))))
    where = ["--point", *map(str, middle)] if wanted == "point" else ["--crop-box", box]
    live_terminal(monkeypatch)
    assert main(["suggest-clicks", str(street.folder), "--out", str(place), *where, "--progress", "bar"]) == 0
    said = capsys.readouterr()
    assert bar_ended(said.err) and "Click the building" not in said.err and "clicks on" in said.out
    clicks = json.loads((place / "prompts.json").read_text())
    assert len(clicks) >= 5
    wrong = total = 0
    for photo, entry in clicks.items():
        mask = cv2.dilate(street.masks["right"][photo].astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        for kind in ("positive", "negative"):
            spots = np.array(entry[kind], int).reshape(-1, 2)
            wrong += int((mask[spots[:, 1], spots[:, 0]] != (kind == "positive")).sum())
            total += len(spots)
    assert total > 30 and wrong <= 0.03 * total
    sheet = cv2.imread(str(place / "clicks.jpg"))
    assert sheet is not None and sheet.shape[1] == 3 * 480
    if wanted == "point":
        far = list(map(str, middle + 100))
        assert main(["suggest-clicks", str(street.folder), "--out", str(place), "--point", *far]) == 2


def test_points_beside_a_gable_are_enclosed_by_none() -> None:
    rng = np.random.default_rng(0)
    places = rng.uniform(0, 100, (600, 2))
    gable = places[places[:, 1] > 2 * np.abs(places[:, 0] - 50)]  # y down, the ridge at (50, 0)
    sky = np.array([[30.0, 20.0], [68.0, 25.0], [20.0, 45.0], [50.0, -15.0]])
    found = find_enclosed(np.concatenate([gable, sky]), ClickOptions())
    assert not found[-len(sky) :].any()
    inner = gable[:, 1] > 2 * np.abs(gable[:, 0] - 50) + 30
    inner &= gable[:, 1] < 85
    assert found[: len(gable)][inner].sum() >= 20  # more than the five that are needed
    assert not find_enclosed(gable[:2], ClickOptions()).any()
