# SPDX-License-Identifier: GPL-3.0-or-later
"""Mixing of two photos beside the seam between them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.small_scene import view

from mgf_engine.geometry.rasterize import draw_triangles
from mgf_engine.model.mesh import Mesh
from mgf_engine.texture.bake import bake
from mgf_engine.texture.blending import BlendOptions, find_bands
from mgf_engine.texture.model import NO_VIEW, Layout
from mgf_engine.texture.painting import Originals, Painting
from mgf_engine.texture.seams import Corrections
from mgf_engine.texture.view_selection import patches
from mgf_engine.texture.visibility import ShownFaces, VisibilityOptions

#: A strip of four triangles, 30 px wide each square; the seam is the edge between vertices 2 and 3, at x = 0.
VERTICES = np.array([[-1, -0.5, 1], [-1, 0.5, 1], [0, -0.5, 1], [0, 0.5, 1], [1, -0.5, 1], [1, 0.5, 1]], float)
FACES = np.array([[0, 1, 2], [1, 3, 2], [2, 3, 4], [3, 5, 4]], np.int32)
NEIGHBOURS = np.array([[0, 1], [1, 2], [2, 3]])
PLACES = np.array([[10, 10], [10, 40], [40, 10], [40, 40]], float)
LAYOUT = Layout(
    160, 64, np.concatenate([PLACES[[[0, 1, 2], [1, 3, 2]]], PLACES[[[0, 1, 2], [1, 3, 2]]] + (80, 0)]), 1.0
)
BAND = 8.0


def painting(label: list[int], shown: list[tuple[int, int]], correction: float = 0.0) -> Painting:
    """The strip painted by two photos, one of 100 and one of 140 grey levels; ``shown``: faces and views."""
    views = [view("a", 0, original_width=20, original_height=10), view("b", 0, original_width=20, original_height=10)]
    names = np.array(label, np.int32)
    faces, by = np.array(shown, np.int32).reshape(-1, 2).T
    value = np.full((len(FACES) * 3, 3), correction, np.float32)
    corrections = Corrections(np.arange(len(FACES) * 3).reshape(-1, 3), value)
    source = Originals(views, lambda k: np.full((10, 20, 3), 100 + 40 * k, np.uint8))
    return Painting(
        [0, 1], views, names, NEIGHBOURS, patches(names, NEIGHBOURS), ShownFaces(faces, by), corrections, source,
        VisibilityOptions(),
    )  # fmt: skip


def test_shares_fall_from_a_half_at_the_seam_to_nothing_at_the_end_of_the_band() -> None:
    everything = [(f, v) for f in range(4) for v in range(2)]
    drawn = draw_triangles(LAYOUT.at, LAYOUT.height, LAYOUT.width)
    bands = find_bands(LAYOUT, painting([0, 0, 1, 1], everything, 3.0), FACES, drawn, BlendOptions(BAND))
    x = bands.pixel % LAYOUT.width + 0.5
    left = x < 60
    assert (bands.view[left] == 1).all() and (bands.view[~left] == 0).all() and left.any() and (~left).any()
    distance = np.where(left, 40 - x, x - 90)
    assert distance.max() < BAND + 1 and 0 < distance.min() < 1
    # the seam is drawn in whole pixels, and the distance is measured to their middles
    assert np.abs(bands.share - 0.5 * (1 - distance / BAND)).max() < 0.5 * 1.6 / BAND
    assert (bands.correction == 3).all()


@pytest.mark.parametrize("band,shown", [(0.0, 2), (BAND, 1)])
def test_without_band_or_second_photo_nothing_is_mixed(band: float, shown: int) -> None:
    pairs = [(f, v) for f in range(4) for v in range(2) if shown == 2 or v == f // 2]
    drawn = draw_triangles(LAYOUT.at, LAYOUT.height, LAYOUT.width)
    assert not len(find_bands(LAYOUT, painting([0, 0, 1, 1], pairs), FACES, drawn, BlendOptions(band)).pixel)
    assert not len(find_bands(LAYOUT, painting([0, 0, 0, 0], pairs), FACES, drawn, BlendOptions(BAND)).pixel)
    bare = painting([0, 0, NO_VIEW, NO_VIEW], pairs)
    assert not len(find_bands(LAYOUT, bare, FACES, drawn, BlendOptions(BAND)).pixel)


def test_a_step_between_two_photos_becomes_a_ramp(tmp_path: Path) -> None:
    mesh = Mesh(VERTICES, FACES, np.zeros((6, 3), np.uint8))
    both = painting([0, 0, 1, 1], [(f, v) for f in range(4) for v in range(2)])
    row = {band: bake(mesh, LAYOUT, both, blend=BlendOptions(band))[25, :, 0].astype(int) for band in (0.0, BAND)}
    assert set(row[0.0][11:39]) == {100} and set(row[0.0][91:119]) == {140}
    ramp = np.concatenate([row[BAND][25:40], row[BAND][90:105]])  # up to the seam, and on from it
    assert np.abs(np.diff(ramp)).max() <= 5 and (np.diff(ramp) >= 0).all()
    assert ramp[0] == 100 and ramp[-1] == 140
