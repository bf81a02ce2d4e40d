# SPDX-License-Identifier: GPL-3.0-or-later
"""All models of a job, made in a folder beside the old ones and put in their place when they are whole."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mgf_engine.drawings.load import read_survey
from mgf_engine.drawings.model import Survey
from mgf_engine.geometry.mesh_files import COORDINATES, IMAGE, encode_jpeg, read_texture, write_glb
from mgf_engine.georef.export import GLTF_AXES, extras
from mgf_engine.job import locked
from mgf_engine.messages import Reporter
from mgf_engine.model.mesh import Mesh, Texture
from mgf_engine.models.atlas import transfer_texture
from mgf_engine.models.cityjson import FILE as CITYJSON
from mgf_engine.models.cityjson import make_cityjson
from mgf_engine.models.lod import measure_deviation, reduce_chain, silhouette_overlap
from mgf_engine.models.place import to_geocentric
from mgf_engine.models.solid.build import NoSolid, build_solid
from mgf_engine.models.tiles import FILE as TILESET
from mgf_engine.models.tiles import make_tileset
from mgf_engine.output_folder import Cost, check_place, new_folder
from mgf_engine.system import write_json

STAGE = "models"
INDEX = "models.json"
FORMAT = 1


@dataclass(frozen=True)
class ModelOptions:
    """What ``mgf models`` was asked for.

    Attributes:
        kinds: what to make, of ``command.NEEDED``.
        errors: distances of the coarser levels of detail from the mesh in the local unit; empty takes shares of faces.
        detail: of the solid in the local unit: what is smaller is left out; None takes it from photos and size.
    """

    kinds: Sequence[str] = ("lod", "tiles", "solid")
    errors: Sequence[float] = ()
    detail: float | None = None


@dataclass
class Work:
    """What the parts of a run share.

    Attributes:
        folder: where files go; files: name -> what is known about it, for ``models.json``.
    """

    job: Path
    survey: Survey
    texture: Texture | None
    wanted: ModelOptions
    folder: Path
    reporter: Reporter
    cost: Cost = field(default_factory=Cost)
    files: dict[str, dict[str, Any]] = field(default_factory=dict)

    def add(self, name: str, **facts: Any) -> Path:
        """The path of a file to write, on record with what is known about it."""
        self.files[name] = facts
        return self.folder / name


def make_models(job: Path, out: Path | None, wanted: ModelOptions, reporter: Reporter) -> Path:
    """Make everything that is wanted; returns the folder.

    Raises:
        BadInput: the job has no mesh, or something wanted is impossible.
    """
    reporter.stages = (STAGE,)
    reporter.stage(STAGE)
    folder = (out or job / STAGE).resolve()
    check_place(folder, INDEX, STAGE)
    cost = Cost()
    with locked(job), new_folder(folder) as beside:
        with cost.of("reading"):
            survey = read_survey(job)
            painted = (job / IMAGE).is_file() and (job / COORDINATES).is_file()
            texture = read_texture(job) if painted else None
        _tell(survey, reporter)
        work = Work(job, survey, texture, wanted, beside, reporter, cost)
        if "lod" in wanted.kinds or "tiles" in wanted.kinds:
            _levels(work)
        if "solid" in wanted.kinds:
            _solid(work, cost)
        write_json(beside / INDEX, _index(work))
    files = {name: str(folder / name) for name in work.files}
    figures = {"CPU seconds": round(sum(cost.seconds.values()))}
    reporter.send("result", path=str(folder), files=files, figures=figures)
    return folder


def _tell(survey: Survey, reporter: Reporter) -> None:
    if not survey.georeference.metric:
        reporter.warning(
            "The job has no true coordinates, so one unit of its scene counts as one metre in its models; run "
            "'mgf georef' first for true lengths."
        )


def _levels(work: Work) -> None:
    """Levels of detail as GLB, and the tileset of them."""
    full = work.survey.mesh
    with work.cost.of("levels of detail"):
        chain = reduce_chain(full, work.wanted.errors, lambda share: work.reporter.progress(0.3 * share))
    errors = []
    for k, mesh in enumerate(chain):
        part = partial(_share, work.reporter, 0.3 + 0.6 * k / len(chain), 0.6 / len(chain))
        with work.cost.of("textures"):
            texture = _texture_of(work, mesh, k, part)
        with work.cost.of("levels of detail"):
            errors.append(_write_level(work, mesh, texture, k))
    if "tiles" in work.wanted.kinds:
        place = to_geocentric(work.survey)
        if place is None:
            work.reporter.warning(
                "Nobody knows where on Earth the building stands, so its 3D Tiles lie at the centre of the globe; give "
                "the job GPS or a coordinate reference system with 'mgf georef'."
            )
        names = [f"mesh_lod{k}.glb" for k in range(len(chain))]
        path = work.add(TILESET, kind="tiles", placed=place is not None)
        write_json(path, make_tileset(names, errors, full.vertices, place))


def _share(reporter: Reporter, begun: float, length: float, share: float) -> None:
    reporter.progress(begun + length * share)


def _texture_of(work: Work, mesh: Mesh, level: int, progress: Any) -> Texture | None:
    if work.texture is None or level == 0:
        return work.texture
    side = work.texture.image.shape[1] >> level
    return transfer_texture(mesh, work.survey.mesh, work.texture, side, progress)


def _write_level(work: Work, mesh: Mesh, texture: Texture | None, level: int) -> float:
    """Write a GLB; returns how far it lies from the full mesh (95 % of both surfaces)."""
    full = work.survey.mesh
    deviation = measure_deviation(full, mesh)
    path = work.add(f"mesh_lod{level}.glb", kind="lod", level=level, faces=len(mesh.faces),
                    share=round(len(mesh.faces) / len(full.faces), 5), deviation=deviation.as_dict(),
                    silhouette=round(silhouette_overlap(full, mesh), 5))  # fmt: skip
    picture = None
    if texture is not None:
        picture = work.job / IMAGE if level == 0 else path.with_suffix(".jpg")
        if level > 0:
            picture.write_bytes(encode_jpeg(texture))
        work.files[path.name]["texture"] = list(texture.image.shape[1::-1])
    write_glb(mesh, path, texture, GLTF_AXES, extras(work.survey.georeference), picture)
    if picture is not None and level > 0:
        picture.unlink()
    work.files[path.name]["bytes"] = path.stat().st_size
    return deviation.p95


def _solid(work: Work, cost: Cost) -> None:
    """The solid as CityJSON; a sentence where there is none, or only a block."""
    with cost.of("solid"):
        try:
            solid = build_solid(work.survey, work.wanted.detail)
        except NoSolid as reason:
            work.reporter.warning(
                f"There is no solid of this building ({reason}); take photos from all sides, or give a larger --detail."
            )
            return
        if solid.level == 1:
            work.reporter.warning(
                "The photos do not show enough of the roof, so the solid is a block with a level top (LoD1)."
            )
        facts = {
            "kind": "solid", "lod": solid.level, "faces": len(solid.faces), "volume": round(solid.volume, 3),
            "ground": round(float(survey_height(work.survey, solid.ground)), 3), "ground_from": solid.ground_from,
            "detail": round(solid.detail, 4), "unseen": solid.unseen,
            "deviation": None if solid.deviation is None else solid.deviation.as_dict(),
        }  # fmt: skip
        name = f"building-{work.job.resolve().name}"
        write_json(work.add(CITYJSON, **facts), make_cityjson(solid, work.survey, name))


def survey_height(survey: Survey, z: float) -> float:
    """Local height -> height of the CRS."""
    return float(survey.world(np.array([0.0, 0.0, z]))[2])


def _index(work: Work) -> dict[str, Any]:
    """What ``models.json`` holds, for Blender and scripts."""
    survey = work.survey
    to_scene = np.eye(4)
    to_scene[:3, 3] = survey.georeference.scene(np.zeros(3))
    to_scene[:3, :3] = (survey.georeference.scene(np.eye(3) @ survey.turn) - to_scene[:3, 3]).T
    place = to_geocentric(survey) if "tiles" in work.wanted.kinds else None
    return {
        "format": FORMAT, "unit": survey.georeference.unit, "crs": survey.georeference.crs,
        "offset": survey.world(np.zeros(3)).tolist(), "to_scene": to_scene.tolist(),
        "to_geocentric": None if place is None else place.tolist(), "files": work.files,
        "cpu_seconds": work.cost.seconds, "peak_memory": work.cost.memory,
    }  # fmt: skip
