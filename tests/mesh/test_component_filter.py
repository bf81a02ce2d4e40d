# SPDX-License-Identifier: GPL-3.0-or-later
from __future__ import annotations

import numpy as np
import pytest
from support.analytic import camera, cuboid

from mgf_engine.geometry.clean import face_areas
from mgf_engine.mesh.component_filter import ComponentFilterOptions, confirmed_parts, faces_near_clicks
from mgf_engine.model.mesh import Mesh

SIDE = 1.0
VIEWS = [camera((0.0, -12.0, 4.0), (2.0, 0.0, 0.0)), camera((12.0, -9.0, 4.0), (2.0, 0.0, 0.0))]


def row(*places: float) -> Mesh:
    """Cubes along the x axis, as many parts."""
    cubes = [cuboid((SIDE / 2,) * 3) for _ in places]
    starts = np.cumsum([0, *(len(c.vertices) for c in cubes)])
    return Mesh(
        np.concatenate([c.vertices + np.array([x, 0, 0]) for c, x in zip(cubes, places, strict=True)]),
        np.concatenate([c.faces + s for c, s in zip(cubes, starts, strict=False)]).astype(np.int32),
        np.concatenate([c.colors for c in cubes]),
    )


def clicked(*places: float) -> list[np.ndarray]:
    """Clicks of the first view on cubes; the second view has none."""
    return [VIEWS[0].project(np.array([(x, 0.0, 0.0) for x in places]).reshape(-1, 3))[0], np.zeros((0, 2))]


GAP = 0.9 * ComponentFilterOptions().near * SIDE * 3**0.5  # just near to a cube


@pytest.mark.parametrize(
    ("places", "clicks", "expected"),
    [
        ((0.0, 3.0), (0.0,), 1),
        ((0.0, 3.0), (3.0,), 1),
        ((0.0, 3.0), (0.0, 3.0), 2),
        ((0.0, 1 + GAP), (0.0,), 2),  # near: a tree may hide what joins them
        ((0.0, 1 + GAP, 2 + 2 * GAP, 5.0), (0.0,), 3),  # near to what is near
        ((-1 - GAP, 0.0, 1 + GAP), (0.0,), 3),  # on both sides, joined in one round
    ],
)
def test_parts_belong_that_were_clicked_or_are_near(
    places: tuple[float, ...], clicks: tuple[float, ...], expected: int
) -> None:
    mesh = row(*places)
    assert faces_near_clicks(mesh, VIEWS, clicked(*clicks)).sum() == expected * len(mesh.faces) / len(places)


def test_the_clicked_part_is_the_one_that_stays() -> None:
    mesh = row(0.0, 3.0)
    stays = faces_near_clicks(mesh, VIEWS, clicked(3.0))
    assert mesh.vertices[mesh.faces[stays]][..., 0].min() > 2


def test_everything_belongs_where_no_click_meets_the_mesh() -> None:
    mesh = row(0.0, 3.0)
    assert faces_near_clicks(mesh, VIEWS, [np.array([[0.5, 0.5]]), np.zeros((0, 2))]).all()
    assert faces_near_clicks(mesh, VIEWS, [np.zeros((0, 2))] * 2).all()


def test_a_small_part_stays_where_photos_confirm_it_and_a_speck_does_not() -> None:
    mesh = row(0.0, 3.0, 6.0, 9.0)
    cube = np.arange(len(mesh.faces)) // (len(mesh.faces) // 4)
    speck = np.isin(np.arange(len(mesh.vertices)), mesh.faces[cube == 3])
    mesh.vertices[speck] = (mesh.vertices[speck] - [9.0, 0, 0]) * 0.01 + [9.0, 0, 0]
    asked: list[np.ndarray] = []

    def confidence(points: np.ndarray) -> np.ndarray:
        asked.append(points)
        return np.where(points[:, 0] > 5, 0.6, 0.3)

    kept = confirmed_parts(mesh, cube > 0, confidence)
    assert face_areas(mesh)[cube == 3].sum() < ComponentFilterOptions().confirmed * face_areas(mesh)[cube == 0].sum()
    assert (kept == (cube == 2)).all()
    assert np.concatenate(asked)[:, 0].min() > 2  # of large parts nothing is asked


def test_confidence_is_the_mean_over_the_area_of_a_part() -> None:
    mesh = row(0.0, 3.0)
    asked = np.arange(len(mesh.faces)) >= len(mesh.faces) // 2
    o = ComponentFilterOptions(confidence=0.5)

    def right(above: float) -> bool:
        return bool(confirmed_parts(mesh, asked, lambda at: np.where(at[:, 2] > 0, above, 0.4), o)[asked].all())

    assert right(0.61)
    assert not right(0.59)
    assert not confirmed_parts(mesh, ~asked & asked, lambda at: np.ones(len(at)), o).any()
