# SPDX-License-Identifier: GPL-3.0-or-later
"""The starting surface of a plain house, from edges and masks alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import igl
import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree
from support.plain_start import PlainStart

from benchmarks.synthetic.plain_house import PlainHouse, make_plain_house
from mgf_engine.errors import BadInput, Cancelled
from mgf_engine.masks.geometry.visual_hull import hull_cells, with_hull_points
from mgf_engine.messages import Reporter
from mgf_engine.model.mesh import Mesh
from mgf_engine.start import surface
from mgf_engine.start.cut_graph import StrongestPlane
from mgf_engine.start.evidence import Evidence
from mgf_engine.start.options import MinimumCutOptions, StartOptions
from mgf_engine.start.samples import poisson_disk_subset, sample_poisson_disk, sample_surface
from mgf_engine.start.store import read_start, write_start
from mgf_engine.start.surface import StartSurface, start_surface


@pytest.fixture
def found(plain_start: PlainStart) -> StartSurface:
    return plain_start.surface


def _off(points: np.ndarray, mesh: Mesh) -> np.ndarray:
    return np.sqrt(igl.point_mesh_squared_distance(points, mesh.vertices, mesh.faces.astype(np.int64))[0])


def test_plain_walls_and_roof_lie_where_they_are(plain_house: PlainHouse, found: StartSurface) -> None:
    samples = sample_surface(found.mesh, plain_house.scene, range(16), 4000, 0.02)
    assert len(samples.points) > 2000
    off = _off(samples.points, plain_house.truth)
    assert np.mean(off < 2 * found.pixel) > 0.85
    truth = trimesh.sample.sample_surface(
        trimesh.Trimesh(plain_house.truth.vertices, plain_house.truth.faces, process=False), 3000, seed=0
    )[0]
    assert np.mean(_off(truth, found.mesh) < 2 * found.pixel) > 0.85


def test_the_surface_is_closed_and_faces_outward(found: StartSurface) -> None:
    mesh = trimesh.Trimesh(found.mesh.vertices, found.mesh.faces, process=False)
    edges = np.sort(mesh.edges, axis=1)
    _, count = np.unique(edges, axis=0, return_counts=True)
    assert (count % 2 == 0).all()
    assert 0.7 < mesh.volume / (4 * 3 * 2 + 0.5 * 4 * 3 * 1.2) < 1.2
    assert found.confidence.max() <= 1 and found.confidence.min() >= 0 and np.mean(found.confidence > 0) > 0.5


def test_samples_have_the_colors_and_normals_of_the_surface(plain_house: PlainHouse, found: StartSurface) -> None:
    samples = sample_surface(found.mesh, plain_house.scene, range(16), 4000, 0.02)
    np.testing.assert_allclose(np.linalg.norm(samples.normals, axis=1), 1, atol=1e-9)
    high = samples.points[:, 2] > 2.5
    assert samples.colors[high, 0].mean() < 190 < samples.colors[samples.points[:, 2] < 1.5, 0].mean()


def test_samples_are_apart_and_leave_no_gap(found: StartSurface) -> None:
    points = sample_poisson_disk(found.mesh, 0.1, np.random.default_rng(0))[1]
    assert cKDTree(points).query(points, k=2)[0][:, 1].min() >= 0.08
    everywhere = sample_poisson_disk(found.mesh, 0.02, np.random.default_rng(1))[1]
    assert np.quantile(cKDTree(points).query(everywhere)[0], 0.99) < 0.1


def test_the_first_of_points_in_each_others_way_stays() -> None:
    line = np.array([[0.0, 0, 0], [0.6, 0, 0], [1.2, 0, 0], [9, 0, 0], [1.8, 0, 0]])
    np.testing.assert_array_equal(poisson_disk_subset(line, 1.0), [0, 2, 3])
    assert len(poisson_disk_subset(np.zeros((0, 3)), 1.0)) == 0


def test_it_comes_back_from_its_file(found: StartSurface, tmp_path: Path) -> None:
    write_start(found, tmp_path / "start.npz")
    back = read_start(tmp_path / "start.npz")
    assert back is not None
    np.testing.assert_array_equal(back.mesh.vertices, found.mesh.vertices)
    np.testing.assert_array_equal(back.mesh.faces, found.mesh.faces)
    np.testing.assert_array_equal(back.confidence, found.confidence)
    assert back.pixel == found.pixel
    np.testing.assert_array_equal(back.planes, found.planes)
    assert len(found.planes) > 3 and np.allclose(np.linalg.norm(found.planes[:, :3], axis=1), 1)
    with np.load(tmp_path / "start.npz") as data:
        earlier = {name: data[name] for name in data.files if name != "planes"}
    np.savez(tmp_path / "earlier.npz", **earlier)
    without = read_start(tmp_path / "earlier.npz")
    assert without is not None and without.planes.shape == (0, 4)
    (tmp_path / "start.npz").write_bytes(b"PK\x03\x04 nothing")
    assert read_start(tmp_path / "start.npz") is None
    assert read_start(tmp_path / "none.npz") is None


def test_the_same_twice(plain_house: PlainHouse, found: StartSurface) -> None:
    again = start_surface(plain_house.scene, plain_house.masks, range(16), Reporter(), 1)
    np.testing.assert_array_equal(again.mesh.faces, found.mesh.faces)
    np.testing.assert_array_equal(again.mesh.vertices, found.mesh.vertices)


def test_one_mask_that_cuts_off_half_of_the_house_does_no_harm(plain_house: PlainHouse, found: StartSurface) -> None:
    labels = [label.copy() for label in plain_house.masks.labels]
    labels[3][:, :120] = 0
    cut = start_surface(plain_house.scene, replace(plain_house.masks, labels=tuple(labels)), range(16), Reporter(), 2)
    whole = trimesh.Trimesh(found.mesh.vertices, found.mesh.faces, process=False).volume
    assert trimesh.Trimesh(cut.mesh.vertices, cut.mesh.faces, process=False).volume > 0.9 * whole


def test_the_hull_stands_in_for_sparse_points(plain_house: PlainHouse) -> None:
    cells, size = hull_cells(plain_house.scene, plain_house.masks, range(16))
    assert (cells.min(0) > np.array([-2, -1.5, 0]) - 3 * size).all()
    assert (cells.max(0) < np.array([2, 1.5, 3.2]) + 4 * size).all()
    found = with_hull_points(plain_house.scene, plain_house.masks, list(range(16)))
    scene, kept = found.scene, found.kept
    assert kept.all() and len(kept) == len(scene.points) > 100
    for i in (0, 5):
        rows = scene.observations(i)
        uv, _ = scene.views[i].project(scene.points[scene.track_point[rows]])
        np.testing.assert_allclose(uv, scene.track_uv[rows], atol=1e-3)


def test_masks_with_nothing_in_common_are_one_sentence(plain_house: PlainHouse) -> None:
    labels = []
    for k, label in enumerate(plain_house.masks.labels):
        labels.append(np.zeros_like(label))
        labels[-1][(k * 37) % 170 : (k * 37) % 170 + 6, (k * 53) % 230 : (k * 53) % 230 + 6] = 1
    with pytest.raises(BadInput, match="no common volume"):
        start_surface(plain_house.scene, replace(plain_house.masks, labels=tuple(labels)), range(16), Reporter(), 2)


def test_photos_without_edges_are_one_sentence(plain_house: PlainHouse, tmp_path: Path) -> None:
    bare = make_plain_house(tmp_path / "scene", 4)
    grey = [np.full_like(bare.scene.photo(i), 128) for i in range(4)]
    import cv2

    for view, picture in zip(bare.scene.views, grey, strict=True):
        cv2.imwrite(str(tmp_path / "scene" / view.file), picture)
    with pytest.raises(BadInput, match="too few edges"):
        start_surface(bare.scene, bare.masks, range(4), Reporter(), 2)


def test_one_photo_is_one_sentence_and_two_give_what_they_show(plain_house: PlainHouse) -> None:
    with pytest.raises(BadInput):
        start_surface(plain_house.scene, plain_house.masks, [0], Reporter(), 2)
    sent: list[dict] = []
    reporter = Reporter(sent.append, min_interval=0)
    two = start_surface(plain_house.scene, plain_house.masks, [0, 1], reporter, 2, share=1.0)
    said = [(m["figures"], m["fraction"]) for m in sent if m["type"] == "progress"]
    assert [(figures["start"], share) for figures, share in said] == [
        ("views", 0.0), ("dense", 0.2), ("lines", 0.4), ("planes", 0.6), ("cut", 0.8)
    ]  # fmt: skip
    assert len(two.mesh.faces) and np.isfinite(two.mesh.vertices).all()


def test_blocks_are_progress(plain_house: PlainHouse, plain_start: PlainStart, monkeypatch) -> None:
    def cut(views, evidence, options, check, began):
        for number in range(1, options.blocks + 1):
            began(f"{number} of {options.blocks}")
        return plain_start.surface.mesh, plain_start.surface.confidence

    monkeypatch.setattr(surface, "cut_in_blocks", cut)
    sent: list[dict] = []
    reporter, options = Reporter(sent.append, min_interval=0), replace(StartOptions(), cut=MinimumCutOptions(blocks=2))
    start_surface(plain_house.scene, plain_house.masks, [0, 1], reporter, 2, options)
    told = [m["figures"] for m in sent if m["type"] == "progress"]
    assert [figures["block"] for figures in told if "block" in figures] == ["1 of 2", "2 of 2"]


def test_a_stop_is_heard(plain_house: PlainHouse) -> None:
    reporter = Reporter()
    reporter.cancel()
    with pytest.raises(Cancelled):
        start_surface(plain_house.scene, plain_house.masks, range(16), reporter, 2)


def test_a_face_counts_by_the_strongest_of_the_planes_that_all_its_corners_lie_on() -> None:
    on = np.zeros((5, 70), bool)
    on[:4, 3] = on[[0, 1, 2, 4], 66] = True
    strength = np.linspace(0.1, 0.7, 70)
    evidence = Evidence(np.zeros((5, 3)), [], np.zeros(5), on, strength)
    faces = np.array([[0, 1, 2], [1, 2, 3], [2, 3, 4], [0, 1, 5]], np.int32)
    found = StrongestPlane(evidence, 6)(faces)  # the last point is one of the box
    np.testing.assert_array_equal(found, [strength[66], strength[3], 0, 0])
    none = Evidence(np.zeros((5, 3)), [], np.zeros(5), on[:, :0], strength[:0])
    np.testing.assert_array_equal(StrongestPlane(none, 6)(faces), 0)
