# SPDX-License-Identifier: GPL-3.0-or-later
"""A body that photos show from one side: its other side stays on a building, and goes where it is a shadow's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.analytic import ball

from mgf_engine.mesh.unobserved_volumes import UnobservedVolumeOptions, drop_unobserved

PIXEL = 0.02


def without(thickness: float, confirmed=lambda x: x > 0.0, pixel: float = PIXEL):
    """A ball pressed flat along x; the photos stand at positive x. Free is all outside of it."""
    mesh = ball(subdivisions=3)
    mesh = replace(mesh, vertices=mesh.vertices * (thickness, 1.0, 1.0))
    free = lambda points: np.linalg.norm(points / (thickness, 1.0, 1.0), axis=1) > 1  # noqa: E731
    shown = confirmed(mesh.vertices[:, 0])
    left = drop_unobserved(mesh, shown, np.full(len(mesh.vertices), pixel), free)
    return mesh, shown, left


def test_a_shadow_behind_a_thin_thing_goes():
    mesh, shown, left = without(0.9 * UnobservedVolumeOptions.thick_share)
    assert len(left.faces) == shown[mesh.faces].any(1).sum() < len(mesh.faces)
    assert left.vertices[:, 0].min() > mesh.vertices[:, 0].min() / 2


@pytest.mark.parametrize("case", ["thick", "thick beside a pixel", "all confirmed", "small patch", "slit"])
def test_what_has_a_building_behind_it_stays(case):
    if case == "thick":
        mesh, _, left = without(UnobservedVolumeOptions.thick * PIXEL)
    elif case == "thick beside a pixel":  # thin beside the mesh, and 150 pixels thick
        mesh, _, left = without(0.04, pixel=0.08 / 150)
    elif case == "all confirmed":
        mesh, _, left = without(0.04, lambda x: np.ones(len(x), bool))
    elif case == "slit":
        mesh, shown, left = without(0.04, lambda x: (x > 0.0) | (x < -0.01))
        assert 0 < (~shown[mesh.faces].any(1)).sum() < 0.3 * len(mesh.faces)
    else:
        mesh, shown, left = without(0.04, lambda x: np.arange(len(x)) > 0)
        assert not shown.all()
    assert len(left.faces) == len(mesh.faces)
