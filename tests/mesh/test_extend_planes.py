# SPDX-License-Identifier: GPL-3.0-or-later
"""Planes reach over dents and worn edges of plain walls, and stop where photos show something else."""

import numpy as np
import pytest

from mgf_engine.geometry.clean import vertex_areas
from mgf_engine.mesh.extend_planes import ON_PLANE, PlaneExtensionOptions, extend_planes
from mgf_engine.mesh.extract import finish_mesh
from mgf_engine.mesh.near_planes import near_planes
from mgf_engine.mesh.options import ExtractionOptions
from mgf_engine.mesh.photo_consistency import compare_patches, see_vertices, widest_angle
from mgf_engine.mesh.planar import flatten_planes
from mgf_engine.mesh.plane_detection import Planes
from mgf_engine.mesh.plane_islands import drop_islands, fill_islands, fill_plain_bumps
from mgf_engine.mesh.plane_label_options import PlaneLabelOptions
from mgf_engine.mesh.plane_labels import _choose, label_vertices
from mgf_engine.model.mesh import Mesh
from tests.support.analytic import camera
from tests.support.sheets import box, joined, noisy, sheet
from tests.support.wall_photos import MIDDLE, cameras, plain, textured

LINE = np.arange(0, 151.0, 1.5)
SIZE = np.array([120.0, 90.0, 75.0])  # of the box


def dented(depth, radius=8.0):
    """A wall in z = 0 that faces +z, with a round dent in its middle."""

    def place(u, v):
        away = np.minimum(np.hypot(u - 75, v - 75) / radius, 1)
        return u, v, -depth * (1 + np.cos(np.pi * away)) / 2

    return joined(sheet(LINE, LINE, place))


def extended(mesh, views, photo, options=PlaneExtensionOptions()):
    pixel = np.ones(len(mesh.vertices))
    pictures = [photo(view) for view in views]
    flat = flatten_planes(mesh, pixel)
    assert flat.planes is not None
    photos = see_vertices(mesh, pixel, views, lambda number: pictures[number])
    return flat.mesh, extend_planes(mesh, flat, pixel, photos, options)


def deepest(mesh):
    return -mesh.vertices[np.hypot(*(mesh.vertices[:, :2] - 75).T) < 6, 2].min()


def test_a_dent_that_no_photo_shows_is_filled():
    flat, result = extended(dented(3.0), cameras(), plain)
    assert deepest(flat) > 2.9, "flattening alone leaves it"
    assert deepest(result) < 0.05


def test_a_filled_dent_is_marked_and_the_membrane_leaves_it():
    _, result = extended(dented(3.0), cameras(), plain)
    assert result.values[ON_PLANE][np.hypot(*(result.vertices[:, :2] - 75).T) < 6].all()

    class Unknown:
        def observations(self, vertices):
            return {"confidence": np.zeros(len(vertices), np.float32), "confirmed": np.zeros(len(vertices))}

    finished = finish_mesh(result, Unknown(), ExtractionOptions())
    assert np.array_equal(finished.vertices, result.vertices)
    assert set(finished.values) == {"confidence"}


def test_a_dent_that_photos_show_stays():
    wall = dented(3.0)
    _, result = extended(wall, cameras(), textured(wall))
    assert deepest(result) > 2.5


def test_a_dent_is_filled_where_photos_show_the_plane():
    _, result = extended(dented(3.0), cameras(), textured(dented(0.0)))
    assert deepest(result) < 0.05


def test_a_dent_is_filled_where_photos_look_from_nearly_the_same_side():
    """A dent of 3 pixels is a parallax of 0.4: the photos look alike on the plane and in the dent."""
    wall, views, photo = dented(3.0), cameras(radius=12.0), textured(dented(0.0))
    always = PlaneExtensionOptions(labels=PlaneLabelOptions(sure_parallax=1e-3))
    assert deepest(extended(wall, views, photo, always)[1]) > 2.5
    assert deepest(extended(wall, views, photo)[1]) < 0.05


@pytest.mark.parametrize(("sure_area", "filled"), [(2000.0, True), (1e12, False)])
def test_a_noisy_plane_is_trusted_the_more_the_larger_it_is(sure_area, filled):
    """The wall has 22,500 square pixels; by its noise alone it would count as no better than no plane."""
    options = PlaneExtensionOptions(labels=PlaneLabelOptions(sure_area=sure_area, island_area=0.0))
    _, result = extended(noisy(dented(3.0), 0.55), cameras(), plain, options)
    assert (deepest(result) < 1.0) == filled


