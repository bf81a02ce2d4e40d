# SPDX-License-Identifier: GPL-3.0-or-later
"""Blocks of faces, and which of them may show in a part of a picture."""

from __future__ import annotations

import numpy as np
from support.analytic import camera

from mgf_engine.mesh.face_clusters import SIZE, Blocks

#: Looks along y from 4 away: x = -1, 0, 1 fall on u = 35, 80, 125 of 160.
VIEW = camera((0.0, -4.0, 0.0))


def patches(*places: float) -> tuple[np.ndarray, np.ndarray]:
    """A block of equal small triangles at each place along x; vertices [N, 3], faces [F, 3]."""
    corners = np.array([[-0.1, 0, -0.1], [0.1, 0, -0.1], [0, 0, 0.1]])
    vertices = np.concatenate([corners + np.array([x, 0, 0]) for x in places])
    faces = np.repeat(np.arange(len(vertices), dtype=np.int32).reshape(-1, 3), SIZE, axis=0)
    return vertices, faces


def test_the_last_block_repeats_its_last_face() -> None:
    vertices, faces = patches(-1.0, 1.0)
    blocks = Blocks.of(vertices, faces[:-5])
    assert blocks.faces.shape == (2, SIZE, 3) and (blocks.faces[1, -6:] == faces[-6]).all()
    assert blocks.boxes.shape == (16, 3)
    assert np.allclose(blocks.boxes[:8].min(0), [-1.1, 0, -0.1]) and np.allclose(
        blocks.boxes[:8].max(0), [-0.9, 0, 0.1]
    )


def test_only_blocks_over_wanted_pixels_are_found() -> None:
    blocks = Blocks.of(*patches(-1.0, 0.0, 1.0))
    wanted = np.zeros((VIEW.height, VIEW.width), bool)
    assert blocks.touching(VIEW, wanted).tolist() == []
    wanted[64, 35] = True
    assert blocks.touching(VIEW, wanted).tolist() == [0]
    wanted[64, 125] = True
    assert blocks.touching(VIEW, wanted).tolist() == [0, 2]


def test_a_block_behind_the_camera_shows_nowhere_and_one_around_it_may_show_anywhere() -> None:
    everywhere, corner = np.ones((2, VIEW.height, VIEW.width), bool)
    corner[:, 1:], corner[1:] = False, False
    vertices, faces = patches(0.0)
    assert Blocks.of(vertices - np.array([0, 8, 0]), faces).touching(VIEW, everywhere).tolist() == []
    around = np.array([[-0.1, -5, 0], [0.1, -3, 0], [0, -4, 0.1]])
    assert Blocks.of(around, faces).touching(VIEW, corner).tolist() == [0]
