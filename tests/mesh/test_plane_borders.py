# SPDX-License-Identifier: GPL-3.0-or-later
"""Moves into planes end without steps and folds."""

import numpy as np
import pytest

from mgf_engine.mesh.plane_borders import PlaneBorderOptions, fade_moves, slope_steps, smooth_borders, undo_folds
from mgf_engine.mesh.plane_detection import Planes
from tests.support.sheets import joined, sheet

LINE = np.arange(0, 61.0, 1.5)


def wall():
    return joined(sheet(LINE, LINE, lambda u, v: (u, v, 0 * u)))


def undone(mesh, before, at, label):
    """Folds taken back where all faces have the plane z = 0 (label 0) or none (-1)."""
    labels = np.full(len(mesh.faces), label, np.int32)
    return undo_folds(
        mesh, before, at, Planes(np.array([[0, 0, 1.0]]), np.zeros(1), np.full(1, 0.1), np.ones(1), labels), labels
    )


def two_planes(step, turn=0.0):
    """A wall in z = 0 whose right half gets the label of a plane ``step`` in front, turned by ``turn`` degrees."""
    mesh, angle = wall(), np.radians(turn)
    label = (mesh.vertices[:, 0] > 30.1).astype(np.int32)
    normals = np.array([[0, 0, 1.0], [np.sin(angle), 0, np.cos(angle)]])
    offsets = np.array([0.0, step + normals[1] @ [30, 30, 0]])
    return mesh, Planes(normals, offsets, np.full(2, 0.1), np.ones(2), np.zeros(len(mesh.faces), np.int32)), label


def slopes(step, turn=0.0, single=None, options=PlaneBorderOptions()):
    mesh, planes, label = two_planes(step, turn)
    single = np.ones(len(label), bool) if single is None else single(mesh)
    return mesh, label, slope_steps(mesh, np.ones(len(label)), planes, label, single, options)


def test_a_small_step_becomes_a_slope():
    mesh, label, moves = slopes(0.6)
    height = 0.6 * label + moves[:, 2]
    along = np.abs(mesh.vertices[:, 1] - 30) < 0.1
    order = np.argsort(mesh.vertices[along, 0])
    profile = height[along][order]
    assert np.abs(np.diff(profile)).max() < 0.2, "no step of 0.6 any more"
    assert (np.diff(profile) > -1e-9).all()
    assert profile[0] == pytest.approx(0, abs=0.02)
    assert profile[-1] == pytest.approx(0.6, abs=0.02)


@pytest.mark.parametrize(("step", "turn"), [(1.6, 0.0), (5.0, 0.0), (0.6, 40.0)])
def test_high_steps_and_edges_stay(step, turn):
    assert not slopes(step, turn)[2].any()


def test_vertices_in_two_planes_stay():
    _, _, moves = slopes(0.6, single=lambda mesh: np.abs(mesh.vertices[:, 0] - 30) > 5)
    assert not moves.any()


def test_vertices_without_plane_stay():
    mesh, planes, label = two_planes(0.6)
    label[:] = -1
    assert not slope_steps(mesh, np.ones(len(label)), planes, label, np.ones(len(label), bool)).any()


def smoothed_window(half, options=PlaneBorderOptions(), free=None):
    """A wall with a window of 2 ``half`` around its middle, the ragged border of which is smoothed.

    Returns the vertices before and after, which lie on the window's border, and which on a smoothed curve.
    """
    mesh = wall()
    away = np.abs(mesh.vertices[:, :2] - 30).max(1)
    label = np.where((away[mesh.faces] > half - 0.1).all(1), 0, -1).astype(np.int32)
    border = np.abs(away - half) < 0.1
    before = mesh.vertices + np.random.default_rng(0).uniform(-0.6, 0.6, mesh.vertices.shape) * [1, 1, 0]
    free = (away < 28) if free is None else free(away)  # the wall's own border stays
    flat = np.array([1, 1, 0])
    after, curve = smooth_borders(mesh, before, label, free, lambda at: at * flat, options)
    return before, after, border, curve


def ragged(at, half):
    """Root mean square of the distances of a border's vertices from the window's outline, corners left out."""
    sides = np.sort(np.abs(at[:, :2] - 30), axis=1)
    side = sides[:, 0] < half - 3
    return float(np.sqrt(((sides[side, 1] - half) ** 2).mean()))


