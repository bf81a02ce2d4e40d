# SPDX-License-Identifier: GPL-3.0-or-later
"""Whole jobs on a house without one sparse point on it."""

from __future__ import annotations

from pathlib import Path

import cv2
import igl
import numpy as np
import pytest
from support.jobs import run_here

from benchmarks.synthetic.plain_house import PlainHouse, make_plain_house, write_inputs
from mgf_engine.errors import BadInput
from mgf_engine.geometry.mesh_files import read_ply
from mgf_engine.masks.build import build_masks
from mgf_engine.messages import Reporter
from mgf_engine.options.config import make_config

OPTIONS = ["--iterations", "100", "--max-gaussians", "5000", "--densify-every", "50", "--level-steps", "4"]


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> PlainHouse:
    return make_plain_house(tmp_path_factory.mktemp("plain") / "scene")


@pytest.fixture(scope="module")
def inputs(plain: PlainHouse) -> tuple[Path, Path]:
    return write_inputs(plain)


def test_given_masks_alone_lead_to_the_house(
    plain: PlainHouse, inputs: tuple[Path, Path], tmp_path: Path, capsys
) -> None:
    scene, masks = inputs
    given = (scene, "--masks", masks, "--out", tmp_path / "job", *OPTIONS)
    code, messages = run_here(capsys, "reconstruct", *given)
    assert code == 0, messages[-1]
    assert not [m for m in messages if "masks are weak" in m.get("text", "")]  # all are true
    mesh = read_ply(tmp_path / "job" / "mesh.ply")
    truth = plain.truth
    off = np.sqrt(igl.point_mesh_squared_distance(mesh.vertices, truth.vertices, truth.faces.astype(np.int64))[0])
    back = np.sqrt(igl.point_mesh_squared_distance(truth.vertices, mesh.vertices, mesh.faces.astype(np.int64))[0])
    assert np.median(off) < 0.05 and np.percentile(off, 90) < 0.15
    assert back.max() < 0.2


def test_a_start_on_points_is_refused_without_points(
    plain: PlainHouse, inputs: tuple[Path, Path], tmp_path: Path
) -> None:
    reporter = Reporter()
    reporter.stage("masks")
    for kind in ("sparse", "dense"):
        with pytest.raises(BadInput, match="choose start=surface"):
            build_masks(plain.scene, None, inputs[1], tmp_path, make_config({"start": kind}), reporter)


def test_given_masks_without_a_place_in_common_are_refused(plain: PlainHouse, tmp_path: Path) -> None:
    given = tmp_path / "given"
    given.mkdir()
    for k, (view, labels) in enumerate(zip(plain.scene.views, plain.masks.labels, strict=True)):
        sky = np.zeros_like(labels)
        sky[:20, 40 * (k % 4) : 40 * (k % 4) + 40] = 255
        cv2.imwrite(str(given / view.name), sky)
    reporter = Reporter()
    reporter.stage("masks")
    with pytest.raises(BadInput, match="no common volume"):
        build_masks(plain.scene, None, given, tmp_path / "masks", make_config(), reporter)
