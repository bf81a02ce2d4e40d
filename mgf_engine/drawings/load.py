# SPDX-License-Identifier: GPL-3.0-or-later
"""Read a finished job for drawing: scene, masks, mesh and georeference, in one local frame."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mgf_engine.drawings.model import LEANING, Array, Survey
from mgf_engine.errors import BadInput
from mgf_engine.geometry.clean import face_areas
from mgf_engine.geometry.mesh_files import read_ply
from mgf_engine.geometry.rasterize import face_normals
from mgf_engine.georef.model import Georeference, read_georeference
from mgf_engine.jobs.job_folder import read_job
from mgf_engine.masks.store import read_masks
from mgf_engine.mesh.ground_pixels import nearest_pixels
from mgf_engine.mesh.parts import named_parts
from mgf_engine.mesh.screening import voting_views
from mgf_engine.messages import Reporter
from mgf_engine.model.masks import MaskSet
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.scene import Scene
from mgf_engine.options.algorithms import parameter
from mgf_engine.scene.gravity import GravityOptions, find_up, turn_up
from mgf_engine.scene.store import read_saved_scene


@dataclass(frozen=True)
class UpOptions:
    """Options of the direction up, found from walls."""

    camera_weight: float = parameter(0.003, "Weight of the cameras' direction up against that of all walls")
    axis_angle: float = parameter(1.0, "Angle to an axis of the scene below which up is that axis", "degrees", high=45)
    rounds: int = parameter(5, "Number of iterations", low=1)
    gravity: GravityOptions = GravityOptions()


def read_survey(folder: Path, georeference: Georeference | None = None, options: UpOptions = UpOptions()) -> Survey:
    """Read all that a job folder knows about its building.

    Args:
        georeference: in the place of the job's own, such as that of the town it belongs to.

    Raises:
        BadInput: there is no finished mesh, or a file is damaged.
    """
    read_job(folder)
    if not (folder / "mesh.ply").is_file():
        raise BadInput(f"The job in '{folder}' has no mesh yet; run 'mgf reconstruct' to its end first.")
    scene = read_saved_scene(folder / "scene")
    masks = read_masks(folder / "masks", scene)
    mesh, georeference = read_ply(folder / "mesh.ply"), georeference or read_georeference(folder)
    normalised = replace(mesh, vertices=scene.to_normalised.apply(mesh.vertices))
    in_georeference = replace(mesh, vertices=georeference.local(mesh.vertices))
    turn = np.eye(3)
    if not georeference.up_known:
        guess = scene.to_normalised.rotation.T @ find_up(scene, options=options.gravity).vector
        turn = turn_up(up_from_walls(in_georeference, georeference.rotation @ guess, options))
    local = replace(mesh, vertices=in_georeference.vertices @ turn.T)
    scale = georeference.scale / scene.to_normalised.scale
    return Survey(
        local, normalised, scene, masks, named_parts(folder / "masks", scene), georeference, turn,
        *(pixel * scale for pixel in _pixels(normalised, scene, masks)),
    )  # fmt: skip


def warn_of_unknown_scale(survey: Survey, reporter: Reporter) -> None:
    """Warn that lengths are those of the scene where the job has no georeference in metres."""
    if not survey.georeference.metric:
        reporter.warning(
            "The job has no true coordinates, so one unit of its scene counts as one metre; give 'mgf georef' control "
            "points or scale bars for true lengths."
        )


def up_from_walls(mesh: Mesh, guess: Array, options: UpOptions = UpOptions()) -> Array:
    """Return the direction that the normals of walls are square to, unit [3]; ``guess`` where there are no walls."""
    normals, areas = face_normals(mesh), face_areas(mesh)
    up = guess
    for _ in range(options.rounds):
        lean = (normals @ up) / LEANING
        weight = areas * np.maximum(1 - lean**2, 0) ** 2
        if weight.sum() <= 0.01 * areas.sum():
            return guess
        matrix = (normals * weight[:, None]).T @ normals / weight.sum()
        matrix += options.camera_weight * (np.eye(3) - np.outer(guess, guess))
        found = np.linalg.eigh(matrix)[1][:, 0]
        up = found * np.sign(found @ guess)
    axis = int(np.abs(up).argmax())
    return np.eye(3)[axis] * np.sign(up[axis]) if abs(up[axis]) > np.cos(np.radians(options.axis_angle)) else up


def _pixels(mesh: Mesh, scene: Scene, masks: MaskSet) -> tuple[float, float]:
    """Return the length that a pixel of the user's and of the working photos covers on the mesh, normalised frame."""
    views = [scene.views[i] for i in voting_views(scene, masks)]
    pixels = nearest_pixels(mesh.vertices[mesh.faces].mean(1), views)
    order = np.argsort(pixels)
    areas = np.cumsum(face_areas(mesh)[order])
    working = float(pixels[order][np.searchsorted(areas, areas[-1] / 2)])
    return working * float(np.median([v.width / v.original_width for v in views])), working
