# SPDX-License-Identifier: GPL-3.0-or-later
from __future__ import annotations

import functools
from dataclasses import replace

import igl
import numpy as np
import pytest
import torch
import trimesh
from support.analytic import as_trimesh, ball, box, cuboid, discs, joined, mesh_of, ring, scene_of, sphere
from support.mesh_stage import mesh_options, reporter

from mgf_engine.errors import BadInput, Cancelled
from mgf_engine.geometry import block_store
from mgf_engine.mesh import tetra_blocks
from mgf_engine.mesh.border_smoothing import MeshBorderOptions
from mgf_engine.mesh.extract import extract_mesh
from mgf_engine.model.gaussians import Gaussians
from mgf_engine.system import memory
from mgf_engine.system.timing import PartTimes


def distance(points, truth):
    return np.sqrt(igl.point_mesh_squared_distance(points, truth.vertices, truth.faces.astype(np.int64))[0])


# deviations of the paving discs across the surface are 0.01; their rims stand off a curved surface
@pytest.mark.parametrize(("surface", "shape"), [("fused", "sphere"), ("fused", "box"), ("opacity", "box")])
def test_known_shapes_come_back_closed_outward_and_in_place(surface, shape):
    field, truth = (sphere(800), ball()) if shape == "sphere" else (box(0.12), cuboid())
    scene, masks = scene_of(ring(16), truth)
    seen, times = [], PartTimes()
    options = mesh_options({"surface": surface, "level_steps": 5})
    mesh = extract_mesh(field, scene, masks, options, reporter(seen.append), times)
    closed = as_trimesh(mesh)
    assert closed.is_watertight and closed.is_winding_consistent and closed.body_count == 1
    assert 0.9 < closed.volume / as_trimesh(truth).volume < 1.25
    apart = distance(mesh.vertices, truth)
    assert np.median(apart) < 0.06 and apart.max() < 0.2
    assert np.median(distance(truth.vertices, mesh)) < 0.08
    assert (np.abs(mesh.colors.astype(int) - (200, 120, 40)) <= 1).all()
    fractions = [m["fraction"] for m in seen if m["type"] == "progress"]
    assert fractions == sorted(fractions) and len(fractions) > 20
    seconds = times.figures()["seconds_per_part"]
    parts = ["points", "depth maps", "tetrahedra", "level set", "cleaning", "refinement"]
    assert list(seconds) == [*parts, "planes", "openings", "borders", "colours", "reduction"]
    assert all(value >= 0 for value in seconds.values()) and sum(seconds.values()) > 0


def in_blocks(surface, count, said):
    scene, masks = scene_of(ring(16), cuboid())
    given = {"surface": surface, "level_steps": 5, "fill_holes": False, "face_votes": False}  # seams would show
    return extract_mesh(box(0.12), scene, masks, mesh_options({**given, "blocks": count}), said)


@functools.cache
def in_one(surface):
    seen = []
    mesh = in_blocks(surface, 1, reporter(seen.append))
    assert not [m for m in seen if "block" in m.get("figures", {})]
    return mesh


@pytest.mark.parametrize(("surface", "number"), [("fused", 3), ("fused", 8), ("opacity", 4)])
def test_blocks_make_the_same_surface_without_seams(surface, number):
    truth, seen = cuboid(), []
    found = [in_one(surface), in_blocks(surface, number, reporter(seen.append))]
    whole, joined_up = (as_trimesh(mesh) for mesh in found)
    assert whole.is_watertight and joined_up.is_watertight and joined_up.is_winding_consistent
    assert joined_up.body_count == 1
    assert joined_up.volume == pytest.approx(whole.volume, rel=0.01)
    off = [np.percentile(distance(mesh.vertices, truth), [50, 95]) for mesh in found]
    assert np.abs(off[0] - off[1]).max() < 0.01
    told = [m["figures"]["block"] for m in seen if m["type"] == "progress" and "block" in m.get("figures", {})]
    assert told == [f"{k} of {number}" for k in range(1, number + 1)]


