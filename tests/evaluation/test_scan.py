# SPDX-License-Identifier: GPL-3.0-or-later
"""A laser scan that was moved is brought back onto the mesh, and its distances are those that were put in."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import laspy
import numpy as np
import pye57
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from benchmarks.synthetic.house import OFFSET, house_mesh
from mgf_engine.cli.main import main
from mgf_engine.errors import BadInput
from mgf_engine.evaluation.scan import ScanOptions, compare_with_scan
from mgf_engine.evaluation.scan_files import read_scan
from mgf_engine.evaluation.surfaces import Surface
from mgf_engine.geometry.mesh_files import write_ply
from mgf_engine.georef.model import METRE, Georeference, write_georeference

CORNER = np.array([500_300.0, 5_500_200.0, 100.0])
NOISE, BUMP = 0.004, 0.02  # metres; the bump is on the wall that faces east


@pytest.fixture(scope="module")
def house() -> Surface:
    mesh = house_mesh()
    return Surface(mesh.vertices - OFFSET, mesh.faces.astype(np.int64))


@pytest.fixture(scope="module")
def scan(house: Surface) -> np.ndarray:
    """Points on the house, 20 mm outside it on one wall, with noise, and a lawn around."""
    rng = np.random.default_rng(1)
    points, face = house.sample(60_000, rng)
    normals = house.normals(face)
    points[normals[:, 0] > 0.9] += [BUMP, 0, 0]
    points += normals * rng.normal(0, NOISE, len(points))[:, None]
    lawn = np.column_stack([rng.uniform(-9, 9, (40_000, 2)), rng.normal(-0.3, 0.02, 40_000)])
    return np.concatenate([points, lawn])


def moved(scan: np.ndarray, degrees: float = 0.6, by: float = 0.05) -> np.ndarray:
    return scan @ Rotation.from_rotvec(np.radians(degrees) * np.array([0.3, -0.5, 0.8])).as_matrix().T + [by, -by, by]


def test_a_moved_scan_comes_back(house: Surface, scan: np.ndarray) -> None:
    scores, found = compare_with_scan(house, moved(scan), "rigid", [0.01, 0.05], ScanOptions(0.1))
    away = moved(scan) @ np.array(scores.alignment)[:3, :3].T + np.array(scores.alignment)[:3, 3] - scan
    assert np.abs(away[:60_000]).max() < 0.006  # the wall that was moved pulls a little
    east = found.points[:, 0] > 1.9
    assert -np.median(found.outside[east & (found.points[:, 2] < 1.9)]) == pytest.approx(BUMP, abs=0.005)
    assert np.median(np.abs(found.outside[~east])) < 1.6 * NOISE
    assert scores.left_out > 35_000 and scores.covered > 0.98
    assert scores.within[0] < scores.within[1] and scores.within[1] > 0.99


def test_without_registration_the_offset_stays(house: Surface, scan: np.ndarray) -> None:
    scores, _ = compare_with_scan(house, scan + np.array([0, 0, 0.05]), "none", [0.05], ScanOptions(0.1))
    assert scores.rms > 0.02 and np.array(scores.alignment) == pytest.approx(np.eye(4))


def test_a_scan_of_something_else_is_refused(house: Surface, scan: np.ndarray) -> None:
    for other in (scan + np.array([500.0, 0, 0]), scan * 3):
        with pytest.raises(BadInput, match="does not lie on the mesh"):
            compare_with_scan(house, other, "none", [0.05], ScanOptions(0.05))


def test_every_kind_of_file_gives_the_same_points(scan: np.ndarray, tmp_path: Path) -> None:
    points = scan[:500]
    header = laspy.LasHeader(point_format=3, version="1.2")
    header.scales, header.offsets = np.full(3, 1e-4), np.zeros(3)
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = points.T
    cloud.write(str(tmp_path / "scan.las"))
    cloud.write(str(tmp_path / "scan.laz"))
    trimesh.PointCloud(points).export(tmp_path / "scan.ply")
    file = pye57.E57(str(tmp_path / "scan.e57"), mode="w")
    axes = {f"cartesian{axis}": np.ascontiguousarray(points[:, k]) for k, axis in enumerate("XYZ")}
    file.write_scan_raw(axes, rotation=np.array([1.0, 0, 0, 0]), translation=np.array([1.0, 2.0, 3.0]))
    file.close()
    for kind in ("las", "laz", "ply"):
        assert read_scan(tmp_path / f"scan.{kind}") == pytest.approx(points, abs=1e-4)
    assert read_scan(tmp_path / "scan.e57") == pytest.approx(points + np.array([1, 2, 3]), abs=1e-4)


def test_a_job_is_measured_in_its_true_coordinates(scan: np.ndarray, tmp_path: Path) -> None:
    matrix = np.eye(4)
    matrix[:3, 3] = -OFFSET
    mesh, folder = house_mesh(), tmp_path / "georeferenced"
    folder.mkdir()
    write_georeference(Georeference(matrix, tuple(CORNER), "EPSG:32632", METRE, True, True, "control"), folder)  # type: ignore[arg-type]
    write_ply(mesh, tmp_path / "mesh.ply")
    write_ply(replace(mesh, vertices=mesh.vertices - OFFSET), folder / "mesh.ply")
    header = laspy.LasHeader(point_format=3, version="1.2")
    header.scales, header.offsets = np.full(3, 1e-4), CORNER
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = (moved(scan, 0.2, 0.02) + CORNER).T
    cloud.write(str(tmp_path / "scan.laz"))
    picture, figures = tmp_path / "scan.png", tmp_path / "scan.json"
    command = ["evaluate", tmp_path, "--scan", tmp_path / "scan.laz", "--picture", picture, "--json", figures]
    assert main([str(part) for part in command]) == 0
    found = json.loads(figures.read_text())["scan"]
    assert found["median"] < 0.006 and found["origin"] == pytest.approx(CORNER + np.array([0, 0, 1.8]), abs=0.5)
    image = cv2.imread(str(picture)).astype(int)
    blue = (image[..., 0] - image[..., 2] > 60).mean()  # the east wall lies inside of its scan
    assert 0.002 < blue < 0.2
    drawn = image.min(-1) < 250
    assert drawn.mean() > 0.3  # it is cut to the building
    sides = drawn[:-92]
    halves = [h for half in np.array_split(sides, 2) for h in np.array_split(half, 2, axis=1)]
    assert min(half.mean() for half in halves) > 0.25  # four of them, two by two


@pytest.mark.parametrize(
    ("flags", "says"),
    [
        (["--scan", "none.laz"], "There is no scan"),
        (["--scan", "README.md"], "of no kind that is read"),
        (["--scan", "scan.laz"], "Cannot read the scan"),
        (["--scan", "x.laz", "--truth", "y.ply"], "not both"),
        (["--reach", "-1", "--scan", "x.laz"], "--reach takes"),
        (["--thresholds", "-5", "--scan", "mesh.ply"], "A threshold must be a finite distance above 0, not -5."),
        (["--picture", "x.png", "--scene", "."], "give --truth or --scan"),
    ],
)
def test_bad_input_ends_with_one_sentence(
    flags: list[str], says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write_ply(house_mesh(), tmp_path / "mesh.ply")
    for name in ("README.md", "scan.laz"):
        (tmp_path / name).write_text("no scan")
    monkeypatch.chdir(tmp_path)
    assert main(["evaluate", "mesh.ply", *flags]) == 2
    assert says in capsys.readouterr().err
