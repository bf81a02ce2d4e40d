# SPDX-License-Identifier: GPL-3.0-or-later
"""The Python interface: one call for a whole job, and one for each of its steps.

Import these from :mod:`mgf_engine`. Options are keyword arguments with the names that ``mgf options`` lists; a step
takes the options of all steps and uses its own. Paths may be strings. Every function raises
:class:`~mgf_engine.errors.BadInput` with one sentence where the input cannot be used.

The steps share a work folder, which is laid out as a job folder: ``scene/``, ``masks/``, ``checkpoints/``.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mgf_engine.config import Config, make_config
from mgf_engine.evaluation.geometry import ComparisonOptions, score_surface
from mgf_engine.evaluation.model_cameras import colmap_cameras
from mgf_engine.evaluation.scores import GeometryScores
from mgf_engine.evaluation.surfaces import Surface, read_surface
from mgf_engine.field import trainer
from mgf_engine.geometry.mesh_files import in_scene, read_ply
from mgf_engine.georef.adjust import fit_to_control
from mgf_engine.job import Job
from mgf_engine.masks.build import build_masks
from mgf_engine.masks.prompts import PromptsFile, clicked_names
from mgf_engine.mesh import extract
from mgf_engine.mesh.options import ExtractionOptions
from mgf_engine.messages import Reporter, Sink
from mgf_engine.model.gaussians import Gaussians
from mgf_engine.model.masks import MaskSet
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.scene import Scene, View
from mgf_engine.pipeline import prepare, result_files, run_job
from mgf_engine.raster.api import Camera, Rendering
from mgf_engine.raster.api import render as render_gaussians
from mgf_engine.scene.load import load_scene
from mgf_engine.stages import STAGE_NAMES
from mgf_engine.start.store import FILE as START
from mgf_engine.start.store import read_start

PathLike = str | os.PathLike[str]


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
    reporter = _reporter(on_message)
    with Job.start(Path(out), Path(scene), _path(prompts), _path(masks), options, resume=resume) as job:
        run_job(job, reporter)
        files = {name: Path(path) for name, path in result_files(job).items()}
        return Reconstruction(job.folder, files, job.stages[STAGE_NAMES[-1]]["figures"])


def read_scene(
    source: PathLike,
    out: PathLike,
    *,
    prompts: PathLike | None = None,
    on_message: Sink | None = None,
    **options: Any,
) -> Scene:
    """Read cameras, photos and sparse points; undistort and resize the photos.

    >>> import mgf_engine as mgf
    >>> scene = mgf.read_scene("house", "work", resolution=160)
    >>> len(scene.views), scene.views[0].width, scene.points.shape[1]
    (14, 160, 3)

    Args:
        source: folder of a COLMAP project, or of photos alone (cameras are then found by COLMAP).
        out: work folder; the working photos go to ``scene/`` in it.
        prompts: JSON file of clicks; its photos are used also where ``max_photos`` leaves others out.
        on_message: called with each message.
        options: of the sections ``run`` and ``scene``.

    Returns:
        The scene in the normalised frame.

    Raises:
        BadInput: the model or a photo cannot be used.
    """
    config, reporter = _prepared("scene", options, on_message)
    clicks = None if prompts is None else PromptsFile.read(Path(prompts))
    adjust = fit_to_control if config.control and config.control_adjust else None
    return load_scene(Path(source), Path(out) / "scene", config, reporter, clicked_names(clicks), adjust)


def make_masks(
    scene: Scene,
    prompts: PathLike | None = None,
    *,
    masks: PathLike | None = None,
    on_message: Sink | None = None,
    **options: Any,
) -> MaskSet:
    """Find the building in every photo from clicks on a few.

    >>> import mgf_engine as mgf
    >>> scene = mgf.read_scene("house", "work", resolution=160)
    >>> masks = mgf.make_masks(scene, "house/prompts.json")
    >>> masks.labels[0].shape == (scene.views[0].height, scene.views[0].width)
    True
    >>> bool(masks.used.all())
    True

    Args:
        scene: as :func:`read_scene` returns it.
        prompts: JSON file of clicks on the building.
        masks: folder of masks, one PNG per photo, instead of prompts.
        on_message: called with each message.
        options: of the sections ``run`` and ``masks``.

    Returns:
        A label map per photo (0 background, 1 and more building, 255 ignore); also written to ``masks/``.

    Raises:
        BadInput: no clicks, or clicks or masks that cannot be used.
    """
    config, reporter = _prepared("masks", options, on_message)
    folder = scene.folder.parent / "masks"
    return build_masks(scene, _path(prompts), _path(masks), folder, config, reporter)


def train(scene: Scene, masks: MaskSet, *, on_message: Sink | None = None, **options: Any) -> Gaussians:
    """Train the Gaussian field of the building.

    >>> import mgf_engine as mgf
    >>> scene = mgf.read_scene("house", "work", resolution=160)
    >>> masks = mgf.make_masks(scene, "house/prompts.json")
    >>> field = mgf.train(scene, masks, iterations=20, max_gaussians=2000)
    >>> field.positions.shape == (len(field), 3)
    True

    Args:
        scene: as :func:`read_scene` returns it.
        masks: as :func:`make_masks` returns them.
        on_message: called with each message.
        options: of the sections ``run``, ``masks`` and ``field``.

    Returns:
        The field in the normalised frame; an earlier training in the work folder is replaced.

    Raises:
        BadInput: no photo is left to train on, or too few points lie on the building.
    """
    config, reporter = _prepared("field", options, on_message)
    folder = scene.folder.parent / "checkpoints"
    shutil.rmtree(folder, ignore_errors=True)
    return trainer.train(scene, masks, config, folder, reporter)[0]


def extract_mesh(
    field: Gaussians, scene: Scene, masks: MaskSet, *, on_message: Sink | None = None, **options: Any
) -> Mesh:
    """Extract the surface of the building from its field.

    >>> import mgf_engine as mgf
    >>> scene = mgf.read_scene("house", "work", resolution=160)
    >>> masks = mgf.make_masks(scene, "house/prompts.json")
    >>> field = mgf.train(scene, masks, passes=0)
    >>> mesh = mgf.extract_mesh(field, scene, masks, max_faces=2000)
    >>> 100 < len(mesh.faces) <= 2000
    True

    Args:
        field: as :func:`train` returns it; the starting surface that it left in the work folder counts, too.
        scene: as :func:`read_scene` returns it.
        masks: as :func:`make_masks` returns them.
        on_message: called with each message.
        options: of the sections ``run``, ``masks`` and ``mesh``, and ``start``.

    Returns:
        Triangles with vertex colours in the coordinates of the user's COLMAP model.

    Raises:
        BadInput: nothing is left to mesh.
    """
    config, reporter = _prepared("mesh", options, on_message)
    start = read_start(scene.folder.parent / "checkpoints" / START) if config.start == "surface" else None
    mesh = extract.extract_mesh(field, scene, masks, config.algorithm(ExtractionOptions), reporter, start=start)
    return in_scene(mesh, scene.to_normalised)


def render(field: Gaussians, view: View | Camera, *, sh_degree: int = 3) -> Rendering:
    """Render a field as a camera sees it; differentiable in the field's parameters.

    >>> import mgf_engine as mgf
    >>> scene = mgf.read_scene("house", "work", resolution=160)
    >>> masks = mgf.make_masks(scene, "house/prompts.json")
    >>> field = mgf.train(scene, masks, passes=0)
    >>> rendering = mgf.render(field, scene.views[0])
    >>> tuple(rendering.color.shape)
    (3, 120, 160)
    >>> bool(rendering.alpha.max() > 0.9)
    True

    Args:
        field: Gaussians in the normalised frame.
        view: a photo's camera, or any other.
        sh_degree: degree of the spherical harmonics of the colour (0 to 3).

    Returns:
        Colour [3, H, W] (premultiplied), alpha, depth and normals [.., H, W], float32.
    """
    camera = Camera.from_view(view) if isinstance(view, View) else view
    return render_gaussians(field, camera, sh_degree=sh_degree)


def evaluate(
    mesh: Mesh | PathLike,
    truth: Mesh | PathLike,
    *,
    thresholds: Sequence[float] = (0.05,),
    samples: int = 1_000_000,
    scene: PathLike | None = None,
    align: str = "none",
) -> GeometryScores:
    """Compare a mesh with the true one: accuracy, completeness, F1, angles of normals.

    >>> import mgf_engine as mgf
    >>> scores = mgf.evaluate("truth.ply", "truth.ply", thresholds=[0.01, 0.1], samples=1000)
    >>> scores.f1
    (100.0, 100.0)

    Args:
        mesh: the mesh, or its file (PLY, OBJ, GLB).
        truth: the true mesh in the same coordinates, or its file.
        thresholds: distances within which a point counts as right, in the units of the meshes.
        samples: points sampled on each mesh.
        scene: COLMAP project; true points that none of its cameras sees do not count.
        align: move the mesh onto the truth first: ``none``, ``rigid`` or ``similarity``.

    Returns:
        Percentages per threshold, distances in the units of the meshes.

    Raises:
        BadInput: a mesh or the scene cannot be read, or impossible numbers.
    """
    cameras = None if scene is None else colmap_cameras(Path(scene))
    options = ComparisonOptions(samples, cameras, align=align)
    return score_surface(_surface(mesh), _surface(truth), tuple(thresholds), options)


def _surface(mesh: Mesh | PathLike) -> Surface:
    return Surface(mesh.vertices, mesh.faces.astype(np.int64)) if isinstance(mesh, Mesh) else read_surface(Path(mesh))


def _prepared(stage: str, options: dict[str, Any], on_message: Sink | None) -> tuple[Config, Reporter]:
    """Check the options and return them with whom to report to; device, threads and seeds are set as for a job."""
    config, reporter = make_config(options), _reporter(on_message)
    prepare(config, reporter)
    reporter.stages = (stage,)
    reporter.stage(stage)
    return config, reporter


def _reporter(on_message: Sink | None) -> Reporter:
    return Reporter() if on_message is None else Reporter(on_message)


def _path(path: PathLike | None) -> Path | None:
    return None if path is None else Path(path)