def test_a_stopped_job_goes_on_at_the_block_it_had_reached(monkeypatch, tmp_path):
    scene, masks = scene_of(ring(8), ball())
    options, made = mesh_options({"level_steps": 3, "blocks": 4}), []
    monkeypatch.setattr(memory, "_scratch", tmp_path)
    whole = extract_mesh(sphere(300), scene, masks, options, reporter())
    block_store.clear_blocks()

    def stop(message):
        if message["type"] == "progress" and message["figures"].get("block") == "3 of 4":
            stopped.cancel()

    stopped = reporter(stop)
    with pytest.raises(Cancelled):
        extract_mesh(sphere(300), scene, masks, options, stopped)
    assert len(list((tmp_path / "blocks" / "mesh").iterdir())) == 2
    background_delaunay = tetra_blocks.background_delaunay
    monkeypatch.setattr(
        tetra_blocks, "background_delaunay", lambda *points: made.append(len(points[0])) or background_delaunay(*points)
    )
    again = extract_mesh(sphere(300), scene, masks, options, reporter())
    assert len(made) == 3  # the first, which begins beside the depth maps, and those that were left
    assert np.array_equal(again.vertices, whole.vertices) and np.array_equal(again.faces, whole.faces)


def test_same_input_same_mesh_for_any_number_of_threads():
    from mgf_engine.native import library

    scene, masks = scene_of(ring(8), ball())
    results = []
    for threads in (1, 3):
        library.set_threads(threads)
        results.append(extract_mesh(sphere(200), scene, masks, mesh_options({"level_steps": 3}), reporter()))
    library.set_threads(0)
    assert np.array_equal(results[0].vertices, results[1].vertices)
    assert np.array_equal(results[0].faces, results[1].faces)
    assert np.array_equal(results[0].colors, results[1].colors)


def test_fused_level_moves_onto_the_sparse_points():
    truth = ball()
    scene, masks = scene_of(ring(12), truth)
    count = 300
    directions = np.random.default_rng(0).normal(size=(count, 3))
    points = 1.02 * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    scene = replace(
        scene, points=points, colors=np.zeros((count, 3), np.uint8), errors=np.full(count, 0.3, np.float32),
        track_start=3 * np.arange(count + 1), track_view=np.zeros(3 * count, np.int32),
        track_uv=np.zeros((3 * count, 2), np.float32),
    )  # fmt: skip
    with_points = replace(masks, point_mask=np.ones(count, bool))
    options = mesh_options({"level_steps": 6, "smoothing": 0})
    radius = [
        np.median(np.linalg.norm(extract_mesh(sphere(800), scene, m, options, reporter()).vertices, axis=1))
        for m in (replace(masks, point_mask=np.zeros(count, bool)), with_points)
    ]
    assert abs(radius[1] - 1.02) < 0.006 and abs(radius[0] - 1.02) > abs(radius[1] - 1.02)


def test_confidence_tells_seen_from_made_up():
    views = ring(12)
    scene, masks = scene_of(views, ball(1.1))
    mesh = extract_mesh(sphere(500), scene, masks, mesh_options({"level_steps": 3}), reporter())
    seen, trust = mesh.values["views"], mesh.values["confidence"]
    assert seen.shape == trust.shape == (len(mesh.vertices),) and (seen > 0).mean() > 0.95
    # The photos of this scene are blank: seen often enough, but nothing in them to compare.
    assert np.allclose(trust, 0.5 * np.minimum(seen / 3, 1))
    opposite = [v for v in range(12) if views[v].centre[0] > 0]
    half = replace(masks, used=np.isin(np.arange(12), opposite))
    options = mesh_options({"level_steps": 3})
    trimmed = extract_mesh(sphere(500), scene, half, options, reporter())
    whole = replace(options, borders=MeshBorderOptions(photos=0))
    mesh = extract_mesh(sphere(500), scene, half, whole, reporter())
    towards, left = (m.vertices[:, 0] / np.linalg.norm(m.vertices, axis=1) for m in (mesh, trimmed))
    assert (left < -0.3).sum() < 0.5 * (towards < -0.3).sum()  # what no photo shows goes, for it hangs at the border
    assert mesh.values["views"][towards > 0.7].mean() > mesh.values["views"][towards < 0.0].mean() + 1


def test_floaters_and_bubbles_go():
    speck = sphere(60)
    speck.positions = speck.positions * 0.05 + torch.tensor([0.0, 0.0, 1.5])
    speck.log_scales -= float(np.log(20))
    inner = sphere(150)
    inner.positions = inner.positions * 0.4
    inner.log_scales -= float(np.log(2.5))
    scene, masks = scene_of(ring(12), ball(1.7))
    mesh = extract_mesh(joined(sphere(500), speck, inner), scene, masks, mesh_options({"level_steps": 3}), reporter())
    radius = np.linalg.norm(mesh.vertices, axis=1)
    assert radius.min() > 0.8 and radius.max() < 1.25 and as_trimesh(mesh).body_count == 1


