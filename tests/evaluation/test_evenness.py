# SPDX-License-Identifier: GPL-3.0-or-later
"""Evenness of walls whose waves and grain are known."""

from __future__ import annotations

import json

import numpy as np
import pycolmap
import pytest

from mgf_engine.errors import BadInput
from mgf_engine.evaluation.evenness import Evenness, EvennessOptions, measure_evenness, typical_pixel
from mgf_engine.evaluation.model_cameras import colmap_pixel
from mgf_engine.evaluation.surfaces import Surface

PIXEL = 0.05


def grid(origin: tuple[float, ...], across: tuple[float, ...], up: tuple[float, ...], relief: np.ndarray) -> Surface:
    """A wall of faces: relief [n, m] along its normal; ``across`` and ``up`` are its sides."""
    n, m = relief.shape
    s, t = np.meshgrid(np.linspace(0, 1, m), np.linspace(0, 1, n))
    normal = np.cross(across, up) / np.linalg.norm(np.cross(across, up))
    spread = s[..., None] * across + t[..., None] * up + relief[..., None] * normal + np.array(origin)
    row = np.arange((n - 1) * m).reshape(n - 1, m)[:, :-1].ravel()
    faces = np.concatenate([np.stack([row, row + 1, row + m + 1], 1), np.stack([row, row + m + 1, row + m], 1)])
    return Surface(spread.reshape(-1, 3), faces)


def joined(*parts: Surface) -> Surface:
    shift = np.cumsum([0, *(len(p.vertices) for p in parts)])
    return Surface(
        np.concatenate([p.vertices for p in parts]),
        np.concatenate([p.faces + k for p, k in zip(parts, shift, strict=False)]),
    )


def house(relief: float = 0.0) -> Surface:
    """Four walls of 10 x 4 and 6 x 4 and two roofs of 10 x 5 on them."""
    noise = lambda: relief * np.random.default_rng(0).standard_normal((60, 90))  # noqa: E731
    walls = [((0, 0, 0), (10, 0, 0)), ((10, 0, 0), (0, 6, 0)), ((10, 6, 0), (-10, 0, 0)), ((0, 6, 0), (0, -6, 0))]
    parts = [grid(at, across, (0, 0, 4), noise()) for at, across in walls]
    parts += [grid((0, y, 4), (10, 0, 0), (0, 3 - y, 4), noise()) for y in (0, 6)]
    return joined(*parts)


def test_a_house_has_its_planes_and_they_are_flat() -> None:
    found = measure_evenness(house(), PIXEL / 5)  # strips of other walls within three pixels of a plane are small
    areas = np.array([50, 50, 40, 40, 24, 24]) / 228
    assert [p.share for p in found.planes] == pytest.approx(areas, abs=0.01)
    mean = found.mean
    assert mean is not None and mean.share == pytest.approx(1.0, abs=0.02)
    assert mean.rms < 0.25 and mean.angle_median < 0.01 and mean.angle_90 < 0.01


