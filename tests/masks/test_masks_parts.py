# SPDX-License-Identifier: GPL-3.0-or-later
import numpy as np
import pytest
from support.small_scene import make_scene, view

from mgf_engine.masks.elements import LAST_ELEMENT, add_elements
from mgf_engine.masks.part_options import PartOptions
from mgf_engine.masks.parts import match_elements
from mgf_engine.model.masks import BUILDING, FIRST_ELEMENT, IGNORE, building

WINDOWS = [(30, 40), (30, 90), (30, 140), (80, 40), (80, 140)]
DOOR = (75, 88)


@pytest.fixture
def facade() -> tuple[np.ndarray, np.ndarray]:
    """Photo and level-one labels: a wall with five windows and a door, a lawn, and a post in front."""
    rng = np.random.default_rng(0)
    photo = np.full((140, 200, 3), (70, 120, 60), np.uint8)
    photo[10:120, 20:180] = (190, 170, 150)
    for y, x in WINDOWS:
        photo[y : y + 20, x : x + 16] = (40, 45, 60)
    photo[DOOR[0] : 120, DOOR[1] : DOOR[1] + 20] = (110, 60, 30)
    photo[:, 64:67] = (20, 20, 20)
    labels = np.zeros((140, 200), np.uint8)
    labels[10:120, 20:180] = BUILDING
    labels[10:120, 64:67] = IGNORE
    noise = rng.normal(0, 3, photo.shape)
    return np.clip(photo + noise, 0, 255).astype(np.uint8), labels


def test_windows_and_door_become_elements(facade: tuple[np.ndarray, np.ndarray]):
    photo, labels = facade
    result, names = add_elements(labels, photo, {}, None)
    assert names == {}
    assert (building(result) == building(labels)).all() and ((result == IGNORE) == (labels == IGNORE)).all()
    ids = set()
    for y, x in [*WINDOWS, DOOR]:
        patch = result[y + 4 : y + 16, x + 4 : x + 12]
        values, counts = np.unique(patch, return_counts=True)
        assert counts.max() > 0.9 * patch.size and FIRST_ELEMENT <= values[counts.argmax()] <= LAST_ELEMENT
        ids.add(int(values[counts.argmax()]))
    assert len(ids) == len(WINDOWS) + 1


def test_ids_are_consecutive(facade: tuple[np.ndarray, np.ndarray]):
    photo, labels = facade
    result, _ = add_elements(labels, photo, {"door": np.array([[95.0, 100.0]])}, None)
    ids = [v for v in np.unique(result) if FIRST_ELEMENT <= v <= LAST_ELEMENT]
    assert ids == list(range(FIRST_ELEMENT, FIRST_ELEMENT + len(ids)))


def test_clicks_name_an_element(facade: tuple[np.ndarray, np.ndarray]):
    photo, labels = facade
    clicks = {"door": np.array([[97.0, 100.0]]), "nothing": np.array([[5.0, 5.0]]), "none": np.zeros((0, 2))}
    result, names = add_elements(labels, photo, clicks, None)
    assert list(names.values()) == ["door"]
    number = next(iter(names))
    door = np.zeros(labels.shape, bool)
    door[DOOR[0] : 120, DOOR[1] : DOOR[1] + 20] = True
    found = result == number
    assert (found & door).sum() / (found | door).sum() > 0.8


def test_empty_masks_stay_empty():
    labels = np.zeros((20, 30), np.uint8)
    result, names = add_elements(labels, np.zeros((20, 30, 3), np.uint8), {"door": np.array([[1.0, 1.0]])}, None)
    assert not result.any() and names == {}


def test_more_fields_than_ids():
    rng = np.random.default_rng(1)
    cells = rng.integers(0, 256, (20, 24, 3), dtype=np.uint8)
    photo = cells.repeat(12, 0).repeat(12, 1)
    labels = np.full(photo.shape[:2], BUILDING, np.uint8)
    result, names = add_elements(labels, photo, {"a": np.array([[6.0, 6.0]])}, None)
    assert building(result).all() and list(names.values()) == ["a"]
    assert result.max() <= LAST_ELEMENT


