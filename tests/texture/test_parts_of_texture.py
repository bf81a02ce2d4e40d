# SPDX-License-Identifier: GPL-3.0-or-later
"""Choosing photos, laying out patches, and levelling seams, each on something small."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.analytic import ball, camera, ring

from mgf_engine.geometry.clean import face_neighbours
from mgf_engine.geometry.rasterize import draw_triangles
from mgf_engine.model.mesh import Mesh
from mgf_engine.texture.charts import CELL, ChartOptions, lay_out, merge_patches
from mgf_engine.texture.model import NO_VIEW
from mgf_engine.texture.seams import level_seams
from mgf_engine.texture.view_selection import choose_views, patches
from mgf_engine.texture.visibility import FaceViews, VisibilityOptions, _FaceViewCollector, find_face_views

SIDE = 12


def strip() -> np.ndarray:
    """Faces of a strip of SIDE squares between two rows of vertices, [2 SIDE, 3]."""
    i = np.arange(SIDE)
    low, high = i, i + SIDE + 1
    both = np.stack([np.column_stack([low, low + 1, high]), np.column_stack([low + 1, high + 1, high])], 1)
    return both.reshape(-1, 3).astype(np.int32)


def face_views(sizes: np.ndarray) -> FaceViews:
    """From sizes [views, faces], 0 where a view does not show a face."""
    view, face = np.nonzero(sizes)
    return FaceViews(view.astype(np.int32), face.astype(np.int32), sizes[view, face].astype(np.float32), sizes.shape[1])


def choose(sizes: np.ndarray) -> np.ndarray:
    faces = strip()
    return choose_views(face_views(sizes), face_neighbours(faces), np.ones(len(faces)))


def test_neighbours_share_an_edge() -> None:
    faces = strip()
    pairs = face_neighbours(faces)
    assert len(pairs) == len(faces) - 1
    assert all(len(set(faces[a]) & set(faces[b])) == 2 for a, b in pairs)


def test_one_photo_that_shows_all_nearly_best_paints_all() -> None:
    sizes = np.zeros((3, 2 * SIDE))
    sizes[0, :SIDE], sizes[2, SIDE:], sizes[1] = 100, 100, 80
    assert (choose(sizes) == 1).all()


def test_a_much_better_photo_is_worth_a_seam_and_what_none_shows_stays_bare() -> None:
    sizes = np.zeros((2, 2 * SIDE))
    sizes[0, : SIDE + 4], sizes[1, SIDE:-2] = 100, 300
    label = choose(sizes)
    assert (label[:SIDE] == 0).all() and (label[SIDE:-2] == 1).all() and (label[-2:] == NO_VIEW).all()
    assert len(np.unique(patches(label, face_neighbours(strip())))) == 3


def test_small_patches_go_to_a_neighbour_that_shows_them() -> None:
    sizes = np.zeros((2, 2 * SIDE))
    sizes[0], sizes[1, 7:10] = 4, 12
    assert (choose(sizes) == 0).all()
    sizes[0, 7:10] = 0
    assert (choose(sizes)[7:10] == 1).all()


@pytest.mark.parametrize("largest", [256, 1024])
def test_every_face_has_its_place(largest: int) -> None:
    rng = np.random.default_rng(1)
    count = 60
    corner = rng.uniform(20, 400, (count, 1, 2))
    uv = corner + rng.uniform(0, 80, (count, 3, 2))
    label = np.where(np.arange(count) < 40, np.arange(count) % 3, NO_VIEW).astype(np.int32)
    layout = lay_out(uv, label, np.arange(count, dtype=np.int32), 2.0, largest)
    assert layout.width <= largest and layout.height <= largest and layout.scale <= 2.0
    assert layout.scale == 2.0 or largest == 256
    low, high = layout.at.min(1), layout.at.max(1)
    assert low.min() >= 1 and (high <= (layout.width - 1, layout.height - 1)).all()
    sides = np.linalg.norm(np.diff(layout.at[:40], axis=1), axis=2) / np.linalg.norm(np.diff(uv[:40], axis=1), axis=2)
    assert np.abs(sides - layout.scale).max() < 1e-9
    apart = np.maximum(low[:, None] - high[None], low[None] - high[:, None]).max(2)
    apart[np.diag_indices(count)] = np.inf
    gutters = 2 * ChartOptions().gutter
    assert apart.min() >= gutters - 1e-9 or apart[:40, :40].min() >= gutters - 1e-9
    assert apart[40:, 40:].min() >= CELL - 4.5


def test_patches_of_one_photo_share_a_rectangle_where_that_takes_less_room() -> None:
    """A large triangle, a small one in the gap beside it, one far away, and one of another photo in the gap."""
    large = np.array([[0, 0], [0, 300], [300, 300]], float)
    small = np.array([[0, 0], [0, 20], [20, 20]], float)
    uv = np.stack([large, *(small + np.array(at) for at in ((200, 50), (900, 900), (200, 100)))])
    label, patch = np.array([0, 0, 0, 1], np.int32), np.arange(4, dtype=np.int32)
    chart = merge_patches(uv, label, patch)
    assert chart[0] == chart[1] and len(np.unique(chart)) == 3
    layout = lay_out(uv, label, chart, 1.0, 2048)
    assert np.abs((layout.at[0] - layout.at[1]) - (uv[0] - uv[1])).max() < 1e-9
    apart = lay_out(uv, label, patch, 1.0, 2048)
    assert layout.width * layout.height <= apart.width * apart.height
    drawn = draw_triangles(layout.at, layout.height, layout.width)
    assert np.unique(drawn).tolist() == [-1, 0, 1, 2, 3]


def test_charts_lie_in_whole_pixels_of_their_photos() -> None:
    rng = np.random.default_rng(5)
    uv = rng.uniform(20, 400, (30, 1, 2)) + rng.uniform(0, 80, (30, 3, 2))
    ids = np.arange(30, dtype=np.int32)
    layout = lay_out(uv, ids, ids, 2.0, 2048)
    shift = layout.at - 2.0 * uv
    assert layout.scale == 2.0 and np.abs(shift - np.rint(shift)).max() < 1e-9


def test_more_bare_faces_than_cells_make_the_picture_larger() -> None:
    count = (256 // CELL) ** 2 + 1
    label = np.full(count, NO_VIEW, np.int32)
    layout = lay_out(np.zeros((count, 3, 2)), label, np.zeros(count, np.int32), 1.0, 256)
    assert layout.width == 512
    drawn = draw_triangles(layout.at, layout.height, layout.width)
    assert len(np.unique(drawn[drawn >= 0])) == count


def painted_ball(shift: float):
    """A ball, two cameras beside each other that see it in one colour, the second ``shift`` darker."""
    mesh, views = ball(subdivisions=3), [camera((4.0, 0, 0)), camera((3.4, 2.0, 0))]
    photos = [np.full((v.height, v.width, 3), 150 - shift * k, np.uint8) for k, v in enumerate(views)]
    mesh = replace(mesh, colors=np.full((len(mesh.vertices), 3), 150, np.uint8))
    half = (mesh.vertices[mesh.faces].mean(1)[:, 1] > 0.3).astype(np.int32)
    return mesh, half, views, photos


def test_both_sides_of_a_seam_agree() -> None:
    mesh, half, views, photos = painted_ball(12)
    found = level_seams(mesh, half, face_neighbours(mesh.faces), views, lambda i: photos[i])
    value = np.array([150.0, 138.0])[half][:, None, None] + found.value[found.of_corner]
    seam = np.intersect1d(mesh.faces[half == 0], mesh.faces[half == 1])
    sides = [value[half == k][np.isin(mesh.faces[half == k], seam)] for k in (0, 1)]
    assert abs(sides[0].mean() - sides[1].mean()) < 1.5 and np.ptp(np.concatenate(sides)) < 3
    assert np.abs(found.value).max() < 12  # each side gives way


def test_without_seams_or_differences_nothing_is_corrected() -> None:
    mesh, half, views, photos = painted_ball(0)
    assert np.abs(level_seams(mesh, half, face_neighbours(mesh.faces), views, lambda i: photos[i]).value).max() < 1e-3
    one = np.zeros_like(half)
    assert np.abs(level_seams(mesh, one, face_neighbours(mesh.faces), views, lambda i: photos[i]).value).max() < 1e-3


def test_what_is_painted_with_vertex_colors_stays() -> None:
    mesh, half, views, photos = painted_ball(0)
    bare = np.where(half == 1, NO_VIEW, 0).astype(np.int32)
    mesh = replace(mesh, colors=np.full_like(mesh.colors, 130))
    found = level_seams(mesh, bare, face_neighbours(mesh.faces), views, lambda i: photos[i])
    assert np.abs(found.value[found.of_corner[half == 1]]).max() < 0.5
    assert found.value[found.of_corner[half == 0]].min() < -5


def test_a_face_is_shown_where_it_is_seen_from_its_front() -> None:
    mesh, views = ball(subdivisions=3), ring(8)
    photos = [np.full((v.height, v.width, 3), 128, np.uint8) for v in views]
    mesh = replace(mesh, colors=np.full((len(mesh.vertices), 3), 128, np.uint8))
    every = np.ones(photos[0].shape[:2], bool)
    found = find_face_views(mesh, views, lambda i: photos[i], lambda i: every)
    middle = mesh.vertices[mesh.faces[found.face]].mean(1)
    toward = np.stack([v.centre for v in views])[found.view] - middle
    cosine = (middle * toward).sum(1) / np.linalg.norm(middle, axis=1) / np.linalg.norm(toward, axis=1)
    assert cosine.min() > 0.1 and len(np.unique(found.face)) > 0.9 * len(mesh.faces)
    nothing = find_face_views(mesh, views, lambda i: photos[i], lambda i: ~every)
    assert len(nothing.face) == 0 and (choose_all(nothing, mesh) == NO_VIEW).all()


def choose_all(found: FaceViews, mesh: Mesh) -> np.ndarray:
    return choose_views(found, face_neighbours(mesh.faces), np.ones(len(mesh.faces)))


def test_a_photo_in_another_color_than_the_others_is_taken_only_where_no_other_shows() -> None:
    mesh, views = ball(subdivisions=3), ring(8)
    photos = [np.full((v.height, v.width, 3), 20 if k == 0 else 128, np.uint8) for k, v in enumerate(views)]
    mesh = replace(mesh, colors=np.full((len(mesh.vertices), 3), 128, np.uint8))
    every = np.ones(photos[0].shape[:2], bool)
    found = find_face_views(mesh, views, lambda i: photos[i], lambda i: every)
    label = choose_all(found, mesh)
    seen_elsewhere = np.isin(np.arange(len(mesh.faces)), found.face[found.view != 0])
    assert not (label[seen_elsewhere] == 0).any()


@pytest.mark.parametrize("hidden_by", ["mask", "wall"])
def test_beside_what_hides_the_building_another_photo_paints(hidden_by: str) -> None:
    """A ball before two cameras; the nearer one has leaves, or a plate, before the middle of it."""
    mesh, views = ball(subdivisions=5), [camera((3.6, 0, 0)), camera((4.0, 1.2, 0))]
    photos = [np.full((v.height, v.width, 3), 128, np.uint8) for v in views]
    inside = [np.ones(p.shape[:2], bool) for p in photos]
    if hidden_by == "mask":
        inside[0][56:72, 72:88] = False
    else:
        plate = np.array([[2.0, -0.07, -0.07], [2.0, 0.07, -0.07], [2.0, 0.07, 0.07], [2.0, -0.07, 0.07]])
        faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32) + len(mesh.vertices)
        mesh = Mesh(
            np.concatenate([mesh.vertices, plate]), np.concatenate([mesh.faces, faces]), np.zeros((0, 3), np.uint8)
        )
    mesh = replace(mesh, colors=np.full((len(mesh.vertices), 3), 128, np.uint8))
    on_ball = np.arange(len(mesh.faces)) < len(ball(subdivisions=5).faces)
    found = {
        rim: find_face_views(mesh, views, lambda i: photos[i], lambda i: inside[i], options=VisibilityOptions(rim=rim))
        for rim in (0.0, 4.0)
    }
    at = views[0].project(mesh.vertices[mesh.faces].mean(1))[0]
    beside = on_ball & (np.abs(at - (80, 64)).max(1) < 8 + 3)
    by = {(rim, v): found[rim].face[found[rim].view == v] for rim in found for v in range(2)}
    both = np.intersect1d(np.intersect1d(by[0.0, 0], by[0.0, 1]), np.flatnonzero(beside))
    assert len(both) > 20 and not np.isin(both, by[4.0, 0]).any() and np.isin(both, by[4.0, 1]).all()
    assert (choose_all(found[4.0], mesh)[both] == 1).all()


def test_views_that_are_small_beside_others_are_dropped_underway() -> None:
    """What is dropped is what nobody asks for, and never all views are held."""
    rng, faces, views = np.random.default_rng(2), 400, 500
    shown = [np.sort(rng.choice(faces, faces // 10, replace=False)).astype(np.int32) for _ in range(views)]
    sizes = [(rng.random(len(f)) ** 4).astype(np.float32) for f in shown]
    found, most = _FaceViewCollector(faces, VisibilityOptions.least_size), 0
    for k in range(views):
        found.add(k, shown[k], sizes[k])
        most = max(most, found._count)
    kept = found.collect()
    best = np.zeros(faces, np.float32)
    for f, s in zip(shown, sizes, strict=True):
        best[f] = np.maximum(best[f], s)
    expected = [
        (k, int(f))
        for k in range(views)
        for f, s in zip(shown[k], sizes[k], strict=True)
        if s >= VisibilityOptions.least_size * best[f]
    ]
    assert list(zip(kept.view.tolist(), kept.face.tolist(), strict=True)) == expected
    assert len(expected) < most < 0.75 * sum(map(len, shown))
