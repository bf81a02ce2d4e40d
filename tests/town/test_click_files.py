# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of clicks: automatic ones are replaced, those that somebody made or changed win, and others are refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import shapely

from mgf_engine.errors import BadInput
from mgf_engine.files.images import write_png
from mgf_engine.town.click_files import (
    count_clicks,
    digest,
    made_automatically,
    read_automatic,
    with_hand_clicks,
    write_clicks,
)
from mgf_engine.town.hulls import BY_HAND, DOUBTFUL, READY, Hull
from mgf_engine.town.plan import Building
from mgf_engine.town.suggest import check_earlier
from mgf_engine.town.view_selection import ViewSelection

AUTOMATIC = {"a.png": {"positive": [[3.0, 4.0]], "negative": []}}
BETTER = {"a.png": {"positive": [[5.0, 4.0]], "negative": [[1.0, 1.0]]}}


@pytest.fixture
def photos(tmp_path: Path) -> dict[str, Path]:
    (tmp_path / "photos").mkdir()
    for name in ("a.png", "b.png"):
        write_png(tmp_path / "photos" / name, np.zeros((10, 20, 3), np.uint8))
    return {name: tmp_path / "photos" / name for name in ("a.png", "b.png")}


def building(clicks: dict, state: str = READY) -> Building:
    hull = Hull("house", shapely.box(0, 0, 5, 5), 0.0, 5.0, 20, state, "" if state == READY else "Why.")
    return Building(hull, ViewSelection([0, 1], 0.1, 0.02, 0.9, 2), clicks)


def test_automatic_clicks_are_replaced_and_changed_ones_stay(tmp_path: Path, photos: dict[str, Path]) -> None:
    folder = tmp_path / "house"
    write_clicks(building(AUTOMATIC), folder, {})
    again = with_hand_clicks(building(BETTER), folder, None, {}, photos)
    assert not again.by_hand and again.clicks == BETTER
    write_clicks(again, folder, {})
    (folder / "prompts.json").write_text(json.dumps({"b.png": {"positive": [[7, 7]]}}))
    found = with_hand_clicks(building(AUTOMATIC, DOUBTFUL), folder, None, {}, photos)
    assert found.by_hand and found.hull.state == BY_HAND and found.hull.reason == ""
    assert found.clicks == {"b.png": {"positive": [[7, 7]]}} and found.runs
    write_clicks(found, folder, {})
    assert digest(found.clicks) not in made_automatically(folder)


def test_clicks_of_a_plan_before_are_known_as_automatic(tmp_path: Path, photos: dict[str, Path]) -> None:
    folder = tmp_path / "house"
    folder.mkdir()
    (folder / "prompts.json").write_text(json.dumps(AUTOMATIC))
    (tmp_path / "buildings.json").write_text(
        json.dumps({"buildings": [{"id": "house", "automatic": digest(AUTOMATIC)}]})
    )
    earlier = read_automatic(tmp_path / "buildings.json")
    assert not with_hand_clicks(building(BETTER), folder, None, earlier, photos).by_hand
    assert with_hand_clicks(building(BETTER), folder, None, {}, photos).by_hand
    assert read_automatic(tmp_path / "none.json") == {}


def test_a_given_file_wins_over_that_of_the_town(tmp_path: Path, photos: dict[str, Path]) -> None:
    (tmp_path / "house").mkdir()
    (tmp_path / "house" / "prompts.json").write_text(json.dumps(BETTER))
    (tmp_path / "house.json").write_text(json.dumps(AUTOMATIC))
    assert with_hand_clicks(building({}), tmp_path / "house", tmp_path, {}, photos).clicks == AUTOMATIC
    (tmp_path / "house.json").write_text("{}")  # nobody clicked
    assert not with_hand_clicks(building({}), tmp_path / "house", tmp_path, {}, photos).by_hand


@pytest.mark.parametrize(
    ("clicks", "said"),
    [
        ('{"a.png": [[1, 2]]}', "should be an object"),
        ('{"a.png": {"positive": 5}}', "should be a list"),
        ('{"a.png": {"positive": [[1]]}}', "not a pair of numbers"),
        ('{"a.png": {"positive": [[21, 5]]}}', "outside the photo"),
        ('{"a.png": {"negative": [[1, 5]]}}', "no click on the building"),
        ('{"c.png": {"positive": [[1, 5]]}}', "names the photo 'c.png'"),
        ("[]", "cannot be read"),
        ("{", "cannot be read"),
    ],
)
def test_what_is_no_clicks_is_refused_with_its_file(
    clicks: str, said: str, tmp_path: Path, photos: dict[str, Path]
) -> None:
    (tmp_path / "house.json").write_text(clicks)
    with pytest.raises(BadInput, match=said) as error:
        with_hand_clicks(building(AUTOMATIC), tmp_path / "house", tmp_path, {}, photos)
    assert str(tmp_path / "house.json") in str(error.value)


@pytest.mark.parametrize("entry", [{"positive": [[21, 5]]}, {"positive": 5}, [[1, 2]], None])
def test_faults_of_a_building_s_own_clicks_are_left_to_its_job(
    entry: object, tmp_path: Path, photos: dict[str, Path]
) -> None:
    (tmp_path / "house").mkdir()
    (tmp_path / "house" / "prompts.json").write_text(json.dumps({"a.png": entry}))
    found = with_hand_clicks(building(AUTOMATIC), tmp_path / "house", None, {}, photos)
    assert found.by_hand and found.clicks == {"a.png": entry}
    assert count_clicks(found.clicks) == {"a.png": [int(entry == {"positive": [[21, 5]]}), 0]}


def test_clicks_are_counted() -> None:
    assert count_clicks({**BETTER, "b.png": {"positive": [[1, 1], [2, 2]]}}) == {"a.png": [1, 1], "b.png": [2, 0]}


def test_suggestions_take_the_place_of_suggestions_alone(tmp_path: Path) -> None:
    check_earlier(tmp_path / "new")
    write_clicks(building(AUTOMATIC), tmp_path, {})
    check_earlier(tmp_path)
    by_hand = tmp_path / "hand"
    by_hand.mkdir()
    (by_hand / "prompts.json").write_text(json.dumps(BETTER))
    with pytest.raises(BadInput, match="did not make"):
        check_earlier(by_hand)
    (by_hand / "clicks.jpg").write_bytes(b"")  # of a version that kept no record
    check_earlier(by_hand)
    (tmp_path / "prompts.json").write_text(json.dumps(BETTER))
    with pytest.raises(BadInput, match="did not make"):
        check_earlier(tmp_path)
    with pytest.raises(BadInput, match="is a file"):
        check_earlier(tmp_path / "prompts.json")