def test_parts_are_tied_by_points():
    views = [view("a", 0), view("b", 0), view("c", 0)]
    # Left half is element 2 in a and 5 in b; right half 3 in a and 4 in b; c knows nothing of elements.
    maps = [np.ones((10, 20), np.uint8) for _ in views]
    maps[0][:, :10], maps[0][:, 10:] = 2, 3
    maps[1][:, :10], maps[1][:, 10:] = 5, 4
    tracks = [[(0, x, 5.0), (1, x, 5.0), (2, x, 5.0)] for x in (1.0, 3.0, 5.0, 7.0, 12.0, 14.0, 16.0, 18.0)]
    scene = make_scene(views, np.zeros((8, 3)), tracks)
    parts = match_elements(scene, maps, [{}, {5: "tower"}, {}])
    found = {p.name: (sorted(p.elements), p.points) for p in parts}
    assert found["tower"] == ([(0, 2), (1, 5)], [0, 1, 2, 3])
    assert found["element-1" if "element-1" in found else "element-2"] == ([(0, 3), (1, 4)], [4, 5, 6, 7])


@pytest.mark.parametrize(("shared", "tied"), [(4, True), (3, False), (0, False)])
def test_elements_are_tied_that_share_most_points_the_other_photo_sees(shared: int, tied: bool):
    """Eight points lie on element 2 of one photo, and the other photo sees them all, some of them on its element 2."""
    maps = [np.full((10, 20), 2, np.uint8), np.ones((10, 20), np.uint8)]
    maps[1][:, : 2 * shared] = 2
    tracks = [[(0, x, 5.0), (1, x, 5.0)] for x in np.arange(8) * 2.0 + 1.0]
    scene = make_scene([view("a", 0), view("b", 0)], np.zeros((8, 3)), tracks)
    parts = match_elements(scene, maps, [{2: "door"}, {}])
    assert [sorted(p.elements) for p in parts] == ([[(0, 2), (1, 2)]] if tied else [[(0, 2)]])


def test_one_name_is_one_part_even_without_points():
    scene = make_scene([view("a", 0), view("b", 0)], np.zeros((0, 3)), [])
    maps = [np.full((10, 20), 2, np.uint8)] * 2
    parts = match_elements(scene, maps, [{2: "door"}, {2: "door"}])
    assert [(p.name, sorted(p.elements)) for p in parts] == [("door", [(0, 2), (1, 2)])]


@pytest.mark.parametrize("margin", [1, 3])
def test_a_narrow_margin_is_one(facade: tuple[np.ndarray, np.ndarray], margin: int):
    photo, labels = facade
    wide, _ = add_elements(labels, photo, {}, None)
    narrow, _ = add_elements(labels, photo, {}, None, PartOptions(margin=margin))
    y, x = WINDOWS[0]
    assert narrow[y + 8, x + 8] >= FIRST_ELEMENT and ((narrow == BUILDING) == (wide == BUILDING)).mean() > 0.95


def test_what_is_far_from_the_building_changes_no_element(facade: tuple[np.ndarray, np.ndarray]):
    photo, labels = facade
    large = np.zeros((300, 500, 3), np.uint8)
    large[80:220, 150:350] = photo
    around = np.zeros((300, 500), np.uint8)
    around[80:220, 150:350] = labels
    other = large.copy()
    far = np.ones((300, 500), bool)
    far[60:240, 130:370] = False
    other[far] = np.random.default_rng(1).integers(0, 255, (int(far.sum()), 3))
    first, second = (add_elements(around, picture, {}, None)[0] for picture in (large, other))
    assert (first == second).all() and first.max() >= FIRST_ELEMENT
