# SPDX-License-Identifier: GPL-3.0-or-later
"""The starting surface cut block after block."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import igl
import numpy as np
import pytest
import trimesh
from support.plain_start import PlainStart

from benchmarks.synthetic.plain_house import PlainHouse
from mgf_engine.geometry.clean import face_areas
from mgf_engine.model.mesh import Mesh
from mgf_engine.start import block_cuts
from mgf_engine.start.block_cuts import Cut, clip_to_block, cut_in_blocks, thin_evidence
from mgf_engine.start.evidence import Evidence
from mgf_engine.start.options import MinimumCutOptions
from mgf_engine.system import memory


def in_blocks(start: PlainStart, count: int, **more: float) -> Cut:
    """The surface in so many cuts, each of which is told."""
    said: list[str] = []
    options = replace(MinimumCutOptions(), blocks=count, **more)
    made = cut_in_blocks(start.views, start.evidence, options, lambda: None, said.append)
    assert said == [f"{k} of {count}" for k in range(1, count + 1)]
    return made


def off(points: np.ndarray, mesh: Mesh) -> np.ndarray:
    return np.sqrt(igl.point_mesh_squared_distance(points, mesh.vertices, mesh.faces.astype(np.int64))[0])


def samples(mesh: Mesh) -> np.ndarray:
    return trimesh.sample.sample_surface(trimesh.Trimesh(mesh.vertices, mesh.faces, process=False), 5000, seed=0)[0]


@pytest.fixture(scope="module")
def quarters(plain_start: PlainStart, tmp_path_factory: pytest.TempPathFactory) -> tuple[Cut, Path]:
    """The surface in four cuts, and the folder in which each was kept as soon as it was made."""
    folder = tmp_path_factory.mktemp("quarters")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(memory, "_scratch", folder)
        return in_blocks(plain_start, 4), folder


def test_blocks_make_the_surface_of_the_whole(
    plain_house: PlainHouse, plain_start: PlainStart, quarters: tuple[Cut, Path]
) -> None:
    once, (parts, strength) = plain_start.surface, quarters[0]
    assert face_areas(parts).sum() == pytest.approx(face_areas(once.mesh).sum(), rel=0.03)
    assert len(strength) == len(parts.faces)
    for mesh, other in ((once.mesh, parts), (parts, once.mesh)):  # no gap, nothing more
        assert np.quantile(off(samples(mesh), other), 0.98) < 2 * once.pixel
    near = [np.mean(off(samples(mesh), plain_house.truth) < 2 * once.pixel) for mesh in (once.mesh, parts)]
    assert near[1] > near[0] - 0.02


def test_each_cut_sees_the_rest_of_the_building_coarsely(plain_start: PlainStart, monkeypatch) -> None:
    """Counts what each cut is given; the surface of such cuts is tested above."""
    counts: list[int] = []
    triangle = Mesh(np.eye(3), np.array([[0, 1, 2]], np.int32), np.zeros((3, 3), np.uint8))

    def cut(views, evidence, options, check):
        counts.append(len(evidence.points))
        return triangle, np.ones(1, np.float32)

    monkeypatch.setattr(block_cuts, "cut_surface", cut)
    in_blocks(plain_start, 4, margin=10.0, coarse=30.0)
    assert len(counts) == 4 and max(counts) < 0.6 * len(plain_start.evidence.points)


def test_points_beyond_the_margin_are_merged_and_keep_their_views() -> None:
    points = np.array([[0.5, 0, 0], [1.05, 0, 0], [3.0, 0, 0], [3.01, 0, 0], [9.0, 0, 0]])
    evidence = Evidence(points, [np.array([k]) for k in range(5)], np.arange(5.0), np.eye(5, dtype=bool), np.ones(5))
    low, high = np.full(3, -np.inf), np.array([1.0, np.inf, np.inf])
    found = thin_evidence(evidence, low, high, 0.01, replace(MinimumCutOptions(), margin=10.0, coarse=20.0))
    assert np.array_equal(found.points[:, 0], [0.5, 1.05, 3.0, 9.0])
    assert [s.tolist() for s in found.seen] == [[0], [1], [2, 3], [4]]
    assert found.weight.tolist() == [0, 1, 3, 4] and found.on_planes.shape == (4, 5)


def test_faces_are_cut_at_the_block_and_keep_their_strength() -> None:
    square = Mesh(np.array([[0.0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0]]), np.array([[0, 1, 2], [0, 2, 3]], np.int32),
                  np.zeros((4, 3), np.uint8))  # fmt: skip
    strength = np.array([0.25, 0.75], np.float32)
    low, high = np.array([-np.inf] * 3), np.array([0.5, np.inf, np.inf])
    mesh, kept = clip_to_block(square, strength, low, high)
    areas = face_areas(mesh)
    assert areas.sum() == pytest.approx(0.5) and mesh.vertices[:, 0].max() == 0.5
    assert areas[kept == 0.25].sum() == pytest.approx(0.5 * 0.5 * 0.25)
    assert set(kept.tolist()) == {0.25, 0.75}


def test_blocks_that_are_done_are_not_cut_again(
    plain_start: PlainStart, quarters: tuple[Cut, Path], monkeypatch, tmp_path
) -> None:
    first, strength = quarters[0]
    shutil.copytree(quarters[1], tmp_path, dirs_exist_ok=True)
    monkeypatch.setattr(memory, "_scratch", tmp_path)
    sorted((tmp_path / "blocks" / "start").iterdir())[1].unlink()
    cuts: list[int] = []
    whole_cut = block_cuts.cut_surface
    monkeypatch.setattr(block_cuts, "cut_surface", lambda *given: cuts.append(1) or whole_cut(*given))
    again, strength_again = in_blocks(plain_start, 4)
    assert len(cuts) == 1
    assert np.array_equal(again.vertices, first.vertices) and np.array_equal(strength_again, strength)
