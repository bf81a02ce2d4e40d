# SPDX-License-Identifier: GPL-3.0-or-later
"""The similarity that aligns a scene to control points, and what is said where they do not fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.analytic import camera
from support.small_scene import make_scene

from mgf_engine.errors import BadInput
from mgf_engine.georef.control_points import CHECK, CONTROL, ControlPoint, Mark
from mgf_engine.georef.fit_control import ControlFit, control_rows, fit_control, mark_error
from mgf_engine.georef.similarity import matrix_of, transform_points
from mgf_engine.georef.triangulate import TriangulatedPoint
from mgf_engine.model.scene import Scene

OFFSET = np.array([600_000.0, 5_500_000.0, 0.0])
TRUE = matrix_of(3.0, Rotation.from_rotvec([0, 0, 0.4]).as_matrix(), np.array([5.0, -2.0, 120.0]))
UP = np.array([0.0, 0.0, 1.0])
PLACES = np.array([[0.0, 0, 0], [2, 0, 0.3], [2, 2, 0], [0, 2, 0.6], [1, 1, 1.5]])
NAMES = ("A", "B", "C", "D", "E")


def scene() -> Scene:
    views = [camera((6.0 * np.cos(a), 6.0 * np.sin(a), 2.0), name=f"{a}.png") for a in (0.0, 0.8, 2.0)]
    return make_scene(views, np.zeros((0, 3)), [])


def placed(name: str, position: np.ndarray) -> TriangulatedPoint:
    marks = tuple(Mark(name, k, (10.0, 10.0)) for k in range(3))
    return TriangulatedPoint(name, position, marks, np.tile([0.3, 0.4], (3, 1)), np.ones(3, bool))


MARKED = {name: placed(name, at) for name, at in zip(NAMES, PLACES, strict=True)}


def points(**moves: tuple[float, float, float]) -> list[ControlPoint]:
    """The true control points, some of them moved by metres."""
    world = transform_points(TRUE, PLACES) + OFFSET
    return [ControlPoint(n, tuple((at + moves.get(n, (0, 0, 0))).tolist())) for n, at in zip(NAMES, world, strict=True)]


def fit(given: list[ControlPoint], up: np.ndarray | None = UP) -> ControlFit:
    failed = {p.name: "its rays do not meet" for p in given if p.name not in MARKED}
    return fit_control(scene(), given, MARKED, failed, up)


def test_too_few_points_are_refused_with_the_reason_for_one() -> None:
    with pytest.raises(BadInput, match=r"Only 2 control points can be placed \('X': its rays do not meet\)"):
        fit([*points()[:2], ControlPoint("X", (0.0, 0.0, 0.0))])
    with pytest.raises(BadInput, match="All 5 points are check points"):
        fit([replace(p, role=CHECK) for p in points()])


def test_points_on_a_line_are_refused() -> None:
    line = {n: placed(n, np.array([k, 0.0, 0.0])) for k, n in enumerate(NAMES)}
    known = [ControlPoint(n, (3.0 * k, 0.0, 0.0)) for k, n in enumerate(NAMES)]
    with pytest.raises(BadInput, match="lie on a line"):
        fit_control(scene(), known, line, {}, UP)


def test_swapped_columns_wrong_heights_and_wrong_marks_are_told_apart() -> None:
    swapped = [replace(p, position=(p.position[1], p.position[0], p.position[2])) for p in points()]
    with pytest.raises(BadInput, match="East and north of the control points seem swapped"):
        fit(swapped)
    with pytest.raises(BadInput, match="stand on its head"):
        fit(points(), -UP)
    with pytest.raises(BadInput, match=r"do not fit their marks: off by .*'C' most"):
        fit(points(A=(3, 0, 0), B=(0, -4, 0), C=(9, 9, 9), D=(0, 0, 5)))


def test_half_of_the_points_are_no_majority() -> None:
    """Three of six fit, and three of five do."""
    marked = {**MARKED, "F": placed("F", np.array([1.5, 0.5, 0.8]))}
    wrong = {"D": (4.0, 0.0, 1.0), "E": (0.0, -5.0, 2.0)}
    assert [row.used for row in fit(points(**wrong)).rows] == [True, True, True, False, False]
    last = transform_points(TRUE, marked["F"].position) + OFFSET + (3.0, 6.0, 0.0)
    with pytest.raises(BadInput, match="do not fit their marks"):
        fit_control(scene(), [*points(**wrong), ControlPoint("F", tuple(last.tolist()))], marked, {}, UP)


def test_exact_points_give_the_similarity() -> None:
    found = fit(points())
    world = transform_points(found.matrix, PLACES) + found.offset
    np.testing.assert_allclose(world, transform_points(TRUE, PLACES) + OFFSET, atol=1e-6)
    np.testing.assert_allclose(found.matrix[:3, :3], TRUE[:3, :3], atol=1e-8)
    assert found.offset[2] == 0 and (found.offset % 1 == 0).all()
    assert found.rms(CHECK) is None and (found.rms(CONTROL) < 1e-6).all()


def test_an_outlier_is_left_out_with_its_residual_and_a_note() -> None:
    found = fit(points(D=(0.0, 1.5, 0.0)))
    row = found.rows[3]
    assert [r.used for r in found.rows] == [True, True, True, False, True]
    np.testing.assert_allclose(row.residual, (0.0, -1.5, 0.0), atol=1e-6)
    assert row.note == "does not fit the others, left out" and row.distance == pytest.approx(1.5)
    assert row.pixels == pytest.approx(0.5) and row.photos == 3
    assert (found.rms(CONTROL) < 1e-6).all()  # those that were left out do not count


def test_check_points_are_measured_and_do_not_pull() -> None:
    given = points(E=(0.1, 0.2, -0.2))
    given[4] = replace(given[4], role=CHECK)
    found = fit(given)
    np.testing.assert_allclose(found.rms(CHECK), (0.1, 0.2, 0.2), atol=1e-6)
    assert not found.rows[4].used and found.rows[4].note == ""


def test_rows_name_what_was_not_placed_and_marks_on_another_point() -> None:
    swapped = {**MARKED, "D": placed("D", PLACES[0])}
    rows = control_rows([*points(), ControlPoint("X", (0.0, 0, 0))], swapped, {}, TRUE, OFFSET, {"A", "B", "C"})
    assert rows[3].note.endswith("left out; its marks lie on 'A'") and rows[4].note.endswith("left out")
    assert rows[5].note == "not marked in any photo" and np.isnan(rows[5].distance) and rows[5].photos == 0


def test_the_error_of_marks_shrinks_with_their_number() -> None:
    """Half a pixel at a distance d is 0.5 d / f; three photos leave 1 / sqrt(3) of that."""
    views = scene().views
    away = np.mean([np.linalg.norm(v.centre) / v.fx for v in views])
    origin = placed("A", np.zeros(3))
    assert mark_error(scene(), origin, 0.5) == pytest.approx(0.5 * away / np.sqrt(3))
    one = replace(origin, good=np.array([True, False, False]))
    assert mark_error(scene(), one, 0.5) == pytest.approx(0.5 * np.linalg.norm(views[0].centre) / views[0].fx)
