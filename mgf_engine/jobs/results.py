# SPDX-License-Identifier: GPL-3.0-or-later
"""Read what the stages of a job left in its folder.

Every function raises BadInput where a stage left nothing that can be used; that stage then runs again at the next
occasion.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

from mgf_engine.errors import BadInput
from mgf_engine.field.checkpoint import read_field
from mgf_engine.geometry.mesh_files import read_ply
from mgf_engine.jobs.job import Job
from mgf_engine.masks.store import read_masks
from mgf_engine.model.gaussians import Gaussians
from mgf_engine.model.masks import MaskSet
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.scene import Scene
from mgf_engine.scene.roots import choose_held_out
from mgf_engine.scene.store import read_saved_scene


def load_scene_of(job: Job) -> Scene:
    """Read the scene of a job.

    Which views are kept out of training is the field's matter: the scene may have been made under another choice.
    """
    with _made_by(job, "scene"):
        scene = read_saved_scene(job.path("scene"))
    return replace(scene, held_out=choose_held_out(len(scene.views), scene.roots, job.config.holdout_every))


def load_inputs(job: Job) -> tuple[Scene, MaskSet]:
    """Read the scene and masks of a job whose first two stages are done."""
    scene = load_scene_of(job)
    with _made_by(job, "masks"):
        return scene, read_masks(job.path("masks"), scene)


def load_field(job: Job) -> Gaussians:
    """Read the trained field, normalised frame."""
    with _made_by(job, "field"):
        return read_field(job.path("checkpoints", "field.npz"))


def load_mesh(job: Job, values: Sequence[str] = ()) -> Mesh:
    """Read the mesh, scene frame.

    Args:
        job: open job.
        values: names of further vertex attributes to read, such as ``confidence``.

    Raises:
        BadInput: the mesh is missing or damaged.
    """
    with _made_by(job, "mesh"):
        try:
            return read_ply(job.path("mesh.ply"), values)
        except BadInput as error:
            raise BadInput(f"The mesh in '{job.folder}' is missing or damaged; run 'mgf mesh' again.") from error


@contextmanager
def _made_by(job: Job, stage: str) -> Iterator[None]:
    """Read results of a stage inside; when they cannot be used, the stage runs again at the next occasion."""
    try:
        yield
    except BadInput:
        job.forget(stage)
        raise