def test_ragged_borders_of_windows_become_straight_and_keep_their_size():
    before, after, border, curve = smoothed_window(12)
    assert not (curve & ~border).any(), "the window's border, and nothing else"
    assert curve.sum() >= border.sum() - 2, "but for corners that a diagonal cuts off"
    assert ragged(after[border], 12) < 0.7 * ragged(before[border], 12)
    middle = np.abs(after[border, :2] - 30).max(1).mean()
    assert middle == pytest.approx(12, abs=0.25), "no shrinking"
    assert not after[:, 2].any(), "within the plane"
    assert np.array_equal(after[~border], before[~border])


@pytest.mark.parametrize(
    ("half", "options", "free"),
    [
        (12, PlaneBorderOptions(smooth_rounds=0), None),
        (3, PlaneBorderOptions(), None),  # an island of 16 vertices
        (12, PlaneBorderOptions(), lambda away: (away > 13) & (away < 28)),
    ],
)
def test_borders_stay(half, options, free):
    before, after, _, _ = smoothed_window(half, options, free)
    assert np.array_equal(after, before)


def faded(height, options=PlaneBorderOptions()):
    """Heights along the wall's middle, where its left half was moved by ``height``."""
    mesh = wall()
    fixed = mesh.vertices[:, 0] < 30
    moves = fade_moves(mesh, np.where(fixed, height, 0.0)[:, None] * [0, 0, 1.0], fixed, options)
    along = np.abs(mesh.vertices[:, 1] - 30) < 0.1
    order = np.argsort(mesh.vertices[along, 0])
    return mesh.vertices[along, 0][order], moves[along, 2][order]


def test_moves_fade_out_over_neighbours():
    x, height = faded(-1.0)
    assert (height[x < 30] == -1).all()
    free = height[x >= 30]
    assert (np.diff(free) >= 0).all(), "ever smaller"
    assert free[0] < -0.4
    assert free[-1] == 0


def test_moves_outwards_fade_sooner():
    x, inward = faded(-1.0)
    _, outward = faded(1.0)
    free = x >= 30
    assert (outward[free] <= -inward[free]).all()
    assert 0 < outward[free][0] < -inward[free][0] / 2


def test_no_rounds_fade_nothing():
    x, height = faded(-1.0, PlaneBorderOptions(fade_rounds=0))
    assert not height[x >= 30].any()


@pytest.mark.parametrize("label", [-1, 0])
def test_a_fold_is_taken_back_and_the_rest_stays(label):
    mesh = wall()
    at = mesh.vertices + np.array([0, 0, 0.5])
    middle = int(np.linalg.norm(mesh.vertices - [30, 30, 0], axis=1).argmin())
    at[middle, 0] += 5  # over its neighbours
    result, kept = undone(mesh, mesh.vertices, at, label)
    assert np.linalg.norm(result[middle] - mesh.vertices[middle]) < 1.5, "within its neighbours"
    assert np.flatnonzero(~kept).tolist() == [middle]
    others = np.arange(len(at)) != middle
    assert np.array_equal(result[others], at[others])


@pytest.mark.parametrize("label", [-1, 0])
def test_nothing_is_taken_back_without_folds(label):
    mesh = wall()
    at = mesh.vertices + np.random.default_rng(0).normal(0, 0.05, mesh.vertices.shape)
    result, kept = undone(mesh, mesh.vertices, at, label)
    assert kept.all()
    assert np.array_equal(result, at)


@pytest.mark.parametrize("label", [-1, 0])
def test_faces_that_a_crease_leaves_without_area_are_not_turned(label):
    mesh = wall()
    at = mesh.vertices.copy()
    strip = np.abs(at[:, 0] - 31) < 1.2  # of two columns, whose vertices all go onto one line
    assert len(np.unique(at[strip, 0])) == 2
    at[strip, 0] = 30 + np.random.default_rng(0).normal(0, 1e-14, strip.sum())  # rounding gives them any direction
    result, kept = undone(mesh, mesh.vertices, at, label)
    assert kept.all()
    assert np.array_equal(result, at)


def test_an_overhanging_dent_goes_into_its_plane():
    mesh = wall()
    before = mesh.vertices.copy()
    middle = int(np.linalg.norm(before - [30, 30, 0], axis=1).argmin())
    before[middle] += [5, 0, -3]  # beneath its neighbours
    result, kept = undone(mesh, before, mesh.vertices, 0)
    assert kept.all()
    assert np.array_equal(result, mesh.vertices)
