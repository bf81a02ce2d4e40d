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

from benchmarks.synthetic.plain_house import PlainHouse
from mgf_engine.geometry.clean import face_areas
from mgf_engine.messages import Reporter
from mgf_engine.model.mesh import Mesh
from mgf_engine.start import block_cuts
from mgf_engine.start.block_cuts import clip_to_block, thin_evidence
from mgf_engine.start.evidence import Evidence
from mgf_engine.start.options import CutOptions, StartOptions
from mgf_engine.start.surface import StartSurface, start_surface
from mgf_engine.system import memory


def surface(house: PlainHouse, count: int, reporter: Reporter | None = None) -> StartSurface:
    options = replace(StartOptions(), cut=replace(CutOptions(), blocks=count))
    return start_surface(house.scene, house.masks, range(16), reporter or Reporter(), 2, options)


def off(points: np.ndarray, mesh: Mesh) -> np.ndarray:
    return np.sqrt(igl.point_mesh_squared_distance(points, mesh.vertices, mesh.faces.astype(np.int64))[0])


def samples(mesh: Mesh) -> np.ndarray:
    return trimesh.sample.sample_surface(trimesh.Trimesh(mesh.vertices, mesh.faces, process=False), 5000, seed=0)[0]


@pytest.fixture(scope="module")
def whole(plain_house: PlainHouse) -> tuple[StartSurface, int]:
    """The surface in one cut, and the points that it was cut from."""
    counts: list[int] = []

    def cut(views, evidence, options, check):
        counts.append(len(evidence.points))
        return whole_cut(views, evidence, options, check)

    whole_cut = block_cuts.cut_surface
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(block_cuts, "cut_surface", cut)
        patch.setattr(block_cuts, "make_grid", None)  # one block makes none
        made = surface(plain_house, 1)
    (count,) = counts
    return made, count


def in_blocks(house: PlainHouse, count: int) -> StartSurface:
    """The surface in so many cuts, each of which is told."""
    said: list[str] = []
    reporter = Reporter(lambda m: said.append(m["figures"].get("block")) if m["type"] == "progress" else None,
                        min_interval=0.0)  # fmt: skip
    reporter.stage("field")
    made = surface(house, count, reporter)
    assert [block for block in said if block] == [f"{k} of {count}" for k in range(1, count + 1)]
    return made


@pytest.fixture(scope="module")
def halves(plain_house: PlainHouse, tmp_path_factory: pytest.TempPathFactory) -> tuple[StartSurface, Path]:
    """The surface in two cuts, and the folder in which each was kept as soon as it was made."""
    folder = tmp_path_factory.mktemp("halves")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(memory, "_scratch", folder)
        return in_blocks(plain_house, 2), folder


@pytest.mark.parametrize("count", [2, 4])
def test_blocks_make_the_surface_of_the_whole(
    plain_house: PlainHouse, whole: tuple[StartSurface, int], halves: tuple[StartSurface, Path], count: int
) -> None:
    once, parts = whole[0], halves[0] if count == 2 else in_blocks(plain_house, count)
    assert face_areas(parts.mesh).sum() == pytest.approx(face_areas(once.mesh).sum(), rel=0.03)
    assert len(parts.confidence) == len(parts.mesh.faces)
    for mesh, other in ((once.mesh, parts.mesh), (parts.mesh, once.mesh)):  # no gap, nothing more
        assert np.quantile(off(samples(mesh), other), 0.98) < 2 * once.pixel
    near = [np.mean(off(samples(mesh), plain_house.truth) < 2 * once.pixel) for mesh in (once.mesh, parts.mesh)]
    assert near[1] > near[0] - 0.02


class _Enough(Exception):
    """Raised in place of the last cut."""


def test_each_cut_sees_the_rest_of_the_building_coarsely(
    plain_house: PlainHouse, whole: tuple[StartSurface, int], monkeypatch
) -> None:
    """Counts what each cut is given; the surface of such cuts is tested above."""
    counts: list[int] = []
    triangle = Mesh(np.eye(3), np.array([[0, 1, 2]], np.int32), np.zeros((3, 3), np.uint8))

    def cut(views, evidence, options, check):
        counts.append(len(evidence.points))
        if len(counts) == 4:
            raise _Enough
        return triangle, np.ones(1, np.float32)

    monkeypatch.setattr(block_cuts, "cut_surface", cut)
    options = replace(StartOptions(), cut=replace(CutOptions(), blocks=4, margin=10.0, coarse=30.0))
    with pytest.raises(_Enough):
        start_surface(plain_house.scene, plain_house.masks, range(16), Reporter(), 2, options)
    assert max(counts) < 0.6 * whole[1]


def test_points_beyond_the_margin_are_merged_and_keep_their_views() -> None:
    points = np.array([[0.5, 0, 0], [1.05, 0, 0], [3.0, 0, 0], [3.01, 0, 0], [9.0, 0, 0]])
    evidence = Evidence(points, [np.array([k]) for k in range(5)], np.arange(5.0), np.eye(5, dtype=bool), np.ones(5))
    low, high = np.full(3, -np.inf), np.array([1.0, np.inf, np.inf])
    found = thin_evidence(evidence, low, high, 0.01, replace(CutOptions(), margin=10.0, coarse=20.0))
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
    plain_house: PlainHouse, halves: tuple[StartSurface, Path], monkeypatch, tmp_path
) -> None:
    first = halves[0]
    shutil.copytree(halves[1], tmp_path, dirs_exist_ok=True)
    monkeypatch.setattr(memory, "_scratch", tmp_path)
    sorted((tmp_path / "blocks" / "start").iterdir())[1].unlink()
    cuts: list[int] = []
    whole_cut = block_cuts.cut_surface
    monkeypatch.setattr(block_cuts, "cut_surface", lambda *given: cuts.append(1) or whole_cut(*given))
    again = surface(plain_house, 2)
    assert len(cuts) == 1
    assert np.array_equal(again.mesh.vertices, first.mesh.vertices) and np.array_equal(
        again.confidence, first.confidence
    )
