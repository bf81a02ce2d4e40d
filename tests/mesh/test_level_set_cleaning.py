# SPDX-License-Identifier: GPL-3.0-or-later
"""Cleaning of the level set: which parts of it stay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from support.analytic import ball, ring, scene_of

from mgf_engine.mesh.isosurface import SOLID
from mgf_engine.mesh.level_set_cleaning import clean_level_set, drop_unconfirmed_parts
from mgf_engine.mesh.options import ExtractionOptions
from mgf_engine.mesh.trusted_views import TrustedViews
from mgf_engine.model.mesh import Mesh


class Shown:
    """All solid; photos agree on what lies on or above the ball, hardly on what lies beside it."""

    def classify(self, points: np.ndarray) -> np.ndarray:
        return np.full(len(points), SOLID, np.uint8)

    def observations(self, points: np.ndarray) -> dict[str, np.ndarray]:
        beside = (np.linalg.norm(points, axis=1) > 1.1) & (points[:, 2] < 1)
        return {
            "confirmed": np.ones(len(points), bool),
            "views": np.full(len(points), 3, np.uint8),
            "confidence": np.where(beside, 0.3, 0.6).astype(np.float32),
        }


def ball_with_parts() -> Mesh:
    """A ball, a small one above it and a small one beside it, none connected with the rest."""
    small = ball(0.06, 2)
    shapes = [ball(), *(replace(small, vertices=small.vertices + place) for place in ((0, 0, 1.3), (1.3, 0, 0)))]
    starts = np.cumsum([0, *(len(shape.vertices) for shape in shapes)])
    return Mesh(
        np.concatenate([shape.vertices for shape in shapes]),
        np.concatenate([shape.faces + start for shape, start in zip(shapes, starts, strict=False)]).astype(np.int32),
        np.concatenate([shape.colors for shape in shapes]),
    )


def only_above_is_left(mesh: Mesh) -> bool:
    away = mesh.vertices[np.linalg.norm(mesh.vertices, axis=1) > 1.1]
    return len(away) > 0 and bool((away[:, 2] > 1).all())


def test_a_chimney_that_photos_confirm_stays_and_a_shred_beside_does_not() -> None:
    """No photo shows the roof between."""
    mesh = ball_with_parts()
    scene, masks = scene_of(ring(), mesh)
    count = len(scene.views)
    trusted = TrustedViews(list(range(count)), list(scene.views), [], list(masks.labels), None)
    cleaned = clean_level_set(mesh, Shown(), trusted, ExtractionOptions(smoothing=0))  # type: ignore[arg-type]
    assert only_above_is_left(cleaned)


def test_shreds_that_the_trimmed_border_cuts_off_go() -> None:
    mesh = ball_with_parts()
    kept = drop_unconfirmed_parts(mesh, Shown(), ExtractionOptions())  # type: ignore[arg-type]
    assert only_above_is_left(kept)
    assert len(kept.faces) == len(mesh.faces) - len(ball(0.06, 2).faces)
