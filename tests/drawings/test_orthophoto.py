# SPDX-License-Identifier: GPL-3.0-or-later
"""Orthophotos of a house whose windows are known to the millimetre."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import rasterio
from support.finished_job import WINDOWS, FinishedJob

from benchmarks.synthetic.house import OFFSET
from mgf_engine.drawings import orthophoto
from mgf_engine.drawings.facades import facade_through, find_facades
from mgf_engine.drawings.geotiff import write_geotiff
from mgf_engine.drawings.load import read_survey
from mgf_engine.drawings.model import DrawingFrame
from mgf_engine.drawings.orthophoto import unseen_text
from mgf_engine.drawings.project import plan_grid, render_grid
from mgf_engine.errors import BadInput, is_full_disk
from mgf_engine.geometry.rasterize import render_mesh
from mgf_engine.model.mesh import Mesh
from mgf_engine.texture.visibility import VisibilityOptions
from tests.support.analytic import camera


def edges_of_dark(dark: np.ndarray) -> list[tuple[float, float]]:
    """Where a profile crosses half way between its darkest and its brightest, to a part of a pixel, in pairs."""
    middle = 0.5 * (np.percentile(dark, 5) + np.percentile(dark, 95))
    above = dark > middle
    cross = np.flatnonzero(above[1:] != above[:-1])
    at = [float(k + 0.5 + (middle - dark[k]) / (dark[k + 1] - dark[k])) for k in cross]
    return list(zip(at[::2], at[1::2], strict=True))


def test_window_corners_lie_within_a_pixel(drawings: Path, index: dict[str, Any]) -> None:
    found = 0
    for facade, sign in (("A", 1.0), ("C", -1.0)):  # south, and north, where x runs to the west
        with rasterio.open(drawings / f"orthophoto-{facade}.tif") as file:
            image, place, tags = file.read().astype(float), ~file.transform, file.tags()
        origin = np.array(tags["ORIGIN"].split(), float)
        bright = image[:3].mean(0)
        for left, right, bottom, top in WINDOWS:
            ends = sorted(sign * (x + OFFSET[0] - origin[0]) for x in (left, right))
            heights = [z + OFFSET[2] - origin[2] for z in (top, bottom)]
            (c0, r0), (c1, r1) = place @ (ends[0], heights[0]), place @ (ends[1], heights[1])
            rows, columns = slice(int(r0) + 4, int(r1) - 4), slice(int(c0) + 4, int(c1) - 4)
            across = bright[rows, int(c0) - 6 : int(c1) + 6].mean(0)
            down = bright[int(r0) - 6 : int(r1) + 6, columns].mean(1)
            ((a, b),), ((c, d),) = edges_of_dark(across), edges_of_dark(down)
            measured = np.array([a + int(c0) - 6, b + int(c0) - 6, c + int(r0) - 6, d + int(r0) - 6])
            assert np.abs(measured - np.array([c0, c1, r0, r1])).max() < 1.0
            found += 1
    assert found == 4


def test_nothing_beside_the_house_is_painted_and_all_of_it_is(drawings: Path) -> None:
    with rasterio.open(drawings / "orthophoto-B.tif") as file:
        alpha, place = file.read(4), file.transform
    column, row = np.meshgrid(np.arange(alpha.shape[1]) + 0.5, np.arange(alpha.shape[0]) + 0.5)
    x, y = place @ (column, row)
    y = y - OFFSET[2]
    roof = 2.0 + 1.2 * (1 - np.abs(x - 1.5) / 1.5)
    slack = 0.03
    inside = (x > slack) & (x < 3 - slack) & (y > slack) & (y < roof - slack)
    outside = (x < -slack) | (x > 3 + slack) | (y < -slack) | (y > roof + slack)
    assert alpha[inside].min() == 255 and alpha[outside].max() == 0


def test_geotiff_is_tiled_with_overviews_and_says_where_it_is(drawings: Path) -> None:
    with rasterio.open(drawings / "orthophoto-A.tif") as file:
        tags = file.tags()
        assert file.profile["tiled"] and file.overviews(1) and file.count == 4
        assert [c.name for c in file.colorinterp] == ["red", "green", "blue", "alpha"]
        corner = file.transform @ (0, 0)
    x, normal = (np.array(tags[name].split(), float) for name in ("X_AXIS", "NORMAL"))
    assert np.allclose(x, [1, 0, 0], atol=1e-6) and np.allclose(normal, [0, -1, 0], atol=1e-6)
    assert np.array(tags["ORIGIN"].split(), float)[1] == pytest.approx(OFFSET[1] - 1.5, abs=1e-5)
    assert corner[1] == pytest.approx(OFFSET[2] + 3.2, abs=0.08)


def test_heights_from_above_are_those_of_the_roof(drawings: Path) -> None:
    with rasterio.open(drawings / "heights-plan.tif") as file:
        heights, place = file.read(1), file.transform
        assert np.isnan(file.nodata)
    rows, columns = np.nonzero(~np.isnan(heights))
    y = (place @ (columns + 0.5, rows + 0.5))[1]
    with rasterio.open(drawings / "heights-plan.tif") as file:
        origin = np.array(file.tags()["ORIGIN"].split(), float)
    true = OFFSET[2] + 2.0 + 1.2 * (1 - np.abs(y + origin[1] - OFFSET[1]) / 1.5)
    assert np.abs(heights[rows, columns] - true).max() < 1e-3


@pytest.mark.parametrize(("room", "rendered"), [(1 << 30, 1), (0, 3)])
def test_a_point_is_seen_alike_whether_its_depth_map_is_kept_or_not(
    room: int, rendered: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A square of 2 x 2 seen from 8 before it; its right half is building in the mask."""
    view, made = camera((0.0, -8.0, 0.0)), []
    corners = np.array([[-1.0, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]])
    mesh = Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32), np.zeros((4, 3), np.uint8))
    label = np.zeros((view.height, view.width), np.uint8)
    label[:, view.width // 2 :] = 1
    survey = SimpleNamespace(normalised=mesh, masks=SimpleNamespace(labels=[label]))
    painting = SimpleNamespace(views=[view], chosen=[0], visibility=VisibilityOptions())
    monkeypatch.setattr(orthophoto, "share", lambda part, most: room)
    monkeypatch.setattr(orthophoto, "render_mesh", lambda *given: made.append(1) or render_mesh(*given))
    seen = orthophoto.Visibility(survey, painting)  # type: ignore[arg-type]
    pixel, front = 8 / view.fx, np.tile([0.0, -1.0, 0.0], (5, 1))
    points = np.array([[0.5, 0, 0], [0.5 * pixel, 0, 0], [-0.5, 0, 0], [0.5, 1, 0], [0.5, 0, 0]])
    front[4] = (0.0, 1.0, 0.0)  # faces away
    for _ in range(3):
        size, clear = seen(0, points, front)
        whole = float(np.cos(np.arctan(0.5 / 8)) / pixel**2)
        np.testing.assert_allclose(size, [whole, orthophoto.EDGE_WEIGHT / pixel**2, 0, 0, 0], rtol=1e-3)
        assert clear.tolist() == [True, False, False, False, False]
    assert len(made) == rendered


def test_a_facade_without_photos_is_said(finished: FinishedJob) -> None:
    survey = read_survey(finished.folder)
    frame = find_facades(survey)[0].frame
    seen = render_grid(survey, plan_grid(frame, 0.02))
    image = np.full((*seen.face.shape, 4), 255, np.uint8)
    assert unseen_text("A", image, seen) is None
    image[:, : image.shape[1] * 7 // 10, 3] = 0
    assert "only 30% of the facade A" in str(unseen_text("A", image, seen))
    image[..., 3] = 0
    assert unseen_text("A", image, seen) == "No photo shows the facade A; its orthophoto is empty."


def test_a_facade_beside_the_building_is_refused(finished: FinishedJob) -> None:
    survey = read_survey(finished.folder)
    points = np.array([(50.0, 50, 0), (58, 50, 0), (58, 50, 3)])
    with pytest.raises(BadInput, match="misses the building by"):
        facade_through(survey, points, "facade-1")


@pytest.mark.skipif(sys.platform == "win32", reason="no limit of file sizes stands in for a full disk there")
def test_a_full_disk_is_no_fault_of_gdal(finished: FinishedJob, tmp_path: Path) -> None:
    import resource
    import signal

    survey = read_survey(finished.folder)
    grid = plan_grid(find_facades(survey)[0].frame, 0.005)
    noise = np.random.default_rng(0).integers(0, 256, (grid.height, grid.width, 4)).astype(np.uint8)
    before, ignored = resource.getrlimit(resource.RLIMIT_FSIZE), signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, before[1]))
    try:
        with pytest.raises(OSError) as raised:
            write_geotiff(tmp_path / "a.tif", noise, grid, survey, {})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, ignored)
    assert is_full_disk(raised.value) and not list(tmp_path.iterdir())


def test_too_fine_a_resolution_is_refused_in_millimetres_with_one_that_fits() -> None:
    frame = DrawingFrame(
        "A", np.zeros(3), np.array([1.0, 0, 0]), np.array([0, 0, 1.0]), np.zeros(2), np.array([25.0, 20.0])
    )
    with pytest.raises(BadInput, match=r"'A' at 0\.01 mm per pixel has .* give --resolution [\d.]+ or more\.$") as told:
        plan_grid(frame, 1e-5)
    plan_grid(frame, float(str(told.value).split("--resolution ")[1].split()[0]) / 1000)
