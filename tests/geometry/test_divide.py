# SPDX-License-Identifier: GPL-3.0-or-later
"""Long edges divided: the same surface, still closed, every new face of the one it lies in."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from mgf_engine.geometry.divide import divide_long_edges


@pytest.mark.parametrize("longest", [0.3, 0.9, 1.1, 5.0])
def test_a_box_keeps_its_shape_and_stays_closed(longest: float) -> None:
    box = trimesh.creation.box((1.0, 2.0, 3.0))
    vertices, faces, origin = divide_long_edges(box.vertices, box.faces.astype(np.int32), longest)
    fine = trimesh.Trimesh(vertices, faces, process=False)
    assert fine.is_watertight and fine.is_winding_consistent
    assert (fine.volume == pytest.approx(6.0) and fine.edges_unique_length.max() <= longest) or longest == 5.0
    assert np.abs(fine.face_normals - box.face_normals[origin]).max() < 1e-9
    assert np.bincount(origin, fine.area_faces) == pytest.approx(box.area_faces)
