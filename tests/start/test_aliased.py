# SPDX-License-Identifier: GPL-3.0-or-later
"""Points by stereo on a wall whose fine texture aliases."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.moire import CENTRES, DISTANCE, STEREO, add_moire
from support.wall import make_wall

from mgf_engine.scene.coarse_stereo import CoarseStereoOptions
from mgf_engine.start.dense import DensePoints, find_stereo_points
from mgf_engine.start.options import DenseOptions, PointSmoothingOptions, ViewOptions
from mgf_engine.start.views import start_views


def points_of(folder: Path, moire: bool, coarse: CoarseStereoOptions) -> DensePoints:
    scene, masks = make_wall(folder, CENTRES)
    if moire:
        add_moire(scene)
    views = start_views(scene, masks, range(len(CENTRES)), ViewOptions())
    return find_stereo_points(
        views, masks, DenseOptions(stereo=STEREO, coarse=coarse), PointSmoothingOptions(), 2, lambda: None
    )


def on_wall(found: DensePoints) -> int:
    """Number of points within 2 % of the wall."""
    return int((np.abs(found.points[:, 2]) < 0.02 * DISTANCE).sum())


def test_moire_gets_points_from_reduced_photos(tmp_path: Path) -> None:
    found = points_of(tmp_path, True, CoarseStereoOptions(factor=2.0))
    without = points_of(tmp_path, True, CoarseStereoOptions(factor=2.0, least_confirmed=0.0))
    assert found.aliased and not without.aliased
    assert on_wall(found) > on_wall(without) + 100
    added = slice(len(without.points), None)
    assert (np.abs(found.points[added, 2]) < 0.02 * DISTANCE).mean() > 0.8
    np.testing.assert_array_equal(found.points[: len(without.points)], without.points)


@pytest.mark.parametrize("least", [0.0, CoarseStereoOptions.least_confirmed])
def test_texture_that_photos_agree_about_is_not_matched_again(tmp_path: Path, least: float) -> None:
    found = points_of(tmp_path, False, CoarseStereoOptions(factor=2.0, least_confirmed=least))
    assert not found.aliased and on_wall(found) > 300
