# SPDX-License-Identifier: GPL-3.0-or-later
"""The steps of a job as functions: read the scene, make masks, train, extract the mesh, render."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from mgf_engine.api.arguments import PathLike, make_reporter, optional_path
from mgf_engine.field import trainer
from mgf_engine.geometry.mesh_files import in_scene
from mgf_engine.georef.adjust import fit_to_control
from mgf_engine.masks.build import build_masks
from mgf_engine.masks.prompts import PromptsFile, clicked_names
from mgf_engine.mesh import extract
from mgf_engine.mesh.options import ExtractionOptions
from mgf_engine.messages import Reporter, Sink
from mgf_engine.model.gaussians import Gaussians
from mgf_engine.model.masks import MaskSet
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.scene import Scene, View
from mgf_engine.options.config import Config, make_config
from mgf_engine.pipeline import prepare
from mgf_engine.raster.api import Camera, Rendering
from mgf_engine.raster.api import render as render_gaussians
from mgf_engine.scene.load import load_scene
from mgf_engine.start.store import FILE as START
from mgf_engine.start.store import read_start


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
    (8, 160, 3)

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
    config, reporter = _prepare_step("scene", options, on_message)
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
    config, reporter = _prepare_step("masks", options, on_message)
    folder = scene.folder.parent / "masks"
    return build_masks(scene, optional_path(prompts), optional_path(masks), folder, config, reporter)


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
    config, reporter = _prepare_step("field", options, on_message)
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
    config, reporter = _prepare_step("mesh", options, on_message)
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


def _prepare_step(stage: str, options: dict[str, Any], on_message: Sink | None) -> tuple[Config, Reporter]:
    """Check the options, make the reporter, and set device, threads and seeds as a job does."""
    config, reporter = make_config(options), make_reporter(on_message)
    prepare(config, reporter)
    reporter.stages = (stage,)
    reporter.stage(stage)
    return config, reporter
