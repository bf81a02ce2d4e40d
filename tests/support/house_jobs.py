# SPDX-License-Identifier: GPL-3.0-or-later
"""Whole jobs of the small painted house, and the score of their meshes."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import igl
import numpy as np
import trimesh

from benchmarks.synthetic.house import House
from support.jobs import finish, start

OPTIONS = ["--iterations", "150", "--max-gaussians", "5000", "--densify-every", "50", "--level-steps", "4"]


def reconstruct(house: House, job: Path, *more: object) -> list[dict]:
    run = start("reconstruct", house.folder, "--prompts", house.prompts, "--out", job, *OPTIONS, *more)
    messages = finish(run)
    assert run.returncode == 0, messages[-1]
    return messages


def f1(mesh_file: Path, house: House, threshold: float) -> float:
    """F1 between a mesh and the house, floor and faces below 5 cm left out: no photo shows the floor."""
    found, true = trimesh.load(mesh_file), trimesh.Trimesh(house.mesh.vertices, house.mesh.faces, process=False)
    ground = house.mesh.vertices[:, 2].min() + 0.05
    shares = []
    for here, there in ((found, true), (true, found)):
        points = trimesh.sample.sample_surface(here, 4000, seed=1)[0]
        points = points[points[:, 2] > ground]
        squared = igl.point_mesh_squared_distance(points, np.asarray(there.vertices), np.asarray(there.faces))[0]
        shares.append(float((np.sqrt(squared) < threshold).mean()))
    return 2 * shares[0] * shares[1] / max(sum(shares), 1e-9)


def copy_until(finished: Path, job: Path, stage: str) -> None:
    """A copy of a finished job as it was before ``stage`` began."""
    shutil.copytree(finished, job)
    data = json.loads((job / "job.json").read_text())
    order = ["scene", "masks", "field", "mesh", "deliver"]
    for name in order[order.index(stage) :]:
        data["stages"].pop(name, None)
        (job / f".started-{name}").unlink(missing_ok=True)
    (job / "job.json").write_text(json.dumps(data))