def test_the_widest_angle_is_that_between_the_outermost_rays():
    wall, views = dented(0.0), cameras(count=4, radius=80.0, height=80.0)
    photos = see_vertices(wall, np.ones(len(wall.vertices)), views, lambda number: plain(views[number]))
    middle = np.flatnonzero(np.abs(wall.vertices - MIDDLE).sum(1) < 1e-9)
    assert np.degrees(widest_angle(photos, wall.vertices, middle)) == pytest.approx(90.0)
    photos.best[middle, 1:] = -1
    assert not widest_angle(photos, wall.vertices, middle).any(), "one photo alone"


def worn_box():
    """A box whose edges are rounded by three pixels, as depth maps leave them, and how far each vertex is off."""
    exact = box(*SIZE)
    at = exact.vertices
    for _ in range(40):
        at = exact.adjacency.smooth(at, np.zeros(len(at), bool))
    return noisy(Mesh(at, exact.faces, exact.colors), 0.05)


def outside_views():
    middle = SIZE / 2
    corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-0.8, 0.8)])
    return [camera(middle + 150 * c, middle, 240, 200, 190.0, f"{i}.png") for i, c in enumerate(corners)]


def off_the_box(mesh):
    """Distance of each vertex from the surface of the exact box."""
    low, high = np.zeros(3), SIZE
    outside = np.maximum(np.maximum(low - mesh.vertices, mesh.vertices - high), 0)
    inside = np.minimum(mesh.vertices - low, high - mesh.vertices).min(1)
    return np.where((outside > 0).any(1), np.linalg.norm(outside, axis=1), np.maximum(inside, 0))


def corner_gap(mesh):
    """Return the distance of the nearest vertex from each corner of the exact box, the largest."""
    corners = np.array([(x, y, z) for x in (0, 120) for y in (0, 90) for z in (0, 75)], float)
    return np.linalg.norm(mesh.vertices[None] - corners[:, None], axis=2).min(1).max()


def test_worn_edges_of_a_plain_box_become_sharp():
    worn = worn_box()
    flat, result = extended(worn, outside_views(), plain)
    assert (off_the_box(flat) > 0.5).mean() > 0.15
    assert (off_the_box(result) > 0.5).mean() < 0.08
    assert corner_gap(result) < corner_gap(flat)


