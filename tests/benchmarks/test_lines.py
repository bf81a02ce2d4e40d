# SPDX-License-Identifier: GPL-3.0-or-later
"""True edges of a mesh seen along parallel rays, and drawn lines against them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from benchmarks.lines import compare, main, true_edges
from mgf_engine.drawings.model import OUTLINE, STEP, DrawingFrame, Polyline

PIXEL = 0.1
UP = np.array([0.0, 0.0, 1.0])


def block_before_a_wall(depth: float) -> tuple[np.ndarray, np.ndarray, DrawingFrame]:
    """A wall of 4 x 3 with a block of 1 x 1 that stands so far before it; vertices in drawing coordinates."""
    wall, block = trimesh.creation.box((4, 3, 1)), trimesh.creation.box((1, 1, 1))
    wall.apply_translation((2, 1.5, -0.5))
    block.apply_translation((1.5, 1.5, depth - 0.5))
    mesh = trimesh.util.concatenate([wall, block])
    return (
        mesh.vertices,
        mesh.faces,
        DrawingFrame("A", np.zeros(3), np.array([1.0, 0, 0]), UP, np.zeros(2), np.array([4, 3])),
    )


def square(low: tuple[float, float], high: tuple[float, float], layer: str) -> Polyline:
    (a, b), (c, d) = low, high
    return Polyline(np.array([[a, b], [c, b], [c, d], [a, d], [a, b]]), layer)


@pytest.mark.parametrize("depth,every,large", [(0.5, True, True), (0.2, True, False), (0.02, False, False)])
def test_outlines_and_steps_are_edges(depth: float, every: bool, large: bool) -> None:
    edges = true_edges(*block_before_a_wall(depth), PIXEL)
    for points, stepped in zip(edges, (every, large), strict=True):
        on_block = (np.abs(points - (1.5, 1.5)).max(1) < 0.7) & (np.abs(points - (1.5, 1.5)).max(1) > 0.3)
        assert on_block.any() == stepped
        far = np.minimum(np.abs(points), np.abs(points - (4, 3))).min(1)
        assert far[~on_block].max() < 0.3 * PIXEL and (~on_block).sum() == pytest.approx(14 / (0.25 * PIXEL), rel=0.02)


def test_a_slope_is_no_step() -> None:
    vertices, faces, frame = block_before_a_wall(0.02)
    slanted = vertices + np.column_stack([np.zeros((len(vertices), 2)), 2.0 * vertices[:, 0]])
    points = true_edges(slanted, faces, frame, PIXEL)[1]
    assert np.minimum(np.abs(points), np.abs(points - (4, 3))).min(1).max() < 0.3 * PIXEL


def test_lines_are_precise_where_edges_are_and_edges_without_lines_are_missed() -> None:
    edges = true_edges(*block_before_a_wall(0.5), PIXEL)
    outline = square((0, 0), (4, 3), OUTLINE)
    whole = compare([outline, square((1, 1), (2, 2), STEP)], edges, PIXEL)
    assert whole.row() == ["2", "100.0 %", "100.0 %", "100.0 %", "0"]
    off = compare([outline, square((1.15, 1), (2.15, 2), STEP)], edges, PIXEL)
    assert (off.distance <= 1).mean() == pytest.approx(16.3 / 18, abs=0.02) and (off.distance <= 2).all()
    missing = compare([outline], edges, PIXEL)
    assert (missing.missed <= 2).mean() == pytest.approx(14 / 18, abs=0.01)
    assert compare([outline, square((3, 0.8), (3.2, 2.2), STEP)], edges, PIXEL).row()[-1] == "32"


def test_what_is_no_job_is_refused_in_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert error.startswith("Error: ") and error.count("\n") == 1 and str(tmp_path) in error
