# SPDX-License-Identifier: GPL-3.0-or-later
"""Extract the mesh from the field."""

from __future__ import annotations

from typing import Any

from mgf_engine.geometry.block_store import clear_blocks
from mgf_engine.geometry.mesh_files import in_scene, write_ply
from mgf_engine.jobs.job import Job
from mgf_engine.jobs.results import load_field, load_inputs
from mgf_engine.mesh.confidence import measure_confidence
from mgf_engine.mesh.confidence_warning import ConfidenceWarningOptions, low_confidence_warning
from mgf_engine.mesh.extract import extract_mesh
from mgf_engine.mesh.options import ExtractionOptions
from mgf_engine.mesh.parts import FILE as PARTS_FILE
from mgf_engine.mesh.parts import FacePartOptions, face_parts, named_parts, write_parts
from mgf_engine.messages import Reporter
from mgf_engine.start.store import FILE as START
from mgf_engine.start.store import read_start
from mgf_engine.system.timing import PartTimes


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
    rating = job.config.algorithm(ConfidenceWarningOptions)
    found = measure_confidence(mesh, rating.low)
    if found is not None:
        figures["confidence"], figures["unseen_share"] = round(found.mean, 3), round(found.shares.unseen, 4)
        warning = low_confidence_warning(found, rating)
        if warning is not None:
            reporter.warning(warning)
    return figures
