# SPDX-License-Identifier: GPL-3.0-or-later
from __future__ import annotations

import numpy as np
import pytest
import torch
from support.analytic import discs, sphere

from mgf_engine.errors import BadInput
from mgf_engine.mesh.tetrahedra import tetra_points


def volumes(points, tetrahedra):
    a, b, c, d = (points[tetrahedra[:, k]] for k in range(4))
    return np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) / 6


def random_points(count=400, seed=0):
    return np.random.default_rng(seed).normal(size=(count, 3))


def test_one_gaussian_gives_its_centre_and_corners():
    field = discs([[1.0, 2.0, 3.0]], [[0.0, 0.0, 1.0]], 0.5, opacity=0.999, thickness=0.2)
    field.filter_3d[:] = 0
    sites = tetra_points(field)
    offsets = sites.points - [1, 2, 3]
    assert len(offsets) == 9
    corner = np.abs(offsets[np.abs(offsets).sum(1) > 1e-6])
    assert corner.shape == (8, 3)
    assert np.allclose(corner, [[1.5, 1.5, 0.3]], atol=1e-5)  # three deviations
    assert np.allclose(sites.extent, np.linalg.norm([1.5, 1.5, 0.3]))


def test_box_follows_opacity_and_filter():
    faint = discs([[0.0, 0, 0]], [[0.0, 0, 1]], 0.5, opacity=0.02, thickness=1.0)
    faint.filter_3d[:] = 0.5
    opacity = float(faint.opacities[0])
    reach = np.sqrt(2 * np.log(255 * opacity)) * np.sqrt(0.5**2 + 0.5**2)
    assert np.isclose(tetra_points(faint).points.max(), reach, rtol=1e-5)


def test_invisible_gaussians_give_nothing():
    field = sphere(20)
    field.opacity_logits[:10] = -20.0
    assert len(tetra_points(field).points) == 90
    field.opacity_logits[:] = -20.0
    with pytest.raises(BadInput, match="opaque enough"):
        tetra_points(field)


def test_duplicates_become_one_with_the_larger_extent():
    field = sphere(10)
    twice = type(field)(*(torch.cat([getattr(field, n)] * 2) for n in field.__dataclass_fields__))
    sites = tetra_points(twice)
    assert len(sites.points) == 90
    assert len(np.unique(sites.points.round(9), axis=0)) == 90
