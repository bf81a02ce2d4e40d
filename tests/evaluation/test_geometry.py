# SPDX-License-Identifier: GPL-3.0-or-later
"""Scores on shapes whose answers are known."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from mgf_engine.errors import BadInput
from mgf_engine.evaluation.geometry import ComparisonOptions, compare_surfaces, mask_iou, score_surface
from mgf_engine.evaluation.materials import Materials, read_materials
from mgf_engine.evaluation.surfaces import MaskedView, Surface, read_surface
from mgf_engine.model.scene import View


def plane(height: float, size: float = 4.0, cells: int = 6, start: float = 0.0) -> Surface:
    """A flat square grid at a height, from ``start`` to ``size`` in x and 0 to ``size`` in y."""
    x = np.linspace(start, size, cells + 1)
    y = np.linspace(0, size, cells + 1)
    vertices = np.stack([*np.meshgrid(x, y), np.full((cells + 1, cells + 1), height)], axis=-1).reshape(-1, 3)
    corner = np.arange(cells * (cells + 1)).reshape(cells, cells + 1)[:, :-1].reshape(-1)
    a, b, c, d = corner, corner + 1, corner + cells + 2, corner + cells + 1
    return Surface(vertices, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]))


def sphere(radius: float) -> Surface:
    ball = trimesh.creation.icosphere(subdivisions=5, radius=radius)
    return Surface(ball.vertices, ball.faces)


def camera_from_above(mask: np.ndarray | None = None) -> MaskedView:
    """Straight down from (2, 2, 10), wide enough for the planes above."""
    rotation = np.diag([1.0, -1.0, -1.0])
    intrinsics = (100.0, 100.0, 50.0, 50.0)
    return MaskedView(View("", "", 100, 100, *intrinsics, rotation, -rotation @ [2.0, 2.0, 10.0], 100, 100), mask)


def test_truth_against_itself_is_perfect_at_every_threshold() -> None:
    ball = sphere(3.0)
    scores = score_surface(ball, ball, (1e-06, 0.01, 1.0), ComparisonOptions(20000))
    assert scores.accuracy == scores.completeness == scores.f1 == (100.0, 100.0, 100.0)
    assert scores.mean_error < 1e-9 and scores.mean_gap < 1e-9


def test_a_shifted_plane_is_right_from_the_size_of_the_shift_on() -> None:
    scores = score_surface(plane(0.05), plane(0.0), (0.049, 0.051), ComparisonOptions(5000))
    assert scores.f1 == (0.0, 100.0)
    assert scores.mean_error == pytest.approx(0.05) and scores.median_gap == pytest.approx(0.05)


def test_concentric_spheres_are_their_difference_in_radius_apart() -> None:
    scores = score_surface(sphere(1.02), sphere(1.0), (0.019, 0.022), ComparisonOptions(20000))
    assert scores.mean_error == pytest.approx(0.02, rel=0.02)
    assert scores.f1[0] < 5 and scores.f1[1] == 100.0


def test_half_a_plane_is_accurate_but_half_complete() -> None:
    scores = score_surface(plane(0.0, start=2.0), plane(0.0), (1e-06,), ComparisonOptions(20000))
    assert scores.accuracy == (100.0,)
    assert scores.completeness[0] == pytest.approx(50.0, abs=0.5)
    assert scores.f1[0] == pytest.approx(2 * 100 * 50 / 150, abs=0.5)


def test_sampling_is_uniform_by_area_whatever_the_triangulation() -> None:
    fine, coarse = plane(0.0, size=1.0, cells=40), plane(0.0, size=3.0, cells=1)
    both = Surface(
        np.concatenate([fine.vertices, coarse.vertices + np.array([10, 0, 0])]),
        np.concatenate([fine.faces, coarse.faces + len(fine.vertices)]),
    )
    points, face = both.sample(40_000, np.random.default_rng(1))
    assert (points[:, 0] < 5).mean() == pytest.approx(1 / 10, abs=0.002)
    assert np.abs(points[:, 0][points[:, 0] < 5].mean() - 0.5) < 0.02
    assert np.abs(both.distances(points)).max() < 1e-9
    assert face.max() < len(both.faces)


def test_true_points_no_camera_saw_are_left_out() -> None:
    low, high = plane(0.0), plane(1.0, start=2.0)
    truth = Surface(
        np.concatenate([low.vertices, high.vertices]), np.concatenate([low.faces, high.faces + len(low.vertices)])
    )
    everything = score_surface(high, truth, (0.01,), ComparisonOptions(30000))
    assert everything.completeness[0] == pytest.approx(100 / 3, abs=1)
    seen = score_surface(high, truth, (0.01,), ComparisonOptions(30000, cameras=[camera_from_above()]))
    # Under the upper plane (2 <= x <= 4), the camera at x = 2 sees nothing of the lower one.
    assert seen.completeness[0] == pytest.approx(50.0, abs=1)
    assert seen.truth_seen == pytest.approx(200 / 3, abs=1)


def test_a_mask_hides_what_stands_behind_an_occluder() -> None:
    mask = np.ones((100, 100), dtype=bool)
    mask[:, :50] = False
    scores = score_surface(plane(0.0), plane(0.0), (0.01,), ComparisonOptions(10000, cameras=[camera_from_above(mask)]))
    assert scores.truth_seen == pytest.approx(50.0, abs=1)


def test_what_lies_outside_the_crop_does_not_count() -> None:
    big = Surface(plane(0.0, size=4.0).vertices * 2, plane(0.0).faces)
    crop = np.array([[0.0, 0, -1], [4, 4, 1]])
    assert score_surface(big, plane(0.0), (0.01,), ComparisonOptions(10000)).accuracy[0] == pytest.approx(25, abs=1)
    cropped = score_surface(big, plane(0.0), (0.01,), ComparisonOptions(10000, crop=crop))
    assert cropped.f1 == (100.0,)
    assert cropped.outside_crop == pytest.approx(75, abs=1)


def test_a_part_of_the_truth_can_be_left_out_on_both_sides() -> None:
    wall, roof = plane(0.0), plane(5.0)
    both = Surface(np.r_[wall.vertices, roof.vertices], np.r_[wall.faces, roof.faces + len(wall.vertices)])
    poor = Surface(np.r_[wall.vertices, plane(5.3).vertices], both.faces)  # the roof is off, the wall is right
    assert score_surface(poor, both, (0.01,), ComparisonOptions(10000)).f1[0] == pytest.approx(50, abs=1)
    rest = score_surface(poor, both, (0.01,), ComparisonOptions(10000), leave_out=roof)
    assert rest.f1 == (100.0,) and rest.truth_seen == 100.0
    assert score_surface(poor, both, (0.01,), ComparisonOptions(10000), leave_out=wall).f1 == (0.0,)
    with pytest.raises(BadInput, match="to be scored"):
        score_surface(poor, both, (0.01,), ComparisonOptions(100), leave_out=both)


@pytest.mark.parametrize("kind", ["rigid", "similarity"])
def test_alignment_undoes_a_motion(kind: str) -> None:
    box = trimesh.creation.box((4.0, 3.0, 2.0)).subdivide().subdivide()
    truth = Surface(box.vertices, box.faces)
    turn = trimesh.transformations.rotation_matrix(0.06, [0.3, -0.2, 1.0])[:3, :3]
    scale = 1.04 if kind == "similarity" else 1.0
    moved = Surface(scale * truth.vertices @ turn.T + [0.1, -0.08, 0.05], truth.faces)
    assert score_surface(moved, truth, (0.002,), ComparisonOptions(5000)).f1[0] < 30
    assert score_surface(moved, truth, (0.002,), ComparisonOptions(5000, align=kind)).f1[0] == 100.0


def test_rigid_alignment_keeps_the_scale() -> None:
    truth = sphere(1.0)
    bigger = Surface(truth.vertices * 1.1, truth.faces)
    scores = score_surface(bigger, truth, (0.01,), ComparisonOptions(2000, align="rigid"))
    assert np.linalg.det(np.array(scores.alignment)[:3, :3]) == pytest.approx(1.0)
    assert scores.mean_error > 0.05


def test_hygiene_counts_holes_parts_and_bad_edges() -> None:
    clean = sphere(1.0).hygiene()
    assert (clean.components, clean.holes, clean.boundary_edges, clean.non_manifold_edges) == (1, 0, 0, 0)
    assert clean.area == pytest.approx(4 * np.pi, rel=0.01)
    ball = trimesh.creation.icosphere(subdivisions=2)
    open_ball = Surface(ball.vertices, np.delete(ball.faces, [0, 200], axis=0)).hygiene()
    assert (open_ball.holes, open_ball.boundary_edges) == (2, 6)
    fan = np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4]])
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [9, 9, 9], [9, 8, 9], [8, 9, 9]], float)
    bad = Surface(corners, np.concatenate([fan, [[5, 6, 7]]])).hygiene()
    assert (bad.components, bad.non_manifold_edges) == (2, 1)


def test_mask_iou() -> None:
    a, b = np.zeros((10, 10), bool), np.zeros((10, 10), bool)
    assert mask_iou(a, b) == 100.0
    a[:, :6], b[:, 4:] = True, True
    assert mask_iou(a, b) == pytest.approx(20.0)
    valid = np.zeros((10, 10), bool)
    valid[:, 4:6] = True
    assert mask_iou(a, b, valid) == 100.0


def test_files_give_the_same_scores_as_surfaces(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(subdivisions=3)
    for end in ("ply", "obj", "glb"):
        path = tmp_path / f"straße ball.{end}"
        ball.export(path)
        scores = score_surface(read_surface(path), read_surface(path), (0.001,), ComparisonOptions(1000))
        assert scores.f1 == (100.0,)
        assert json.loads(json.dumps(scores.as_dict()))["hygiene"]["faces"] == len(ball.faces)


def test_bad_input_is_one_clear_sentence(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="There is no mesh"):
        read_surface(tmp_path / "none.ply")
    garbage = tmp_path / "garbage.ply"
    garbage.write_bytes(b"ply\nnot really")
    with pytest.raises(BadInput, match="Cannot read the mesh"):
        read_surface(garbage)
    trimesh.PointCloud(np.random.default_rng(0).random((10, 3))).export(tmp_path / "cloud.ply")
    with pytest.raises(BadInput, match=r"no faces|Cannot read"):
        read_surface(tmp_path / "cloud.ply")
    impossible = (((0.1, 0.0), 10, "above 0, not 0"), ((), 10, "no threshold"), ((0.1,), 0, "not 0"))
    for thresholds, samples, says in impossible:
        with pytest.raises(BadInput, match=says):
            score_surface(plane(0), plane(0), thresholds, ComparisonOptions(samples))
    far = np.array([[90.0, 90, 90], [99, 99, 99]])
    with pytest.raises(BadInput, match="share one frame"):
        score_surface(plane(0), plane(0), (0.1,), ComparisonOptions(10, crop=far))
    with pytest.raises(BadInput, match="not numbers"):
        Surface(np.full((3, 3), np.nan), np.array([[0, 1, 2]]))


def bent(degrees: float) -> Surface:
    """The plane turned about the y axis."""
    turn, flat = np.radians(degrees), plane(0.0)
    x, y, _ = flat.vertices.T
    return Surface(np.stack([x * np.cos(turn), y, x * np.sin(turn)], 1), flat.faces)


def test_normals_are_measured_where_the_mesh_is_near_the_truth() -> None:
    scores = score_surface(bent(3.0), plane(0.0), (10.0,), ComparisonOptions(5000))
    assert scores.normal_median == pytest.approx(3.0) and scores.normal_90 == pytest.approx(3.0)
    turned = Surface(bent(3.0).vertices, bent(3.0).faces[:, ::-1])
    assert score_surface(turned, plane(0.0), (10.0,), ComparisonOptions(5000)).normal_90 == pytest.approx(3.0)
    assert score_surface(plane(0.0), plane(0.0), (0.1,), ComparisonOptions(5000)).normal_90 == pytest.approx(
        0.0, abs=1e-6
    )
    assert score_surface(plane(1.0), plane(0.0), (0.1,), ComparisonOptions(5000)).normal_median is None


def test_scores_by_material() -> None:
    wall, roof = plane(0.0), plane(5.0, size=2.0)
    both = Surface(np.r_[wall.vertices, roof.vertices], np.r_[wall.faces, roof.faces + len(wall.vertices)])
    names = np.r_[np.full(len(wall.faces), 2), np.zeros(len(roof.faces))].astype(np.int64)
    poor = Surface(np.r_[wall.vertices, plane(5.3, size=2.0).vertices], both.faces)
    scores = score_surface(
        poor, both, (0.01, 0.5), ComparisonOptions(10000), materials=Materials(("slate", "glass", "brick"), names)
    )
    assert list(scores.materials) == ["brick", "slate"]  # the largest first; no face is of glass
    brick, slate = scores.materials.values()
    assert brick.share == pytest.approx(80, abs=0.5) and brick.f1 == (100.0, 100.0)
    assert slate.f1 == (0.0, 100.0) and slate.normal_90 == pytest.approx(0.0, abs=1e-6)
    nothing = score_surface(
        wall, both, (0.01,), ComparisonOptions(10000), materials=Materials(("slate", "glass", "brick"), names)
    )
    assert nothing.materials["slate"].f1 == (0.0,) and nothing.materials["slate"].normal_median is None
    json.dumps(nothing.as_dict(), allow_nan=False)
    without = score_surface(
        poor, both, (0.01,), ComparisonOptions(10000), leave_out=roof, materials=Materials(("a", "b", "c"), names)
    )
    assert list(without.materials) == ["c"]


def test_a_comparison_inside_a_box_leaves_out_both_meshes_beside_it() -> None:
    wall, far = plane(0.0), plane(5.0, size=2.0)
    mesh = Surface(np.r_[wall.vertices, far.vertices], np.r_[wall.faces, far.faces + len(wall.vertices)])
    found = compare_surfaces(mesh, wall, ComparisonOptions(5_000))
    assert found.scores((0.1,)).f1[0] < 95  # a second sheet, which is nowhere in the truth
    low, high = wall.vertices.min(0) - 0.5, wall.vertices.max(0) + 0.5
    inside = found.inside(np.stack([low, high]))
    assert inside.scores((0.1,)).f1 == (100.0,) and 0 < len(inside.points) < len(found.points)
    with pytest.raises(BadInput):
        found.inside(np.stack([high, high + 1]))


def test_materials_beside_a_truth(tmp_path: Path) -> None:
    truth, names, faces = (tmp_path / f"truth{end}" for end in (".ply", "_materials.json", "_materials.npy"))
    assert read_materials(truth, 3) is None
    np.save(faces, np.array([1, 0, 1], np.int32))
    with pytest.raises(BadInput, match="Cannot read the materials"):
        read_materials(truth, 3)
    names.write_text('["brick", "glass"]', encoding="utf-8")
    found = read_materials(truth, 3)
    assert found is not None and found.names == ("brick", "glass") and found.faces.tolist() == [1, 0, 1]
    for bad_names, count in (('["brick"]', 3), ('["brick", "glass"]', 4), ("{}", 3), ("[1, 2]", 3)):
        names.write_text(bad_names, encoding="utf-8")
        with pytest.raises(BadInput, match="are not those of its"):
            read_materials(truth, count)
    for damaged in (b"", b"\x93NUMPY", b"no array"):
        faces.write_bytes(damaged)
        with pytest.raises(BadInput, match="Cannot read the materials"):
            read_materials(truth, 3)
