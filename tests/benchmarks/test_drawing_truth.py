# SPDX-License-Identifier: GPL-3.0-or-later
"""What true meshes enclose in a plane, and where the corners of openings are on their walls."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from support.finished_job import finish_job

from benchmarks.buildings import BUILDINGS
from benchmarks.drawing_truth import enclosed_area, main, row, wall_corners
from benchmarks.openings import true_openings
from benchmarks.shapes import labelled_mesh
from mgf_engine.evaluation.surfaces import Surface
from mgf_engine.geometry.mesh_files import write_ply


def test_overlapping_boxes_enclose_their_union() -> None:
    one, other = trimesh.creation.box((4, 3, 2)), trimesh.creation.box((2, 2, 2))
    other.apply_translation((2.5, 0, 0))
    mesh = trimesh.util.concatenate([one, other])
    assert enclosed_area(mesh.vertices, mesh.faces) == pytest.approx(4 * 3 + 2 * 2 - 0.5 * 2, abs=0.02)


def test_an_upright_section_is_closed_at_its_foot() -> None:
    mesh = trimesh.creation.box((4, 3, 2))
    mesh.update_faces(mesh.face_normals[:, 1] > -0.5)  # nothing below
    assert enclosed_area(mesh.vertices, mesh.faces, low=-1.2) == pytest.approx(4 * 2.7, rel=0.02)


def test_corners_are_on_the_wall_before_the_glass() -> None:
    parts = [part for part in BUILDINGS["plain_house"]("clean_white") if part.building]
    vertices, faces, _ = labelled_mesh(parts)
    openings, toward = true_openings(parts), np.array([0.0, -1.0, 0.0])
    found = np.array(wall_corners(openings, toward, Surface(vertices, faces)))
    glass = np.concatenate(openings)
    assert len(found) >= 8
    for corner in found:
        off = corner - glass
        across = np.abs(off - np.outer(off @ toward, toward)).max(1)
        row = int(np.where(across < 1e-6, np.abs(off @ toward), np.inf).argmin())
        assert across[row] < 1e-6 and 0.01 < off[row] @ toward < 0.6


def test_what_is_no_job_is_refused_in_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert error.startswith("Error: ") and error.count("\n") == 1 and str(tmp_path) in error


def test_drawings_take_the_options_of_the_job(tmp_path: Path) -> None:
    """A job whose own options leave small areas out of sections has none here, as in what ``mgf drawings`` makes."""
    job = finish_job(tmp_path, photos=6)
    write_ply(job.house.mesh, job.house.folder / "truth.ply")
    spec = {"lens": (0.1, 0.0)}  # no corners
    record = job.folder / "job.json"
    written = json.loads(record.read_text(encoding="utf-8"))
    assert "-100.00 %" not in row(job.folder, job.house.folder, spec)[0]
    written["given"]["section_cuts.least_area"] = 1e9
    record.write_text(json.dumps(written), encoding="utf-8")
    assert row(job.folder, job.house.folder, spec)[0].count("-100.00 %") == 3
