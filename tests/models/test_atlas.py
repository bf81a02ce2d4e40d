# SPDX-License-Identifier: GPL-3.0-or-later
"""Textures of levels of detail: every pixel takes the colour of the full mesh at its place."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from mgf_engine.evaluation.surfaces import Surface
from mgf_engine.model.mesh import Mesh, Texture
from mgf_engine.models.atlas import CHUNK_FACES, AtlasOptions, _chunks, _shrunk, colors_at, transfer_texture


def sheet(count: int) -> Mesh:
    """A square of 1 x 1 in ``count`` x ``count`` squares of two faces."""
    x, y = np.meshgrid(np.linspace(0, 1, count + 1), np.linspace(0, 1, count + 1))
    vertices = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    a = (np.arange(count)[:, None] * (count + 1) + np.arange(count)).ravel()
    faces = np.concatenate([np.stack([a, a + 1, a + count + 2], 1), np.stack([a, a + count + 2, a + count + 1], 1)])
    return Mesh(vertices, faces.astype(np.int32), np.zeros(vertices.shape, np.uint8))


def painted(mesh: Mesh, size: int = 256) -> Texture:
    """Red grows along x and green along y."""
    ramp = np.round(np.linspace(0, 255, size)).astype(np.uint8)
    image = np.zeros((size, size, 3), np.uint8)
    image[..., 0], image[..., 1] = ramp[None], ramp[::-1, None]  # the first row is the top
    return Texture(mesh.vertices[mesh.faces][..., :2].astype(np.float32), image)


def test_a_coarse_mesh_shows_the_same_picture() -> None:
    full, coarse = sheet(8), sheet(1)
    made = transfer_texture(coarse, full, painted(full), 256)
    rng = np.random.default_rng(0)
    surface = Surface(coarse.vertices, coarse.faces.astype(np.int64))
    points, face = surface.sample(500, rng)
    colors = colors_at(points, face, surface, made).astype(float)
    assert np.abs(colors[:, :2] - 255 * points[:, :2]).mean() < 3
    assert made.image.shape[1] == 256 and made.uv.min() >= 0 and made.uv.max() <= 1


def test_a_picture_is_never_smaller_than_the_option_says() -> None:
    full = sheet(2)
    shares = list[float]()
    made = transfer_texture(sheet(1), full, painted(full), 16, shares.append, AtlasOptions(least_side=128))
    assert made.image.shape[1] == 128 and shares == [0.0]


def test_colors_of_points_are_those_of_the_texture_there() -> None:
    mesh = sheet(1)
    surface = Surface(mesh.vertices, mesh.faces.astype(np.int64))
    spots = np.array([(0.75, 0.25, 0.0), (0.25, 0.75, 0.0), (0.5, 0.1, 0.4)])  # the last one above its face
    colors = colors_at(spots, np.array([0, 1, 0]), surface, painted(mesh)).astype(int)
    assert np.abs(colors[:, :2] - np.array([(191, 64), (64, 191), (127, 25)])).max() <= 2


def test_faces_are_taken_in_chunks_that_lie_together() -> None:
    middles = np.random.default_rng(0).uniform(0, (100, 1, 1), (3 * CHUNK_FACES, 3))
    chunks = _chunks(middles)
    assert sorted(np.concatenate(chunks).tolist()) == list(range(len(middles)))
    assert max(len(rows) for rows in chunks) <= CHUNK_FACES
    spans = sorted((middles[rows, 0].min(), middles[rows, 0].max()) for rows in chunks)
    assert all(first[1] <= second[0] for first, second in pairwise(spans))


@pytest.mark.parametrize(("pixels", "side"), [(256 * 256, 256), (64 * 64, 64), (4, 64)])
def test_a_texture_is_reduced_to_what_is_asked_for_but_not_below_a_quarter(pixels: int, side: int) -> None:
    found = _shrunk(painted(sheet(1)), pixels, AtlasOptions(shrink=4.0))
    assert found.image.shape[0] == pytest.approx(side, abs=1)
