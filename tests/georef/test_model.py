# SPDX-License-Identifier: GPL-3.0-or-later
"""The georeference of a job on disk, and its frames."""

import json

import numpy as np
import pytest

from mgf_engine.errors import BadInput
from mgf_engine.georef.model import FILE, METRE, Georeference, read_georeference, write_georeference

TURN = np.array([[0.0, 0, -1], [1, 0, 0], [0, -1, 0]])  # the scene's y is down, its x is north


def _placed() -> Georeference:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = 2.5 * TURN, (3.0, -4.0, 12.0)
    return Georeference(
        matrix, (691_234.567, 5_334_876.25, 519.125), "EPSG:25832", METRE, True, True, "control", "ellipsoidal",
        (48.137, 11.575, 519.125), {"check_x": 0.011},
    )  # fmt: skip


def test_a_job_without_a_georeference_keeps_its_frame(tmp_path):
    found = read_georeference(tmp_path)
    points = np.random.default_rng(0).normal(size=(5, 3))
    assert np.array_equal(found.world(points), points)
    assert found.unit == "scene units" and found.up is None and found.north is None and found.crs is None


def test_what_is_written_is_read_back_to_the_last_bit(tmp_path):
    placed = _placed()
    write_georeference(placed, tmp_path)
    again = read_georeference(tmp_path)
    assert np.array_equal(again.to_local, placed.to_local)
    assert {**again.__dict__, "to_local": 0} == {**placed.__dict__, "to_local": 0}


def test_frames_go_there_and_back_at_map_coordinates():
    placed, points = _placed(), np.random.default_rng(1).normal(size=(100, 3)) * 10
    assert np.abs(placed.from_world(placed.world(points)) - points).max() < 1e-8
    assert np.abs(placed.scene(placed.local(points)) - points).max() < 1e-12
    assert placed.scale == pytest.approx(2.5)
    assert np.allclose(placed.up, (0, -1, 0)) and np.allclose(placed.north, (1, 0, 0))
    one_up = placed.world(points + placed.up) - placed.world(points)
    assert np.allclose(one_up, (0, 0, 2.5), atol=1e-8)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("format", 99), ("to_local", [[1, 0], [0, 1]]), ("to_local", np.diag([1.0, 1, 2, 1]).tolist()),
        ("to_local", np.diag([-1.0, 1, 1, 1]).tolist()), ("unit", "feet"), ("offset", [0, 1]),
        ("offset", [0, 1, 1e999]), ("crs", 25832), ("accuracy", None),
    ],
)  # fmt: skip
def test_a_damaged_file_is_refused(tmp_path, name, value):
    write_georeference(_placed(), tmp_path)
    data = json.loads((tmp_path / FILE).read_text())
    (tmp_path / FILE).write_text(json.dumps({**data, name: value}))
    with pytest.raises(BadInput, match="cannot be used"):
        read_georeference(tmp_path)