def test_masks_cut_away_what_is_not_building():
    """Opaque things next to the building that the masks call background are carved off even without screening."""
    neighbour = sphere(300)
    neighbour.positions = neighbour.positions * 0.4 + torch.tensor([1.7, 0.0, 0.0])
    neighbour.log_scales -= float(np.log(2.5))
    scene, masks = scene_of(ring(12), ball())
    for screening in (True, False):
        options = mesh_options({"level_steps": 3, "screening": screening})
        mesh = extract_mesh(joined(sphere(500), neighbour), scene, masks, options, reporter())
        assert mesh.vertices[:, 0].max() < 1.3


def test_a_neighbour_in_the_masks_that_nobody_clicked_goes_and_is_spoken_of():
    neighbour = sphere(300)
    neighbour.positions = neighbour.positions * 0.4 + torch.tensor([2.2, 0.0, 0.0])
    neighbour.log_scales -= float(np.log(2.5))
    both = trimesh.util.concatenate([as_trimesh(ball()), as_trimesh(ball(0.4)).apply_translation([2.2, 0, 0])])
    views = ring(12, radius=6.0)
    scene, masks = scene_of(views, mesh_of(both))
    options, said = mesh_options({"level_steps": 3}), []
    for middle, reach in ((0.0, 1.3), (2.2, 2.9)):
        clicks = [np.zeros((0, 2), np.float32)] * 12
        for side in (3, 9):  # from where neither hides the other
            spots = views[side].project(np.array([[middle, 0, 0], [0, 0, 0]]))[0]
            clicks[side] = spots.astype(np.float32)
        field = joined(sphere(500), neighbour)
        mesh = extract_mesh(field, scene, replace(masks, clicks=tuple(clicks)), options, reporter(said.append))
        assert reach - 0.3 < mesh.vertices[:, 0].max() < reach
    (warning,) = [m["text"] for m in said if m["type"] == "warning"]
    assert "apart from everything that was clicked" in warning


def test_face_count_is_kept():
    scene, masks = scene_of(ring(8), ball())
    options = mesh_options({"level_steps": 2, "max_faces": 1500})
    assert 800 < len(extract_mesh(sphere(300), scene, masks, options, reporter()).faces) <= 1500


def empty_field() -> Gaussians:
    return sphere(10).select(torch.zeros(10, dtype=torch.bool))


def one_gaussian() -> Gaussians:
    return discs([[0.0, 0, 0]], [[0.0, 0, 1]], 0.3)


def flat_points() -> Gaussians:
    flat = discs(np.random.default_rng(0).normal(size=(50, 3)) * [0.3, 0.3, 0], np.tile([0.0, 0, 1], (50, 1)), 0.1)
    flat.log_scales[:, 2] = -60.0
    flat.filter_3d[:] = 0.0
    return flat


@pytest.mark.parametrize("surface", ["fused", "opacity"])
def test_one_gaussian_is_a_blob_or_a_clear_message(surface):
    scene, masks = scene_of(ring(8), ball())
    try:
        mesh = extract_mesh(one_gaussian(), scene, masks, mesh_options({"surface": surface}), reporter())
        assert np.isfinite(mesh.vertices).all()
    except BadInput as error:
        assert str(error).endswith(".")


def test_what_cannot_be_meshed_is_said_in_one_sentence():
    scene, masks = scene_of(ring(8), ball())
    options = mesh_options({})
    with pytest.raises(BadInput, match="no Gaussians"):
        extract_mesh(empty_field(), scene, masks, options, reporter())
    far = sphere(50)
    far.positions = far.positions + torch.tensor([0.0, 0.0, 30.0])
    with pytest.raises(BadInput, match="vote against every Gaussian"):
        extract_mesh(far, scene, masks, options, reporter())
    with pytest.raises(BadInput, match="surface"):
        extract_mesh(flat_points(), scene, masks, options, reporter())
    with pytest.raises(BadInput, match="usable mask"):
        extract_mesh(sphere(50), scene, replace(masks, used=np.zeros(8, bool)), options, reporter())
    faint = sphere(50)
    faint.opacity_logits[:] = -30.0
    with pytest.raises(BadInput, match="opaque enough"):
        extract_mesh(faint, scene, masks, options, reporter())


