# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of the stages of a job.

Job folder, pipeline, command line, messages, report and panel are generated from it. To add a stage, add an entry to
:data:`STAGES` and write the function that its ``run`` names; ``docs/architecture.md`` shows the table. This module
imports nothing of the engine, so that every module may import it. Functions are named as ``module:function`` and
imported when they are called, so that ``mgf --help`` does not load torch.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any

#: File of the job folder that scripts and Blender read first; written last, when every file that it names exists.
MANIFEST = "deliver.json"


@dataclass(frozen=True)
class Output:
    """A file or folder that a stage writes.

    Attributes:
        path: relative to the job folder; deleted before the stage runs again with other inputs or options.
        name: key in the message ``result`` and in the report; empty for internal files.
        required: whether the stage counts as not done while this file is missing.
        option: the switch that must be on for this output; empty if it is always written.
        kept: whether each finished run keeps a copy (``runs/NUMBER``).
        manifest: key in ``deliver.json``; empty for files that Blender does not read.
    """

    path: str
    name: str = ""
    required: bool = False
    option: str = ""
    kept: bool = False
    manifest: str = ""


@dataclass(frozen=True)
class Stage:
    """One step of a job.

    Attributes:
        name: used in commands, messages, options and the job file.
        help: one line for ``mgf --help``.
        progress: text that the panel shows while the stage runs.
        share: share of the time of a typical job (0..1), for the progress bar if there is no estimate.
        run: ``module:function`` with the signature ``(job, reporter) -> figures``.
        sections: section of options -> its heading in the panel; all options of these sections affect the result.
        options: options of other sections that affect the result.
        inputs: files of the user that it reads: ``photos``, ``prompts`` (clicks or masks) or ``survey`` (control
            points, marks, scale bars); empty for none.
        reads: names of the stages whose results it reads.
        outputs: files and folders that it writes.
        user_facing: whether its outputs are results for the user: they must exist even if no later stage reads them.
        cost: ``cpu`` (seconds on one core), ``serial`` (the share of them that cannot run in parallel) and ``bytes``
            (peak memory); :mod:`mgf_engine.costs` explains the terms.
    """

    name: str
    help: str
    progress: str
    share: float
    run: str
    sections: dict[str, str]
    outputs: tuple[Output, ...]
    cost: dict[str, Any]
    options: tuple[str, ...] = ()
    inputs: str = ""
    reads: tuple[str, ...] = ()
    user_facing: bool = False

    @property
    def output_paths(self) -> tuple[str, ...]:
        """Files and folders that the stage writes, without those inside one of these folders."""
        paths = [output.path for output in self.outputs]
        return tuple(p for p in paths if not any(p.startswith(other + "/") for other in paths))

    @property
    def required_outputs(self) -> tuple[str, ...]:
        """Files that must exist for the stage to count as done, whatever the options."""
        return tuple(output.path for output in self.outputs if output.required and not output.option)

    @property
    def optional_outputs(self) -> dict[str, tuple[str, ...]]:
        """Name of a switch -> the files that the stage writes if it is on."""
        options = dict.fromkeys(o.option for o in self.outputs if o.option)
        return {name: tuple(o.path for o in self.outputs if o.option == name) for name in options}

    def runner(self) -> Callable[..., dict[str, Any]]:
        """Import the function named by ``run``."""
        module, _, function = self.run.partition(":")
        found: Callable[..., dict[str, Any]] = getattr(import_module(module), function)
        return found


