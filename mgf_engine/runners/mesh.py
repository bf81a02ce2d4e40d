# SPDX-License-Identifier: GPL-3.0-or-later
"""Extract the mesh from the field."""

from __future__ import annotations

from typing import Any

import numpy as np

from mgf_engine.geometry.block_store import clear_blocks
from mgf_engine.geometry.clean import vertex_areas
from mgf_engine.geometry.mesh_files import in_scene, write_ply
from mgf_engine.jobs.job import Job
from mgf_engine.jobs.results import load_field, load_inputs
from mgf_engine.mesh.extract import extract_mesh
from mgf_engine.mesh.options import ExtractionOptions
from mgf_engine.mesh.parts import FILE as PARTS_FILE
from mgf_engine.mesh.parts import FacePartOptions, face_parts, named_parts, write_parts
from mgf_engine.messages import Reporter
from mgf_engine.start.store import FILE as START
from mgf_engine.start.store import read_start
from mgf_engine.system.timing import PartTimes

#: Mean confidence of a mesh below which its F1 is about half of what the scene allows (docs/stability.md).
DOUBTFUL = 0.5


def run_mesh(job: Job, reporter: Reporter) -> dict[str, Any]:
    """Extract the mesh and its named parts; returns sizes, times and how far the mesh is to be trusted."""
    scene, masks = load_inputs(job)
    times = PartTimes()
    start = read_start(job.path("checkpoints", START)) if job.config.start == "surface" else None
    options = job.config.algorithm(ExtractionOptions)
    mesh = extract_mesh(load_field(job), scene, masks, options, reporter, times, start)
    write_ply(in_scene(mesh, scene.to_normalised), job.path("mesh.ply"))
    clear_blocks()
    named = named_parts(job.path("masks"), scene)
    if named:
        voted = face_parts(mesh, scene, masks, list(named.values()), job.config.algorithm(FacePartOptions))
        write_parts(list(named), voted, job.path(PARTS_FILE))
    figures: dict[str, Any] = {"vertices": len(mesh.vertices), "faces": len(mesh.faces), **times.figures()}
    if "confidence" in mesh.values:
        # By area: vertices are many where the surface is rough, and there it is least certain.
        areas = vertex_areas(mesh)
        figures["confidence"] = round(float(np.average(mesh.values["confidence"], weights=areas)), 3)
        figures["unseen_share"] = round(float(np.average(mesh.values["views"] == 0, weights=areas)), 4)
        if figures["confidence"] < DOUBTFUL:
            reporter.warning(weak_surface(figures["confidence"], figures["unseen_share"]))
    return figures


def weak_surface(confidence: float, unseen: float) -> str:
    """Return what to say of a mesh that the photos hardly confirm."""
    return (
        f"The mesh has low confidence (mean {confidence:.2f} of 1, {unseen:.0%} of it seen by no photo): do not "
        "measure on it. More, sharper and denser photos or better cameras would help."
    )