def test_broken_and_doubled_gaussians_do_no_harm():
    field = joined(sphere(400), sphere(400))
    field.positions[::50] = float("nan")
    field.log_scales[1::50] = float("inf")
    scene, masks = scene_of(ring(8), ball())
    mesh = extract_mesh(field, scene, masks, mesh_options({"level_steps": 3}), reporter())
    assert np.isfinite(mesh.vertices).all() and as_trimesh(mesh).volume > 3.5


def test_cancelling_stops_the_stage():
    stopped = reporter()
    stopped.cancel()
    scene, masks = scene_of(ring(4), ball())
    with pytest.raises(Cancelled):
        extract_mesh(sphere(50), scene, masks, mesh_options({}), stopped)


@pytest.mark.parametrize("surface", ["fused", "opacity"])
def test_asking_in_chunks_changes_nothing(surface, monkeypatch):
    from mgf_engine.mesh import opacity, tsdf
    from mgf_engine.mesh.find_trusted_views import find_trusted_views
    from mgf_engine.mesh.surface_field import surface_field

    scene, masks = scene_of(ring(8), ball())
    options = mesh_options({"surface": surface})
    field = surface_field(sphere(200), find_trusted_views(scene, masks, options), options, reporter())
    points = np.random.default_rng(0).normal(size=(1000, 3))
    shares: list[float] = []
    whole = field.classify(points), field.observations(points)
    monkeypatch.setattr(tsdf, "CHUNK", 128)
    monkeypatch.setattr(opacity, "CHUNK", 128)
    parts = field.classify(points, shares.append), field.observations(points)
    assert len(np.unique(whole[0])) > 1 and np.array_equal(whole[0], parts[0])
    assert whole[1].keys() == parts[1].keys() and all(np.array_equal(whole[1][k], parts[1][k]) for k in whole[1])
    assert shares == sorted(shares) and shares[0] >= 0 and 0.9 < shares[-1] <= 1


def test_surfaces_are_let_go_when_no_view_to_come_needs_them(monkeypatch):
    import weakref

    from mgf_engine.mesh import tsdf
    from mgf_engine.native import library

    alive: list[weakref.ref] = []
    most = 0
    original = tsdf.render_surface

    def render(*arguments):
        nonlocal most
        surface = original(*arguments)
        alive.append(weakref.ref(surface))
        most = max(most, sum(r() is not None for r in alive))
        return surface

    monkeypatch.setattr(tsdf, "render_surface", render)
    views = ring(24)
    masks = scene_of(views, ball())[1]
    grey = np.zeros((views[0].height, views[0].width), np.uint8)
    photos = tsdf.Photos(lambda number: grey, [[max(n - 1, 0), min(n + 1, 23)] for n in range(24)])
    from mgf_engine.mesh.hull import silhouette_masks

    library.set_threads(2)
    field = tsdf.fuse_gaussians(sphere(100), views, silhouette_masks(masks, range(24), 1), photos)
    library.set_threads(0)
    assert len(field.maps) == len(alive) == 24 and most <= 4 + 2 * (2 + 1)  # those made ahead twice over


def test_depth_maps_in_a_file_give_the_same_surface(tmp_path) -> None:
    views = ring(12)
    masks = scene_of(views, ball())[1]
    from mgf_engine.mesh import tsdf
    from mgf_engine.mesh.hull import silhouette_masks

    silhouettes = silhouette_masks(masks, range(12), 1)
    points = np.random.default_rng(0).uniform(-1, 1, (200_000, 3))
    try:
        memory.allow(1e12, tmp_path)
        kept = tsdf.fuse_gaussians(sphere(100), views, silhouettes)
        memory.allow(1e5, tmp_path)
        spilled = tsdf.fuse_gaussians(sphere(100), views, silhouettes)
    finally:
        memory.allow(0.0)
    in_file = [not m.pixels.flags.writeable for m in spilled.maps]
    assert sum(in_file) > 6 and all(m.pixels.flags.writeable for m in kept.maps)
    np.testing.assert_array_equal(kept.signed(points), spilled.signed(points))
