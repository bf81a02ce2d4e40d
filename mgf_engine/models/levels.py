# SPDX-License-Identifier: GPL-3.0-or-later
"""The files that levels of detail go into: GLB, 3D Tiles and USD."""

from __future__ import annotations

from functools import partial

from mgf_engine.files.atomic import write_json
from mgf_engine.geometry.mesh_files import IMAGE, encode_jpeg, write_glb
from mgf_engine.georef.export import GLTF_AXES, extras
from mgf_engine.messages import Reporter
from mgf_engine.model.mesh import Mesh, Texture
from mgf_engine.models.atlas import AtlasOptions, transfer_texture
from mgf_engine.models.draco import compress_glb
from mgf_engine.models.lod import LodOptions, measure_deviation, reduce_chain, silhouette_overlap
from mgf_engine.models.place import to_geocentric
from mgf_engine.models.tiles import FILE as TILESET
from mgf_engine.models.tiles import make_tileset
from mgf_engine.models.usd import FILE as PACKAGE
from mgf_engine.models.usd import write_usd
from mgf_engine.models.work import Work

_REDUCED, _PAINTED, _WRITTEN = 0.2, 0.6, 0.7  # shares of the work


def write_levels(work: Work) -> None:
    """Make the levels, and write them in every form that is wanted."""
    with work.cost.of("levels of detail"):
        chain = reduce_chain(
            work.survey.mesh,
            work.wanted.errors,
            lambda share: work.reporter.progress(_REDUCED * share),
            work.config.algorithm(LodOptions),
        )
    for k, mesh in enumerate(chain):
        begun, length = _REDUCED + (_PAINTED - _REDUCED) * k / len(chain), (_PAINTED - _REDUCED) / len(chain)
        with work.cost.of("textures of levels"):
            work.levels.append((mesh, _texture_of(work, mesh, k, partial(_share, work.reporter, begun, length))))
    if "lod" in work.wanted.kinds or "tiles" in work.wanted.kinds:
        with work.cost.of("levels of detail"):
            errors = [_write_level(work, k, len(chain)) for k in range(len(chain))]
    if "tiles" in work.wanted.kinds:
        _write_tiles(work, errors)
    if "usd" in work.wanted.kinds:
        work.reporter.progress(_WRITTEN)
        with work.cost.of("USD"):
            write_usd(work.add(PACKAGE, kind="usd", levels=len(chain)), work.levels, work.survey)


def _share(reporter: Reporter, begun: float, length: float, share: float) -> None:
    reporter.progress(begun + length * share)


def _texture_of(work: Work, mesh: Mesh, level: int, progress: partial[None]) -> Texture | None:
    if work.texture is None or level == 0:
        return work.texture
    side = work.texture.image.shape[1] >> level
    return transfer_texture(mesh, work.survey.mesh, work.texture, side, progress, work.config.algorithm(AtlasOptions))


def _write_level(work: Work, level: int, count: int) -> float:
    """Write a GLB, one of ``count``; returns how far it lies from the full mesh (95 % of both surfaces)."""
    work.reporter.progress(_PAINTED + (_WRITTEN - _PAINTED) * level / count)
    full, (mesh, texture) = work.survey.mesh, work.levels[level]
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
    if work.wanted.draco:
        compress_glb(path)
    work.files[path.name]["bytes"] = path.stat().st_size
    return deviation.p95


def _write_tiles(work: Work, errors: list[float]) -> None:
    """Write the tileset of the levels of detail; ``errors``: of each, metres."""
    place = to_geocentric(work.survey)
    if place is None:
        work.reporter.warning(
            "Nobody knows where on Earth the building stands, so its 3D Tiles lie at the centre of the globe; give "
            "the job GPS or a coordinate reference system with 'mgf georef'."
        )
    names = [f"mesh_lod{k}.glb" for k in range(len(errors))]
    path = work.add(TILESET, kind="tiles", placed=place is not None)
    write_json(path, make_tileset(names, errors, work.survey.mesh.vertices, place))
