# SPDX-License-Identifier: GPL-3.0-or-later
"""Without GPS and control points a scene is made upright, by the direction up that is known or found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.small_scene import grid, photos, tilted

from mgf_engine.errors import BadInput
from mgf_engine.georef import find
from mgf_engine.georef.find import find_georeference
from mgf_engine.georef.model import SCENE_UNITS
from mgf_engine.georef.options import GeoreferenceOptions
from mgf_engine.model.scene import Scene, Similarity
from mgf_engine.model.up_direction import UpDirection

OPTIONS = GeoreferenceOptions(crs="", control="", marks="", scale_bars="", gps="auto")
LEANING = UpDirection(np.array([0.6, 0.0, 0.8]), 0.01, "walls", 99)


def scene(turn: np.ndarray = np.eye(3)) -> Scene:
    """Photos without files, in a frame that is turned from the user's."""
    made = photos(grid(4, 3), tilted(12, 0.0))
    views = tuple(replace(view, photo="") for view in made.views)
    return replace(made, views=views, to_normalised=Similarity(2.0, turn, np.zeros(3)))


def test_a_direction_that_is_known_is_not_looked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(find, "find_up", lambda *_, **__: pytest.fail("looked for"))
    fit = find_georeference(scene(), OPTIONS, pytest.fail, LEANING)
    assert fit.up is LEANING and fit.georeference.method == "up" and fit.georeference.unit == SCENE_UNITS
    assert fit.georeference.up == pytest.approx(LEANING.vector)
    assert fit.georeference.accuracy["up_degrees"] == pytest.approx(LEANING.degrees)


def test_the_direction_is_that_of_the_users_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    turn = Rotation.from_rotvec([0.3, -0.5, 0.2]).as_matrix()
    monkeypatch.setattr(find, "find_up", lambda *_, **__: LEANING)
    found = find_georeference(scene(turn), OPTIONS, pytest.fail).georeference
    assert found.up == pytest.approx(turn.T @ LEANING.vector)
    assert found.scale == pytest.approx(1.0) and found.rotation @ turn.T @ LEANING.vector == pytest.approx([0, 0, 1])


@pytest.mark.parametrize(("degrees", "kept"), [(0.4, True), (0.6, False)])
def test_a_scene_that_was_made_upright_keeps_its_axes(degrees: float, kept: bool) -> None:
    a = np.radians(degrees)
    nearly = UpDirection(np.array([np.sin(a), 0.0, np.cos(a)]), 0.01, "cameras")
    found = find_georeference(scene(), OPTIONS, pytest.fail, nearly).georeference
    assert (found.to_local == np.eye(4)).all() == kept


def test_a_system_without_any_place_is_refused() -> None:
    with pytest.raises(BadInput, match="Nothing tells where the building is"):
        find_georeference(scene(), replace(OPTIONS, crs="EPSG:25832"), pytest.fail, LEANING)
