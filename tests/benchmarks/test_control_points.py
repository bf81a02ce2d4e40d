# SPDX-License-Identifier: GPL-3.0-or-later
"""The benchmark of check points, on a small painted house whose cameras are exact."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from benchmarks.control_points import METHODS, MIN_VIEWS, main, targets_of
from benchmarks.synthetic.house import OFFSET, build_house
from mgf_engine.errors import BadInput
from mgf_engine.geometry.mesh_files import write_ply
from mgf_engine.model.mesh import Mesh


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> Path:
    """The house as a generated scene: true mesh and true cameras beside the model."""
    house = build_house(tmp_path_factory.mktemp("house"))
    write_ply(house.mesh, house.folder / "truth.ply")
    shutil.copytree(house.folder / "sparse" / "0", house.folder / "sparse_truth")
    return house.folder


def test_targets_are_corners_that_the_photos_see(scene: Path) -> None:
    targets = targets_of(scene)
    assert [t.name for t in targets] == ["P1", "P2", "P3", "P4", "P5", "C1", "C2", "C3"]
    assert all(MIN_VIEWS <= len(t.pixels) < 14 for t in targets)  # the house itself hides each from some photos
    assert len({tuple(t.place.round(3)) for t in targets}) == 8


def test_the_table_has_a_row_for_each_method_and_control_points_beat_gps(scene: Path, capsys) -> None:
    """Marks of half a pixel on photos of 240 pixels: 16 mm each; GPS of 2 m; points of 1 cm."""
    assert main([str(scene), "--seeds", "1", "--resolution", "240"]) == 0
    lines = [line.split("|")[1:-1] for line in capsys.readouterr().out.splitlines() if line.startswith("| ")]
    rows = {name.strip(): np.array([float(v) for v in values]) for name, *values in lines[1:]}
    assert list(rows) == list(METHODS)
    for values in rows.values():
        assert values[3] == pytest.approx(np.hypot.reduce(values[:3]), abs=0.2)
    assert rows["GPS"][3] > 100 and rows["aligned to control points"][3] < 40 and rows["cameras adjusted"][3] < 40


def test_a_scene_without_enough_corners_is_refused(scene: Path, tmp_path: Path, capsys) -> None:
    poor = Path(shutil.copytree(scene, tmp_path / "poor"))
    corners = np.add(OFFSET, [[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]])
    wall = Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32), np.zeros((4, 3), np.uint8))
    write_ply(wall, poor / "truth.ply")
    with pytest.raises(BadInput, match="are seen in 5 photos; take another scene"):
        targets_of(poor)
    assert main([str(poor)]) == 2
    assert capsys.readouterr().err.startswith("Error: Only 4 corners")
