# SPDX-License-Identifier: GPL-3.0-or-later
"""The field that training starts from: on the starting surface, or on points where there is none."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import igl
import numpy as np
import pytest

from benchmarks.synthetic.plain_house import PlainHouse
from mgf_engine.errors import BadInput, explain
from mgf_engine.field.start import start_field
from mgf_engine.messages import Reporter
from mgf_engine.model.gaussians import rotation_matrices
from mgf_engine.native.library import NoKernels
from mgf_engine.options.config import make_config
from mgf_engine.start import surface
from mgf_engine.start.store import FILE, read_start


def test_gaussians_lie_on_the_plain_house_and_face_outward(plain_house: PlainHouse, tmp_path: Path) -> None:
    config = make_config({"max_gaussians": 4000})
    field = start_field(plain_house.scene, plain_house.masks, list(range(16)), config, tmp_path, Reporter())
    start = read_start(tmp_path / FILE)
    assert start is not None and 500 < len(field) <= 2200
    points, truth = field.positions.double().numpy(), plain_house.truth
    squared, face, _ = igl.point_mesh_squared_distance(points, truth.vertices, truth.faces.astype(np.int64))[:3]
    near = np.sqrt(squared) < 3 * start.pixel
    assert near.mean() > 0.8
    a, b, c = (truth.vertices[truth.faces[face, k]] for k in range(3))
    outward = np.cross(b - a, c - a)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    axis = rotation_matrices(field.rotations)[:, :, 2].double().numpy()
    assert np.mean((axis * outward).sum(1)[near] > 0.9) > 0.85


def test_without_a_surface_it_says_so_and_starts_from_points(plain_house: PlainHouse, tmp_path: Path) -> None:
    (tmp_path / FILE).write_bytes(b"of another run")
    reporter = Reporter()
    empty = tuple(np.zeros_like(label) for label in plain_house.masks.labels)
    with pytest.raises(BadInput, match="0 points lie on the building"):
        masks = replace(plain_house.masks, labels=empty)
        start_field(plain_house.scene, masks, list(range(16)), make_config(), tmp_path, reporter)
    assert any("No starting surface" in text for text in reporter.warnings)
    assert not (tmp_path / FILE).exists()


def test_kernels_that_are_missing_are_no_reason_to_start_from_points(
    plain_house: PlainHouse, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def lacking(*_: object) -> None:
        raise NoKernels("The kernel library is older than this engine; build it.")

    monkeypatch.setattr(surface, "find_lines", lacking)
    with pytest.raises(NoKernels) as caught:
        start_field(plain_house.scene, plain_house.masks, list(range(4)), make_config(), tmp_path, Reporter())
    assert explain(caught.value) == (2, "The kernel library is older than this engine; build it.")
