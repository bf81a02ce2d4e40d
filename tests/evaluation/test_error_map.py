# SPDX-License-Identifier: GPL-3.0-or-later
"""The picture of where a mesh is wrong shows a dent where the dent is, and only there."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

from mgf_engine.cli.main import main
from mgf_engine.evaluation.error_map import colors, subdivided
from mgf_engine.evaluation.surfaces import Surface


def test_colors_go_from_right_to_wrong() -> None:
    near, limit, far = colors(np.array([0.0, 1.0, 9.0]), 1.0).astype(int)
    assert near[2] > near[0] and limit[0] > 200 and limit[1] > 200 and far[0] > 100 and far[1:].max() < 60


def test_subdividing_keeps_the_surface() -> None:
    box = trimesh.creation.box((8.0, 4.0, 2.0))
    fine = subdivided(Surface(box.vertices, box.faces), 0.5)
    corners = fine.vertices[fine.faces]
    assert np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max() <= 0.5
    assert fine.areas.sum() == pytest.approx(box.area)


def test_the_picture_shows_the_dent(tmp_path: Path) -> None:
    truth = trimesh.creation.box((4.0, 4.0, 2.0)).subdivide().subdivide().subdivide()
    dented = truth.copy()
    dent = (np.abs(truth.vertices[:, 0]) < 1) & (truth.vertices[:, 2] > 0.99) & (truth.vertices[:, 1] < -0.5)
    dented.vertices[dent, 2] -= 0.4
    truth.export(tmp_path / "truth.ply")
    dented.export(tmp_path / "dented.ply")
    parts = {}
    for name in ("truth", "dented"):
        picture = tmp_path / f"{name}.png"
        command = ["evaluate", str(tmp_path / f"{name}.ply"), "--truth", str(tmp_path / "truth.ply")]
        assert main([*command, "--samples", "2000", "--picture", str(picture), "--json", str(tmp_path / "s.json")]) == 0
        blue, green, red = cv2.imread(str(picture)).astype(int).transpose(2, 0, 1)[:, :1200]
        parts[name] = np.mean(((red > 90) & (green < 0.6 * red) & (blue < 0.6 * red))[(red + green + blue) < 750])
    assert parts["truth"] == 0 and 0.02 < parts["dented"] < 0.3
    assert json.loads((tmp_path / "s.json").read_text())["accuracy"]


def test_a_picture_that_cannot_be_written_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    trimesh.creation.box().export(tmp_path / "a.ply")
    mesh = str(tmp_path / "a.ply")
    assert main(["evaluate", mesh, "--truth", mesh, "--samples", "100", "--picture", str(tmp_path / "a.what")]) == 2
    assert "Cannot write the picture" in capsys.readouterr().err
