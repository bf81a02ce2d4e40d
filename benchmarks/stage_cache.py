# SPDX-License-Identifier: GPL-3.0-or-later
"""Cache of the first stages: what runs of the same scene have in common is done once.

An entry is a job folder without options. Which of its stages a run may use is the engine's own decision
(:class:`mgf_engine.jobs.job.Job` compares keys), so a variant never gets what its options would have changed.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Mapping
from itertools import takewhile
from pathlib import Path
from typing import Any

from mgf_engine.files.atomic import write_json
from mgf_engine.options.config import as_dict, make_config, option_fields
from mgf_engine.stages import STAGES

Stages = dict[str, dict[str, Any]]
#: Stages that are kept; the mesh and the report are what a suite measures.
_FIRST = tuple(takewhile(lambda stage: stage.name != "mesh", STAGES))
KEPT = tuple(stage.name for stage in _FIRST)
_LATE = {section for stage in STAGES if stage not in _FIRST for section in stage.sections}


def restore_stages(entry: Path, job: Path) -> Stages:
    """Copy the stages of an entry into a job folder that does not exist yet.

    A run whose own entry (last part of the path: its seed) is missing takes that of another seed.

    Returns:
        The record of the copied stages; empty without an entry.
    """
    found = next((path for path in (entry, *sorted(entry.parent.glob("*"))) if (path / "job.json").exists()), None)
    if found is None:
        return {}
    shutil.copytree(found, job)
    return stages_of(job)


def cache_entry(
    cache: Path, scene: Path, masks: str, poses: str, seed: int, options: Mapping[str, Any] | None = None
) -> Path:
    """Return the entry of runs that agree in these and in all ``options`` but those of the mesh and later."""
    config = as_dict(make_config(dict(options or {})))
    late = {f.name for f in option_fields() if f.metadata["section"] in _LATE} | {"preset"}
    kept = {name: value for name, value in sorted(config.items()) if name not in late}
    key = hashlib.sha256(json.dumps(kept).encode()).hexdigest()[:10]
    return cache / f"{scene.name}-{poses}-{masks}" / f"seed{seed}-{key}"


def store_stages(job: Path, entry: Path) -> None:
    """Store the first stages of a finished job, unless there is such an entry."""
    if entry.exists():
        return
    entry.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=entry.parent, prefix=".part-") as name:
        part = Path(name) / "job"
        part.mkdir()
        for output in (output for stage in _FIRST for output in stage.output_paths):
            source = job / output
            if source.is_dir():
                shutil.copytree(source, part / output)
            elif source.exists():
                shutil.copy2(source, part / output)
        record = json.loads((job / "job.json").read_text(encoding="utf-8"))
        record["given"] = {}
        record["stages"] = {name: done for name, done in record["stages"].items() if name in KEPT}
        write_json(part / "job.json", record)
        if not entry.exists():
            os.rename(part, entry)


def saved_cost(restored: Stages, job: Path) -> dict[str, float]:
    """Sum up the cost of stages that a job took from the cache: ``seconds``, ``cpu_seconds``, ``peak_memory``."""
    stages = stages_of(job)
    used = [done for name, done in restored.items() if stages.get(name) == done]
    return {
        "seconds": sum(done["seconds"] for done in used),
        "cpu_seconds": sum(done["cpu_seconds"] for done in used),
        "peak_memory": max((float(done["peak_memory"]) for done in used), default=0.0),
    }


def stages_of(job: Path) -> Stages:
    """Return the record of a job's finished stages."""
    stages: Stages = json.loads((job / "job.json").read_text(encoding="utf-8"))["stages"]
    return stages
