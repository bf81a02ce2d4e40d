# SPDX-License-Identifier: GPL-3.0-or-later
"""A finished job of the painted house with a fine mesh and a texture, in metres in UTM, and its models."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.finished_job import FinishedJob, finish_job
from trimesh.remesh import subdivide_to_size

from benchmarks.synthetic.house import OFFSET
from mgf_engine.geometry.mesh_files import write_ply, write_texture
from mgf_engine.georef.model import METRE, Georeference, write_georeference
from mgf_engine.masks.store import read_masks
from mgf_engine.messages import Reporter
from mgf_engine.model.mesh import Mesh
from mgf_engine.models.make import make_models
from mgf_engine.models.work import ModelOptions
from mgf_engine.scene.store import read_saved_scene
from mgf_engine.texture.texture_pipeline import make_texture

CORNER = (500_300.0, 5_500_200.0, 100.0)  # of the house, in UTM


def fine_house(mesh: Mesh, edge: float = 0.2, noise: float = 0.004) -> Mesh:
    """The house in small faces with the noise that a reconstruction has."""
    vertices, faces = subdivide_to_size(mesh.vertices, mesh.faces, edge)
    place, index = np.unique(np.round(vertices, 6), axis=0, return_inverse=True)
    place = place + np.random.default_rng(0).normal(0, noise, place.shape)
    return Mesh(place, index.reshape(-1)[faces].astype(np.int32), np.full((len(place), 3), 128, np.uint8))


def in_utm(folder: Path) -> None:
    """Give a job true coordinates: z of its scene is up, x is east, one unit is a metre."""
    matrix = np.eye(4)
    matrix[:3, 3] = -OFFSET
    write_georeference(Georeference(matrix, CORNER, "EPSG:32632", METRE, True, True, "control", "ellipsoidal"), folder)


@pytest.fixture(scope="session")
def job(tmp_path_factory: pytest.TempPathFactory) -> FinishedJob:
    """The job."""
    made = finish_job(tmp_path_factory.mktemp("house for models"))
    mesh = fine_house(made.house.mesh)
    write_ply(mesh, made.folder / "mesh.ply")
    scene = read_saved_scene(made.folder / "scene")
    normalised = replace(mesh, vertices=scene.to_normalised.apply(mesh.vertices))
    texture = make_texture(normalised, scene, read_masks(made.folder / "masks", scene), 512, lambda text: None)
    write_texture(texture, made.folder)
    in_utm(made.folder)
    return made


@pytest.fixture(scope="session")
def models(job: FinishedJob) -> Path:
    """The folder that ``mgf models`` made of it."""
    return make_models(job.folder, None, ModelOptions(), Reporter())


@pytest.fixture(scope="session")
def index(models: Path) -> dict[str, Any]:
    """Its ``models.json``."""
    return json.loads((models / "models.json").read_text(encoding="utf-8"))