def test_hardly_a_face_is_turned_over():
    _, result = extended(worn_box(), outside_views(), plain)
    a, b, c = (result.vertices[result.faces[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    outwards = np.einsum("ij,ij->i", cross, (a + b + c) / 3 - SIZE / 2) > 0
    assert (~outwards & (np.linalg.norm(cross, axis=1) > 1e-6)).sum() < 0.0002 * len(result.faces)


def test_nothing_moves_where_nothing_is_near_a_plane():
    far = PlaneExtensionOptions(labels=PlaneLabelOptions(no_plane_cost=0.0))
    flat, result = extended(dented(3.0), cameras(), plain, far)
    assert deepest(result) == deepest(flat)


def test_vertices_that_no_photo_sees_get_planes_by_the_mesh_alone():
    wall = dented(3.0)
    _, result = extended(wall, cameras(height=-160.0), plain)
    assert np.isfinite(result.vertices).all()
    assert deepest(result) < 0.05


@pytest.mark.parametrize("shift", [-3.0, 3.0])
def test_patches_look_alike_on_the_surface_and_nowhere_else(shift):
    wall = dented(0.0)
    views, photo = cameras(), textured(wall)
    pictures = [photo(view) for view in views]
    photos = see_vertices(wall, np.ones(len(wall.vertices)), views, lambda number: pictures[number])
    inner = np.flatnonzero(np.hypot(*(wall.vertices[:, :2] - 75).T) < 25)
    normals, pixel = np.tile([0.0, 0, 1], (len(inner), 1)), np.ones(len(inner))
    on, contrast = compare_patches(photos, inner, wall.vertices[inner], normals, pixel)
    off, _ = compare_patches(photos, inner, wall.vertices[inner] + (0, 0, shift), normals, pixel)
    assert np.median(on) > 0.9
    assert np.median(off) < np.median(on) - 0.3
    assert np.median(contrast) > 20


def test_plain_photos_have_no_contrast_and_no_correlation():
    wall = dented(0.0)
    photos = see_vertices(wall, np.ones(len(wall.vertices)), cameras(), lambda number: plain(cameras()[number]))
    middle = np.array([int(np.hypot(*(wall.vertices[:, :2] - 75).T).argmin())])
    score, contrast = compare_patches(photos, middle, wall.vertices[middle], np.array([[0.0, 0, 1]]), np.ones(1))
    assert (score, contrast) == (0, 0)
    nothing = compare_patches(photos, middle[:0], np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
    assert [len(part) for part in nothing] == [0, 0]


def test_views_that_see_a_vertex_best_face_it_and_nothing_hides_it():
    both = joined(sheet(LINE, LINE, lambda u, v: (u, v, 0 * u)), sheet(LINE, LINE, lambda u, v: (u, v, 0 * u - 20)))
    views = [*cameras(4), *cameras(4, height=-160.0)]
    photos = see_vertices(both, np.ones(len(both.vertices)), views, lambda number: plain(views[number]))
    near = np.hypot(*(both.vertices[:, :2] - 75).T) < 10
    upper, lower = near & (both.vertices[:, 2] == 0), near & (both.vertices[:, 2] == -20)
    assert set(photos.best[upper].ravel()) - {-1} == {0, 1, 2, 3}
    assert set(photos.best[lower].ravel()) == {-1}, "hidden from above, and facing away from below"


def flat_planes(mesh, heights):
    """Planes z = height of which none was found on a face, but the first on all."""
    normals = np.tile([0.0, 0, 1], (len(heights), 1))
    return Planes(
        normals,
        np.array(heights, float),
        np.zeros(len(heights)),
        np.ones(len(heights)),
        np.zeros(len(mesh.faces), np.int32),
    )


def test_labels_of_least_cost_agree_with_trying_all():
    """On a strip of a few vertices every labelling can be tried."""
    mesh = joined(sheet(np.arange(3.0), np.arange(2.0), lambda u, v: (u, v, 0 * u)))
    pixel, planes = np.ones(6), flat_planes(mesh, [0.5, -0.5])
    near = near_planes(mesh, pixel, planes, 2.0, 2)
    planes_of = np.r_[near.plane, 1 - near.plane]
    vertex = np.r_[near.vertex, near.vertex]
    order = np.lexsort((planes_of, vertex))
    near = type(near)(vertex[order], planes_of[order])
    start, neighbour = mesh.adjacency.neighbours()
    o = PlaneLabelOptions(step_cost=0.3, full_step=1.0, rounds=30)
    heights = np.array([0.5, -0.5, 0.0])  # the last is of label -1
    for seed in range(5):
        random = np.random.default_rng(seed)
        cost, none = random.random(len(near.vertex)), random.random(6)
        table = np.c_[cost.reshape(6, 2), none]

        def energy(labels, table=table):
            steps = [
                0.3 * min(abs(heights[labels[v]] - heights[labels[n]]), 1.0)
                for v in range(6) for n in neighbour[start[v] : start[v + 1]] if v < n and labels[v] != labels[n]
            ]  # fmt: skip
            return table[np.arange(6), labels].sum() + sum(steps)

        tried = [energy(np.array(np.unravel_index(i, (3,) * 6))) for i in range(3**6)]
        found = _choose(mesh, pixel, planes, near, cost, none, o)
        assert energy(np.where(found < 0, 2, found)) <= np.percentile(tried, 1)
        one_by_one = energy(table.argmin(1))
        assert energy(np.where(found < 0, 2, found)) <= one_by_one


def test_planes_spread_along_edges_up_to_their_reach():
    mesh = joined(sheet(np.arange(30.0), np.arange(4.0), lambda u, v: (u, v, np.maximum(u - 10, 0) * 0.5)))
    label = np.where(mesh.vertices[mesh.faces][:, :, 0].max(1) <= 10, 0, -1).astype(np.int32)
    planes = Planes(np.array([[0.0, 0, 1]]), np.zeros(1), np.zeros(1), np.ones(1), label)
    for rings, reach, last in ((3, 100.0, 13), (50, 2.0, 14), (0, 100.0, 10)):
        near = near_planes(mesh, np.ones(len(mesh.vertices)), planes, reach, rings)
        assert mesh.vertices[near.vertex, 0].max() == last
        assert (np.diff(near.vertex) > 0).all()


def test_a_vertex_does_not_go_beyond_the_crease_of_its_plane():
    """Of a ridge, the slope that a vertex belongs to ends at the other."""
    across, rise = np.arange(-75, 75.1, 1.5), 0.6
    roof = noisy(joined(sheet(across, LINE, lambda u, v: (u, v, -rise * np.maximum(np.abs(u), 3.0)))), 0.05)
    views = [camera((x, y, 160.0), (0, 75, -20), 240, 200, 190.0, f"{x}{y}") for x in (-90, 90) for y in (0, 150)]
    _, result = extended(roof, views, plain)
    assert result.vertices[:, 2].max() < 0.3, "nothing sticks out above the ridge"
    assert result.vertices[:, 2].max() > -0.3, "and the ridge is sharp again"


def test_labels_are_of_planes_or_none():
    mesh = worn_box()
    pixel = np.ones(len(mesh.vertices))
    flat = flatten_planes(mesh, pixel)
    planes, views = flat.planes, outside_views()
    photos = see_vertices(mesh, pixel, views, lambda number: plain(views[number]))
    label = label_vertices(mesh, pixel, planes, photos, flat.plane)
    assert label.shape == (len(mesh.vertices),)
    assert label.min() >= -1
    assert label.max() < len(planes.normals)


def island(radius, height=1.5, turn=0.0, flattened=False):
    """Labels after islands are filled: a wall of two planes ``turn`` degrees apart, without label within ``radius``.

    If ``flattened``, the wall around has no labels either and was only flattened.
    """
    mesh = joined(sheet(LINE, LINE, lambda u, v: (u, v, height * (np.hypot(u - 75, v - 75) < radius))))
    angle = np.radians(turn)
    normals = np.array([[0, 0, 1.0], [np.sin(angle), 0, np.cos(angle)]])
    planes = Planes(normals, normals @ MIDDLE, np.full(2, 0.1), np.ones(2), np.zeros(len(mesh.faces), np.int32))
    inside = np.hypot(*(mesh.vertices[:, :2] - 75).T) < radius
    wall = np.where(inside, -1, mesh.vertices[:, 0] > 75.1).astype(np.int32)
    none = np.full(len(wall), -1, np.int32)
    label, flat = (none, wall) if flattened else (wall, none)
    result = fill_islands(mesh, np.ones(len(label)), vertex_areas(mesh), planes, label, flat)
    assert np.array_equal(result[~inside], label[~inside])
    return result[inside]


def test_a_small_island_gets_the_plane_around_it():
    assert len(set(island(5.0))) == 1
    assert island(5.0).min() >= 0
    assert island(5.0, turn=3.0).min() >= 0, "two planes of one bowed wall"
    assert island(5.0, flattened=True).min() >= 0, "the wall around is flat, too"


@pytest.mark.parametrize(("radius", "height", "turn"), [(8.0, 1.5, 0.0), (5.0, 3.0, 0.0), (5.0, 1.5, 40.0)])
def test_large_and_tall_islands_and_those_on_edges_stay(radius, height, turn):
    assert (island(radius, height, turn) == -1).all()


def bump(height, radius=15.0, textured=0.0, turn=0.0, flattened=False):
    """Labels after bumps are filled: a wall of two planes, a plateau without label in its middle.

    Of the plateau's area the share ``textured`` shows texture. If ``flattened``, it has a small plane of its own.
    """
    mesh = joined(sheet(LINE, LINE, lambda u, v: (u, v, height * (np.hypot(u - 75, v - 75) < radius))))
    angle = np.radians(turn)
    normals = np.array([[0, 0, 1.0], [np.sin(angle), 0, np.cos(angle)], [0, 0, 1.0]])
    offsets = np.r_[normals[:2] @ MIDDLE, height]
    planes = Planes(normals, offsets, np.full(3, 0.1), np.ones(3), np.zeros(len(mesh.faces), np.int32))
    away = np.hypot(*(mesh.vertices[:, :2] - 75).T)
    inside = away < radius
    label = np.where(inside, -1, mesh.vertices[:, 0] > 75.1).astype(np.int32)
    flat = np.where(inside & flattened, 2, -1).astype(np.int32)
    plain = inside & (away >= radius * np.sqrt(textured))
    area = vertex_areas(mesh) * inside
    result = fill_plain_bumps(mesh, np.ones(len(label)), area, planes, label, flat, plain)
    assert np.array_equal(result[~inside], label[~inside])
    return result[inside]


def test_a_plain_bump_gets_the_plane_around_it():
    assert set(bump(4.0)) <= {0, 1}
    assert set(bump(4.0, textured=0.2)) <= {0, 1}, "a little of it is its rim"
    assert set(bump(4.0, flattened=True)) <= {0, 1}, "its own plane is small"


def test_textured_high_and_bent_bumps_and_dents_stay():
    assert (bump(4.0, textured=0.5) == -1).all()
    assert (bump(7.0) == -1).all(), "beyond the reach of planes"
    assert (bump(4.0, turn=40.0) == -1).all(), "on the edge of two walls"
    assert (bump(-4.0) == -1).all(), "it may be a dark pane"


def test_a_bump_that_no_photo_shows_goes_with_all_its_height():
    """Noise of two grey levels is no texture, though labels alone would leave a bump of four pixels."""
    wall = dented(-5.0, radius=25.0)

    def grainy(view):
        picture = plain(view)
        grain = np.random.default_rng(len(view.name) + int(view.name[0])).normal(0, 1.5, picture.shape)
        return np.clip(picture + grain, 0, 255).astype(np.uint8)

    _, result = extended(wall, cameras(), grainy)
    assert result.vertices[:, 2].max() < 1.0
    _, result = extended(wall, cameras(), textured(wall))
    assert result.vertices[:, 2].max() > 4.5


def dropped(radius, own=0, wider=0.0):
    """Labels after groups are dropped: plane 1 within ``radius`` of the middle of a wall that lies in plane 0.

    Flattening moved the group into plane ``own``, and all within ``wider`` of a corner of the wall into plane 1.
    """
    mesh = joined(sheet(LINE, LINE, lambda u, v: (u, v, np.zeros_like(u))))
    x, y = mesh.vertices[:, :2].T
    inside = np.hypot(x - 75, y - 75) < radius
    label = np.where(inside, 1, -1).astype(np.int32)
    flat = np.where(inside, own, np.hypot(x, y) < wider).astype(np.int32)
    result = drop_islands(mesh, vertex_areas(mesh), label, flat)
    assert (result[~inside] == -1).all()
    return result[inside]


def test_a_small_group_in_another_plane_than_it_was_flattened_into_goes_back():
    assert (dropped(1.0) == -1).all(), "one vertex"
    assert (dropped(5.0) == -1).all()


def test_large_groups_planes_of_their_own_and_ends_of_large_planes_stay():
    assert (dropped(8.0) == 1).all()
    assert (dropped(5.0, own=1) == 1).all(), "flattening found that plane, too"
    assert (dropped(5.0, wider=103.0) == 1).all(), "the plane goes on beside the group"


def test_borders_of_walls_that_were_only_flattened_become_straight():
    """Where no vertex is labelled with a plane, flattened ones are moved along the borders all the same."""
    random = np.random.default_rng(0)

    def window(u, v):
        away = np.maximum(np.abs(u - 75), np.abs(v - 75)) + random.normal(0, 1.0, u.shape)
        return u, v, -6.0 * (away < 30)

    wall = joined(sheet(LINE, LINE, window))
    no_labels = PlaneLabelOptions(no_plane_cost=0.0, island_area=0.0)
    flat, result = extended(wall, cameras(), plain, PlaneExtensionOptions(labels=no_labels))
    assert not result.values[ON_PLANE].any()
    moved = np.linalg.norm(result.vertices - flat.vertices, axis=1) > 1e-9
    assert np.abs(result.vertices - flat.vertices)[:, 2].max() < 1e-9, "within wall and pane"
    moved &= flat.vertices[:, 2] > -1
    assert moved.sum() > 50
    before, after = (np.abs(mesh.vertices[moved, :2] - 75).max(1).clip(25, 35) for mesh in (flat, result))
    assert after.std() < 0.85 * before.std()
