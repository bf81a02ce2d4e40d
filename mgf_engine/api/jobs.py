# SPDX-License-Identifier: GPL-3.0-or-later
"""A whole job as one function: ``mgf.reconstruct``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mgf_engine.api.arguments import PathLike, make_reporter, optional_path
from mgf_engine.geometry.mesh_files import read_ply
from mgf_engine.jobs.job import Job
from mgf_engine.messages import Sink
from mgf_engine.model.mesh import Mesh
from mgf_engine.pipeline import result_files, run_job
from mgf_engine.stages import STAGE_NAMES


@dataclass(frozen=True)
class Reconstruction:
    """A finished job.

    Attributes:
        folder: the job folder.
        files: name -> path of a result: ``mesh``, ``texture``, ``field``, ``report``, ``figures``, ``masks``, ...
        figures: the headline figures: number of faces, PSNR of the held-out photos, ...
    """

    folder: Path
    files: dict[str, Path]
    figures: dict[str, Any]

    def read_mesh(self) -> Mesh:
        """Read the mesh, in the coordinates of the user's COLMAP model."""
        return read_ply(self.files["mesh"])


def reconstruct(
    scene: PathLike,
    prompts: PathLike | None = None,
    out: PathLike = "job",
    *,
    masks: PathLike | None = None,
    resume: bool = False,
    on_message: Sink | None = None,
    **options: Any,
) -> Reconstruction:
    """Reconstruct a building: photos and clicks in; mesh, texture and report out (``mgf reconstruct``).

    >>> import mgf_engine as mgf
    >>> job = mgf.reconstruct("house", "house/prompts.json", "job", preset="quick", resolution=160, texture=False)
    >>> job.figures["faces"] > 100
    True
    >>> job.read_mesh().vertices.shape[1]
    3

    Args:
        scene: folder of a COLMAP project, or of photos alone.
        prompts: JSON file of clicks on the building.
        out: job folder, made if missing.
        masks: folder of masks, one PNG per photo, instead of prompts.
        resume: continue the job in the folder.
        on_message: called with each message (:mod:`mgf_engine.messages`): progress, warnings, the result.
        options: see ``mgf options``.

    Returns:
        The job folder with its results.

    Raises:
        BadInput: an input or option cannot be used, or the folder holds something else.
    """
    reporter = make_reporter(on_message)
    with Job.start(Path(out), Path(scene), optional_path(prompts), optional_path(masks), options, resume=resume) as job:
        run_job(job, reporter)
        files = {name: Path(path) for name, path in result_files(job).items()}
        return Reconstruction(job.folder, files, job.stages[STAGE_NAMES[-1]]["figures"])
