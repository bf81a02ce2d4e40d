# SPDX-License-Identifier: GPL-3.0-or-later
"""What stands out of a wall together stays where photos agree; noise, slow waves and sunken parts do not."""

import numpy as np

from mgf_engine.mesh.photo_consistency import see_vertices
from mgf_engine.mesh.planar import flatten_planes
from mgf_engine.mesh.plane_detection import Planes
from mgf_engine.mesh.relief import Relief, ReliefOptions
from tests.support.sheets import joined, noisy, sheet
from tests.support.wall_photos import cameras, plain, textured

LINE = np.arange(0, 121.0, 1.5)
HALF = 6.0  # width of the moulding: 12 pixels


def wall(height):
    """A wall in z = 0 that faces +z; ``height(u)`` stands out of it along a vertical moulding."""
    return joined(sheet(LINE, LINE, lambda u, v: (u, v, height(u))))


def moulding(height):
    return lambda u: height * np.clip((HALF + 1.5 - np.abs(u - 60)) / 3, 0, 1)


def photographed(mesh, photo):
    """Photos of a mesh."""
    views = cameras()
    pictures = [photo(view) for view in views]
    return see_vertices(mesh, np.ones(len(mesh.vertices)), views, lambda number: pictures[number])


def heights(mesh, photo=None, options=ReliefOptions()):
    """Relief of all vertices over the plane z = 0, by photos of the mesh itself where no others are given."""
    count = len(mesh.vertices)
    plane = Planes(
        np.array([[0.0, 0, 1]]), np.zeros(1), np.full(1, 0.2), np.ones(1), np.zeros(len(mesh.faces), np.int32)
    )
    relief = Relief(photographed(mesh, photo or textured(mesh)), options)
    return relief.heights(mesh, np.ones(count), plane, np.arange(count), np.zeros(count, np.int64))


def on_moulding(mesh):
    return np.abs(mesh.vertices[:, 0] - 60) < HALF - 2


def test_a_moulding_stands_out():
    mesh = noisy(wall(moulding(0.9)), 0.1)
    found = heights(mesh)
    assert np.median(found[on_moulding(mesh)]) > 0.1
    assert found[np.abs(mesh.vertices[:, 0] - 60) > 25].max() < 0.05


def test_no_relief_without_contrast():
    assert not heights(wall(moulding(0.9)), plain).any()


def test_no_relief_where_photos_disagree():
    mesh = wall(moulding(0.9))
    patterns = np.random.default_rng(0).integers(0, 255, (20, 200, 240), np.uint8)
    numbers = iter(range(20))
    assert not heights(mesh, lambda view: patterns[next(numbers)]).any()


def test_noise_and_slow_waves_are_no_relief():
    assert heights(noisy(wall(lambda u: 0.3 * np.sin(u / 15)), 0.2)).max() < 0.1


def test_sunken_parts_are_no_relief():
    mesh = wall(moulding(-0.9))
    assert heights(mesh).min() == 0
    assert not heights(mesh)[on_moulding(mesh)].any()


def test_what_lies_beyond_the_band_has_no_relief():
    mesh = wall(moulding(3.0))
    assert not heights(mesh)[on_moulding(mesh)].any()


def test_flattening_keeps_relief_where_it_is_asked_to():
    mesh = noisy(wall(moulding(0.8)), 0.3)
    pixel, clean = np.ones(len(mesh.vertices)), wall(moulding(0.8))
    relief = Relief(photographed(clean, textured(clean)), ReliefOptions(noise=0.1, correlation=(0.0, 0.1)))
    without, kept = flatten_planes(mesh, pixel), flatten_planes(mesh, pixel, relief=relief)
    both = on_moulding(mesh) & without.inside & kept.inside
    raised = (kept.mesh.vertices - without.mesh.vertices)[both, 2]
    assert raised.min() > -1e-9
    assert np.quantile(raised, 0.95) > 0.1
    far = np.abs(mesh.vertices[:, 0] - 60) > 25
    assert np.quantile(np.abs(kept.mesh.vertices[far, 2]), 0.9) < 0.1, "the wall beside it is flat"