STAGES: tuple[Stage, ...] = (
    Stage(
        name="scene",
        help="read cameras and photos, undistort and resize them",
        progress="Reading photos",
        share=0.03,
        run="mgf_engine.runners.scene:run_scene",
        sections={"scene": "Scene"},
        inputs="photos",
        outputs=(Output("scene"), Output("scene/scene.npz", required=True)),
        cost={
            "cpu": {
                "": 0.2, "photos taken": 0.045, "photos pixels": 0.025,
                "unplaced found": 3.0, "pairs": 0.012, "pairs found": 0.06,
            },
            "serial": 0.3,
            "bytes": {"": 0.42e9, "photos pixels": 3.5e6, "threads taken": 17e6, "unplaced": 4e6},
        },
    ),
    Stage(
        name="masks",
        help="find the building in every photo",
        progress="Finding the building",
        share=0.07,
        run="mgf_engine.runners.masks:run_masks",
        sections={"masks": "Masks"},
        options=("multilevel_loss", "boundary_loss"),
        inputs="prompts",
        reads=("scene",),
        outputs=(
            Output("masks"),
            Output("masks/scores.json", required=True),
            Output("masks/contact_sheet.jpg", "masks"),
        ),
        cost={
            "cpu": {"photos": 0.21, "photos pixels": 0.73},
            "serial": 0.15,
            "bytes": {"": 0.53e9, "photos pixels": 11e6, "threads pixels": 80e6},
        },
    ),
    Stage(
        name="field",
        help="train the masked Gaussian field",
        progress="Training",
        share=0.75,
        run="mgf_engine.runners.field:run_field",
        sections={"field": "Field"},
        options=("seed", "device", "blocks"),
        reads=("scene", "masks"),
        outputs=(
            Output("checkpoints"),
            Output("checkpoints/field.npz", required=True),
            Output("blocks/start"),
            Output("field.ply", "field", kept=True, manifest="field"),
        ),
        cost={
            "cpu": {
                "": 1.3, "surface": 5.9,
                "passes": 0.0076, "passes gaussians": 0.067, "passes pixels": 0.01,
            },
            "serial": 0.15,
            "bytes": {
                "": 0.55e9, "surface": 0.03e9, "block_surface": 0.025e9, "gaussians": 0.05e9, "threads pixels": 30e6,
            },
        },
    ),
    Stage(
        name="mesh",
        help="extract the mesh from the field",
        progress="Making the mesh",
        share=0.12,
        run="mgf_engine.runners.mesh:run_mesh",
        sections={"mesh": "Mesh"},
        options=("device", "blocks"),
        reads=("scene", "masks", "field"),
        user_facing=True,
        outputs=(
            Output("blocks/mesh"),
            Output("mesh.ply", "mesh", required=True, kept=True, manifest="mesh"),
            Output("mesh_parts.npz", kept=True, manifest="parts"),
        ),
        cost={
            "cpu": {"": 4.8, "building": 4.4, "photos building": 0.037},
            "serial": 0.15,
            "bytes": {
                "": 0.45e9, "building": 0.065e9, "gaussians": 0.2e9, "block_gaussians": 0.35e9, "threads pixels": 40e6,
            },
        },
    ),
    Stage(
        name="deliver",
        help="render novel views and write the report",
        progress="Rendering and reporting",
        share=0.03,
        run="mgf_engine.export.stage:deliver",
        sections={"deliver": "Output", "georef": "Georeference"},
        options=("device",),
        inputs="survey",
        reads=("scene", "masks", "field", "mesh"),
        user_facing=True,
        outputs=(
            Output("mesh.obj", "obj", option="export_obj", kept=True),
            Output("mesh.glb", "glb", option="export_glb", kept=True),
            Output("texture.jpg", "texture", option="texture", kept=True, manifest="texture"),
            Output("mesh_texture.npz", option="texture", kept=True, manifest="texture_uv"),
            Output("mesh.mtl", kept=True),
            Output("report.html", "report", required=True, kept=True, manifest="report"),
            Output("report.json", "figures", required=True, kept=True),
            Output("report", kept=True),
            Output("renders", "renders", kept=True),
            Output("georef.json", kept=True),
            Output("georeferenced", "georeferenced", kept=True),
            Output(MANIFEST, required=True),
        ),
        cost={
            "cpu": {"": 1.6, "photos pixels": 0.03, "textured": 0.42, "measured pixels": 0.6},
            "serial": 0.3,
            "bytes": {"": 0.25e9, "building": 0.01e9, "gaussians": 0.85e9, "texture": 6e6, "threads pixels": 280e6},
        },
    ),
)  # fmt: skip
STAGE_NAMES = tuple(stage.name for stage in STAGES)
#: Section of the options that belong to no stage: how a job runs.
RUN_SECTION = {"run": "Run"}
#: Section of options -> its heading, in the order of panel and docs.
SECTIONS: dict[str, str] = {**RUN_SECTION, **{k: v for stage in STAGES for k, v in stage.sections.items()}}
_BY_NAME = {stage.name: stage for stage in STAGES}


def stage_named(name: str) -> Stage:
    """Return the stage of a name.

    Raises:
        KeyError: there is no such stage.
    """
    return _BY_NAME[name]


def stage_of_section(section: str) -> Stage:
    """Return the first stage whose result depends on the options of a section.

    Raises:
        StopIteration: there is no such stage.
    """
    return next(stage for stage in STAGES if section in stage.sections)


def outputs() -> list[Output]:
    """Return the outputs of all stages, in order."""
    return [output for stage in STAGES for output in stage.outputs]
