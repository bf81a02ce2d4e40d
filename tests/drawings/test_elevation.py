# SPDX-License-Identifier: GPL-3.0-or-later
"""The lines of a wall with a niche: its outline, and the niche as a rectangle."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from mgf_engine.drawings.elevation import classify, draw_elevation
from mgf_engine.drawings.model import CREASE, DETAIL, OUTLINE, STEP, DrawingFrame
from mgf_engine.drawings.project import Grid
from mgf_engine.drawings.regions import LOOSE, NOTHING, RegionMap, survey_planes
from mgf_engine.drawings.trace import Chain
from mgf_engine.geometry.clean import face_areas
from mgf_engine.geometry.rasterize import face_normals
from mgf_engine.model.mesh import Mesh

PIXEL, CELL = 0.02, 0.05
WIDTH, HEIGHT = 4.0, 3.0
NICHE = (1.5, 1.0, 2.5, 2.2)  # left, low, right, high


def wall(depth: float) -> SimpleNamespace:
    """A survey of a wall in the plane y = 0, seen from -y, with a niche of a depth; z is up."""
    x, z = np.meshgrid(np.arange(0, WIDTH + CELL / 2, CELL), np.arange(0, HEIGHT + CELL / 2, CELL))
    left, low, right, high = NICHE
    inside = (x > left - 1e-9) & (x < right + 1e-9) & (z > low - 1e-9) & (z < high + 1e-9)
    vertices = np.stack([x.ravel(), np.where(inside, depth, 0.0).ravel(), z.ravel()], 1)
    number = np.arange(x.size).reshape(x.shape)
    a, b, c, d = (part.ravel() for part in (number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.int32)
    mesh = Mesh(vertices, faces, np.zeros((len(vertices), 3), np.uint8))
    return SimpleNamespace(mesh=mesh, normals=face_normals(mesh), areas=face_areas(mesh), working_pixel=PIXEL)


def lines_of(depth: float) -> tuple[dict[str, list[np.ndarray]], list[np.ndarray]]:
    survey = wall(depth)
    x, _, up = np.eye(3)
    frame = DrawingFrame("A", np.zeros(3), x, up, np.zeros(2), np.array([WIDTH, HEIGHT]))
    drawing = draw_elevation(survey, survey_planes(survey), frame)  # type: ignore[arg-type]
    layers: dict[str, list[np.ndarray]] = {}
    for line in drawing.lines:
        layers.setdefault(line.layer, []).append(line.points)
    return layers, drawing.openings


def box_of(lines: list[np.ndarray]) -> np.ndarray:
    at = np.concatenate(lines)
    return np.concatenate([at.min(0), at.max(0)])


def test_a_niche_is_a_rectangle_in_its_outline() -> None:
    layers, openings = lines_of(0.5)
    assert set(layers) == {OUTLINE, STEP} and len(layers[OUTLINE]) == len(layers[STEP]) == 4
    np.testing.assert_allclose(box_of(layers[OUTLINE]), (0, 0, WIDTH, HEIGHT), atol=PIXEL)
    np.testing.assert_allclose(box_of(layers[STEP]), NICHE, atol=CELL)
    assert len(openings) == 1
    np.testing.assert_allclose(openings[0], box_of(layers[STEP]), atol=1e-9)


@pytest.mark.parametrize("depth", [0.0, 0.5 * PIXEL])
def test_what_is_no_deeper_than_the_noise_is_not_drawn(depth: float) -> None:
    layers, openings = lines_of(depth)
    assert set(layers) == {OUTLINE} and not openings


@pytest.mark.parametrize(
    "low,high,slope,layer",
    [
        (NOTHING, 1, (0.0, 0.0, 0.0), OUTLINE),
        (NOTHING, LOOSE, (0.0, 0.0, 0.0), OUTLINE),
        (1, LOOSE, (0.0, 0.0, 0.0), DETAIL),
        (1, 2, (0.0, 0.0, 2.1 * PIXEL), STEP),
        (1, 2, (0.0, 0.0, -2.1 * PIXEL), STEP),
        (1, 2, (0.0, 0.0, 1.9 * PIXEL), None),
        (1, 2, (np.tan(np.radians(10.0)), 0.0, 0.0), CREASE),
        (1, 2, (np.tan(np.radians(8.0)), 0.0, 0.0), None),
    ],
)
def test_borders_have_their_layer_by_what_lies_beside_them(low: int, high: int, slope, layer: str | None) -> None:
    """An upright border at x = 0 of the plane of the drawing and another plane."""
    x, _, up = np.eye(3)
    frame = DrawingFrame("A", np.zeros(3), x, up, np.zeros(2), np.ones(2))
    regions = RegionMap(
        Grid(frame, PIXEL, 0.0, 1.0, 50, 50), np.zeros((50, 50), np.int32), np.array([(0, 0, 0), slope])
    )
    chain = Chain(np.array([[0.0, 5.0], [0.0, 45.0]]), low, high, (0, 1))
    assert classify(chain, regions, PIXEL) == layer
    short = Chain(np.array([[0.0, 5.0], [0.0, 16.0]]), low, high, (0, 1))
    assert classify(short, regions, PIXEL) == (None if layer == DETAIL else layer)