def test_grain_shows_in_distance_and_angle() -> None:
    amplitude, wall = 0.004, np.array([10.0, 4.0])
    rough = grid((0, 0, 0), (10, 0, 0), (0, 0, 4), amplitude * np.random.default_rng(1).standard_normal((81, 201)))
    (plane,) = measure_evenness(rough, PIXEL).planes
    corners = rough.vertices[rough.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    angle = np.degrees(np.arccos(np.abs(normals[:, 1]) / np.linalg.norm(normals, axis=1)))
    assert plane.share > 0.99 and rough.areas.sum() > wall.prod()
    # Within a face the heights of its three corners are averaged: half of their variance is left.
    assert plane.rms == pytest.approx(amplitude / PIXEL * np.sqrt(0.5), rel=0.03)
    assert plane.angle_median == pytest.approx(np.median(angle), rel=0.03)
    assert plane.angle_90 > 1.5 * plane.angle_median


def test_reveals_and_corners_are_edges_and_grain_is_not() -> None:
    """Niches 40 cm deep in a wall of 10 x 4 m; what joins wall and backs stands at right angles to it."""
    row, column = np.mgrid[:81, :201]
    niche = (row % 20 > 6) & (column % 25 > 10)
    for grain in (0.0, 0.004):
        noise = grain * np.random.default_rng(1).standard_normal(niche.shape)
        plane = measure_evenness(grid((0, 0, 0), (10, 0, 0), (0, 0, 4), noise - 0.4 * niche), PIXEL / 2).planes[0]
        plain = measure_evenness(grid((0, 0, 0), (10, 0, 0), (0, 0, 4), noise), PIXEL / 2).planes[0]
        assert plane.angle_90 > 40
        assert plane.interior_90 == pytest.approx(plain.angle_90, abs=0.5)


def test_a_plane_that_is_nothing_but_edges_still_has_a_figure() -> None:
    teeth = np.where(np.arange(41) % 2, 0.2, 0.0) * np.ones((60, 1))  # of 39 degrees
    options = EvennessOptions(edge=12.0)  # from tooth to tooth
    plane = measure_evenness(grid((0, 0, 0), (10, 0, 0), (0, 0, 4), teeth), PIXEL / 2, options).planes[0]
    assert plane.interior_90 == plane.angle_90


def test_a_plane_that_its_faces_cross_is_none_of_the_mesh() -> None:
    """A folded sheet beside a house, 25 % of all area: every plane through it was listed, with a median of 76
    degrees."""
    teeth = grid((0, 9, 0), (10, 0, 0), (0, 0, 2), np.where(np.arange(200) % 2, 0.2, 0.0) * np.ones((60, 1)))
    found = measure_evenness(joined(house(), teeth), PIXEL / 5)
    assert len(found.planes) == 6
    assert all(plane.angle_median < 0.02 for plane in found.planes)
    only = measure_evenness(teeth, PIXEL / 5)
    assert not only.planes and only.mean is None


def test_the_same_whatever_the_seed_and_where_the_scene_lies() -> None:
    mesh = house(0.01)
    far = Surface(7 * mesh.vertices + [3e6, 5e6, 100], mesh.faces)
    first, second, moved = (
        measure_evenness(mesh, PIXEL),
        measure_evenness(mesh, PIXEL, seed=5),
        measure_evenness(far, 0.35),
    )
    for other in (second, moved):
        assert other.mean is not None and first.mean is not None
        assert other.mean.rms == pytest.approx(first.mean.rms, abs=0.02)
        assert other.mean.angle_median == pytest.approx(first.mean.angle_median, abs=0.2)
        assert other.mean.angle_90 == pytest.approx(first.mean.angle_90, abs=0.3)


def test_odd_meshes_give_figures_or_a_sentence() -> None:
    needle = Surface(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1e-9, 0]]), np.array([[0, 1, 2]]))
    assert json.loads(json.dumps(measure_evenness(needle, PIXEL).as_dict(), allow_nan=False))["mean"]["rms"] < 1e-6
    ball = np.random.default_rng(0).standard_normal((3000, 3))
    soup = Surface(50 * ball, np.arange(3000).reshape(-1, 3))
    json.dumps(measure_evenness(soup, 1e-6, EvennessOptions(samples=2000)).as_dict(), allow_nan=False)
    assert Evenness(1.0, ()).as_dict()["mean"] is None
    for pixel in (0.0, np.nan, np.inf):
        with pytest.raises(BadInput, match=f"above 0, not {pixel:g}"):
            measure_evenness(house(), pixel)
    with pytest.raises(BadInput, match="1 or more, not 0"):
        measure_evenness(house(), PIXEL, EvennessOptions(samples=0))


def test_the_pixel_is_the_median_photos(tmp_path) -> None:
    assert typical_pixel([np.array([9.0, 10, 11]), np.zeros(0), np.array([30.0])], [100, 1, 100]) == pytest.approx(0.2)
    with pytest.raises(BadInput, match="observed a sparse point"):
        typical_pixel([np.zeros(0)], [100.0])
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(
        pycolmap.Camera(camera_id=1, model="PINHOLE", width=1000, height=500, params=[800, 800, 500, 250])
    )
    for k in range(2):
        image = pycolmap.Image(name=f"{k}.jpg", camera_id=1, image_id=k + 1, keypoints=np.full((1, 2), 5.0))
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pycolmap.Rotation3d(), np.array([0, 0, 8.0 * k])))
    model.add_point3D(np.array([0.0, 0, 8]), pycolmap.Track([pycolmap.TrackElement(1, 0), pycolmap.TrackElement(2, 0)]))
    (tmp_path / "sparse/0").mkdir(parents=True)
    model.write(tmp_path / "sparse/0")
    assert colmap_pixel(tmp_path, 500) == pytest.approx((8 / 400 + 16 / 400) / 2)
