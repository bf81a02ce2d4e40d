# SPDX-License-Identifier: GPL-3.0-or-later
"""The small town without Blender: photos, masks, model and map belong together."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import shapely

from benchmarks.town import FOOTPRINT_ERROR, ORIGIN, make_town
from benchmarks.town_houses import HOUSES, moved, parts_of
from benchmarks.town_scores import main as score_town
from benchmarks.town_scores import make_clicks
from mgf_engine.georef.gps import read_gps_position
from mgf_engine.scene.colmap import read_model


def test_a_painted_town_has_photos_masks_cameras_and_a_map(tmp_path: Path) -> None:
    make_town(tmp_path, 20, 120, None, 1, painted=True)
    model = read_model(tmp_path / "sparse/0")
    assert len(model.images) == 20 and len(model.points.ids) > 300
    assert all(read_gps_position(tmp_path / "images" / image.name) is not None for image in model.images)
    masks = {h.id: [cv2.imread(str(p), 0) for p in sorted((tmp_path / "buildings" / h.id / "masks").iterdir())]
             for h in HOUSES}  # fmt: skip
    assert all(max((m > 0).mean() for m in own) > 0.02 for own in masks.values())
    stacked = np.stack([np.stack(own) > 0 for own in masks.values()])
    assert stacked.sum(0).max() == 1  # no pixel shows two houses
    features = json.loads((tmp_path / "footprints.geojson").read_text())["features"]
    found = {f["properties"]["id"]: shapely.geometry.shape(f["geometry"]) for f in features}
    assert set(found) == {h.id for h in HOUSES if h.mapped} | {"torn_down"}
    for house in HOUSES:
        if house.mapped:
            true = shapely.Polygon(moved(np.array(house.outline, float), house.place) + ORIGIN[:2])
            assert abs(found[house.id].centroid.distance(true.centroid) - FOOTPRINT_ERROR) < 0.01


def test_no_house_stands_in_another_and_all_but_the_rows_stand_free() -> None:
    ground = {h.id: shapely.Polygon(moved(np.array(h.outline, float), h.place)) for h in HOUSES}
    assert len(ground) == len(HOUSES) == 12 and sum(not h.mapped for h in HOUSES) == 1
    near = {(a, b) for a, one in ground.items() for b, two in ground.items() if a < b and one.distance(two) < 3}
    assert near == {("row_east", "row_west"), ("terrace_middle", "terrace_west"), ("terrace_east", "terrace_middle")}
    assert all(one.intersection(two).area < 1e-6 for a, one in ground.items() for b, two in ground.items() if a < b)
    for house in HOUSES:
        walls = np.concatenate([p.vertices for p in parts_of(house) if p.building])
        low = walls[(walls[:, 2] > 0.5) & (walls[:, 2] < 2.5), :2]
        assert shapely.distance(ground[house.id], shapely.points(low)).max() < 2.5, house.id


def test_clicks_by_hand_lie_in_the_true_masks(tmp_path: Path) -> None:
    make_town(tmp_path, 10, 120, None, 1, painted=True, count=6)
    assert {p.name for p in (tmp_path / "buildings").iterdir()} == {h.id for h in HOUSES[:6]}
    scene = tmp_path / "town" / "buildings" / "villa" / "scene"
    scene.mkdir(parents=True)
    (scene / "sparse").symlink_to(tmp_path / "sparse")
    make_clicks(tmp_path, tmp_path / "town", tmp_path / "clicks")
    clicks = json.loads((tmp_path / "clicks" / "villa.json").read_text())
    assert len(clicks) >= 3
    for photo, entry in clicks.items():
        mask = cv2.imread(str(tmp_path / "buildings/villa/masks" / (Path(photo).stem + ".png")), 0) > 127
        assert all(mask[int(v), int(u)] for u, v in entry["positive"])
        assert not any(mask[int(v), int(u)] for u, v in entry["negative"])


@pytest.mark.parametrize("given", [[], ["score", "scene"], ["clicks", "scene", "town"], ["scores", "scene", "town"]])
def test_what_scores_need_is_said(given: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        score_town(given)
    assert end.value.code == 2 and "usage: python -m benchmarks.town_scores" in capsys.readouterr().err
