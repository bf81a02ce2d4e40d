# SPDX-License-Identifier: GPL-3.0-or-later
"""Synthetic building scenes with truth: described here, rendered by a Python that has ``bpy``, cached on disk.

``python -m benchmarks.scenes demo`` makes a folder with ``images/``, ``masks/`` (0 background, 1 building,
255 occluder), ``elements/`` (the same with 2..254 for windows, doors, roof planes ...), ``truth.ply`` with the
material of each face (with ``--pixels`` also depth, normal and material per pixel, :mod:`benchmarks.truth`),
``sparse_truth/`` (true cameras), ``sparse/0`` (structure from motion from the photos, put onto the true frame),
``prompts.json`` and ``scene.json``. The frame is metres, z up, ground at 0. A stopped run goes on where it was.
"""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from filelock import FileLock
from numpy.typing import NDArray

from benchmarks.arguments import count
from benchmarks.buildings import BUILDINGS
from benchmarks.camera_path import Shot, plan
from benchmarks.catalogue import SCENES, SceneSpec, scene_spec, spec_dict
from benchmarks.develop import bend, develop, photo_frame, render_frame, write_photo
from benchmarks.prompts import click_prompts
from benchmarks.shapes import Part
from benchmarks.surroundings import surroundings
from benchmarks.truth import MATERIALS, write_pixels, write_truth
from mgf_engine.cli.arguments import Parser
from mgf_engine.errors import BadInput
from mgf_engine.files.atomic import write_json
from mgf_engine.model.masks import BACKGROUND, BUILDING, FIRST_ELEMENT, IGNORE
from mgf_engine.system.machine import user_cache

#: Part of the cache key: raise it when the same spec gives other pictures than before.
GENERATOR_VERSION = 1
Say = Callable[[str], None]


def cache_root() -> Path:
    """Return where rendered scenes are kept: ``$MGF_SCENES``, or ``mgf/scenes`` in the user's cache folder."""
    return Path(os.environ["MGF_SCENES"]) if os.environ.get("MGF_SCENES") else user_cache() / "scenes"


def scene_folder(name: str, spec: SceneSpec) -> Path:
    """Return the cache folder of a spec; its name ends in a hash of every control that is not at its default."""
    plain = spec_dict(SceneSpec())
    changed = {k: v for k, v in spec_dict(spec).items() if v != plain[k] and k != "held_out"}
    key = json.dumps([GENERATOR_VERSION, changed], sort_keys=True)
    return cache_root() / f"{name}-{hashlib.sha256(key.encode()).hexdigest()[:10]}"


def make_scene(name: str, spec: SceneSpec, blender: Path | None = None, threads: int = 2, say: Say = print) -> Path:
    """Make the folder of a scene, rendered now if the cache does not have it.

    Args:
        name: used in the folder's name only.
        blender: a Python with ``bpy``; None looks at ``$MGF_BPY_PYTHON`` and for ``.venv-bpy`` up from here.

    Raises:
        BadInput: there is no Python with ``bpy``, or rendering failed.
    """
    folder = scene_folder(name, spec)
    if (folder / "scene.json").exists():
        if not (folder / MATERIALS).exists():  # made by an earlier version
            write_truth(folder, building_parts(spec))
        return folder
    (folder / "work").mkdir(parents=True, exist_ok=True)
    with FileLock(str(folder / "work/lock")):
        if not (folder / "scene.json").exists():
            _make(folder, name, spec, blender, threads, say)
    return folder


def _make(folder: Path, name: str, spec: SceneSpec, blender: Path | None, threads: int, say: Say) -> None:
    building, extent, shots, labels = render_views(folder, spec, blender, threads, say)
    write_truth(folder, building)
    _write_models(folder, spec, shots, say)
    click_prompts(folder / "prompts.json", [s.name for s in shots], _poses(shots), labels)
    middle = [*extent.mean(0), 5.0]
    distance = float(np.median([np.linalg.norm(eye - middle) for eye in _poses(shots)[:, :3]]))
    camera = photo_frame(spec)
    record = {
        "name": name, "version": GENERATOR_VERSION, "unit": "metre", "up": "z", "spec": spec_dict(spec),
        "camera": {**camera._asdict(), "lens": list(spec.lens)},
        "ground_pixel": distance / camera.fx,
        "elements": {key: value for key, value in element_ids(building).items() if value >= FIRST_ELEMENT},
    }  # fmt: skip
    write_json(folder / "scene.json", record)


def render_views(
    folder: Path, spec: SceneSpec, blender: Path | None, threads: int, say: Say
) -> tuple[list[Part], NDArray[np.float64], list[Shot], list[NDArray[np.uint8]]]:
    """Render photos and true masks of a scene; pictures that are there already are kept.

    Returns:
        the building's parts, its extent [2, 2] on the ground, the shots, and the true level-one masks.
    """
    (folder / "work").mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(spec.seed)
    building = building_parts(spec)
    corners = np.concatenate([p.vertices[:, :2] for p in building])
    extent = np.stack([corners.min(0), corners.max(0)])
    nadir = None if spec.nadir is None else dict(zip(("height", "half_x", "half_y"), spec.nadir, strict=True))
    shots = plan(spec.photos, extent, spec.rings, nadir, spec.exposure, spec.exposure_spread, rng, spec.arc)
    eyes = _poses(shots)[:, :3]
    around = surroundings(extent, eyes, rng, spec.trees, spec.trees_in_front, spec.neighbours, spec.cars, spec.wall)
    ids = element_ids(building)
    numbered = [(ids[part.element] if part.building else BACKGROUND, part) for part in (*building, *around)]
    write_render_job(folder, spec, numbered, shots, threads)
    run_blender(folder, blender, say)
    _develop(folder, spec, shots)
    return building, extent, shots, _write_masks(folder, spec, shots)


def building_parts(spec: SceneSpec) -> list[Part]:
    """Return the building of a scene, its roof in the wanted material."""
    parts = BUILDINGS[spec.building](spec.wall)
    if not spec.roof:
        return parts
    return [replace(p, material=spec.roof) if p.element.startswith("roof.") else p for p in parts]


def element_ids(parts: Sequence[Part]) -> dict[str, int]:
    """Element name -> label; plain structure is BUILDING, the elements count from FIRST_ELEMENT on.

    More elements than labels share them in turn (ids are only local to an image for the losses).
    """
    names = dict.fromkeys(p.element for p in parts if p.element)
    room = IGNORE - FIRST_ELEMENT
    return {"": BUILDING, **{name: FIRST_ELEMENT + i % room for i, name in enumerate(names)}}


def write_render_job(
    folder: Path, spec: SceneSpec, numbered: Sequence[tuple[int, Part]], shots: list[Shot], threads: int
) -> None:
    """Write what ``benchmarks/blender/render.py`` reads: ``work/parts.npz`` and ``work/job.json``.

    Args:
        folder: of the scene.
        spec: light and camera.
        numbered: all parts with their labels; those of the building are not :data:`BACKGROUND`.
        shots: of the camera.
        threads: of Blender.
    """
    arrays: dict[str, NDArray[Any]] = {}
    table = []
    for i, (number, part) in enumerate(numbered):
        arrays[f"v{i}"] = part.vertices
        arrays[f"l{i}"] = np.array([k for face in part.faces for k in face], dtype=np.int32)
        arrays[f"s{i}"] = np.array([len(face) for face in part.faces], dtype=np.int32)
        table.append({"name": part.name, "material": part.material, "building": number != BACKGROUND, "id": number})
    np.savez_compressed(folder / "work/parts.npz", table=np.array(json.dumps(table)), **arrays)  # type: ignore[arg-type]
    keys = ("texture_strength", "sun_elevation", "sun_azimuth", "sun_strength", "sky_strength", "samples", "seed",
            "denoiser", "pixel_filter")  # fmt: skip
    rows = [{**asdict(s), "rotation": s.rotation.tolist(), "translation": s.translation.tolist()} for s in shots]
    job = {**render_frame(spec)._asdict(), **{k: getattr(spec, k) for k in keys}, "threads": threads, "shots": rows}
    write_json(folder / "work/job.json", job)


def find_blender_python() -> Path:
    """Find a Python interpreter that has ``bpy``.

    Raises:
        BadInput: none is found.
    """
    given = os.environ.get("MGF_BPY_PYTHON")
    around = [p / ".venv-bpy/bin/python" for p in (Path.cwd(), *Path(__file__).resolve().parents)]
    for place in [Path(given)] if given else around:
        if place.exists():
            return place
    raise BadInput(
        "No Python with bpy was found; make one with 'python3.11 -m venv .venv-bpy && "
        ".venv-bpy/bin/pip install bpy==5.0.1' or set MGF_BPY_PYTHON."
    )


def run_blender(folder: Path, blender: Path | None, say: Say) -> None:
    """Render the pictures of a job that :func:`write_render_job` wrote, into ``work``; those that are there are kept.

    Raises:
        BadInput: Blender does not start, or fails.
    """
    for kind in ("photos", "ids", "alone"):
        (folder / "work" / kind).mkdir(exist_ok=True)
    script = Path(__file__).with_name("blender") / "render.py"
    command = [str(blender or find_blender_python()), str(script), str(folder)]
    with (folder / "work/render.log").open("w", encoding="utf-8") as log:
        try:
            process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log, text=True)
        except OSError as error:
            raise BadInput(f"Cannot start '{command[0]}' ({error.strerror}); name a Python that has bpy.") from error
        assert process.stdout is not None
        for line in process.stdout:
            log.write(line)
            if line.startswith("rendered "):
                say(line.strip())
    if process.wait() != 0:
        raise BadInput(f"Rendering the scene failed; '{folder / 'work/render.log'}' says why.")


def _develop(folder: Path, spec: SceneSpec, shots: list[Shot]) -> None:
    """Rendered pictures -> photos."""
    (folder / "images").mkdir(exist_ok=True)
    for i, shot in enumerate(shots):
        picture = read_png(folder / "work/photos" / (Path(shot.name).stem + ".png"), cv2.IMREAD_COLOR)
        write_photo(folder / "images" / shot.name, develop(spec, picture, i), spec.jpeg)


def read_png(path: Path, flags: int = cv2.IMREAD_UNCHANGED) -> NDArray[np.uint8]:
    """Read a rendered picture, [height, width] or [height, width, channels].

    Raises:
        BadInput: it cannot be read.
    """
    picture = cv2.imread(str(path), flags)
    if picture is None:
        raise BadInput(f"The rendered picture '{path}' cannot be read; delete it and run again.")
    return np.asarray(picture, dtype=np.uint8)


def _write_masks(folder: Path, spec: SceneSpec, shots: list[Shot]) -> list[NDArray[np.uint8]]:
    """True label maps: what the photo shows of the building, and what hides it."""
    result = []
    for kind in ("masks", "elements"):
        (folder / kind).mkdir(exist_ok=True)
    for shot in shots:
        stem = Path(shot.name).stem + ".png"
        seen, alone = read_png(folder / "work/ids" / stem), read_png(folder / "work/alone" / stem)
        seen, alone = (bend(spec, a if a.ndim == 2 else a[..., 0], labels=True) for a in (seen, alone))
        elements = np.where((seen == BACKGROUND) & (alone != BACKGROUND), IGNORE, seen).astype(np.uint8)
        level_one = np.where((elements >= FIRST_ELEMENT) & (elements != IGNORE), BUILDING, elements).astype(np.uint8)
        cv2.imwrite(str(folder / "elements" / stem), elements)
        cv2.imwrite(str(folder / "masks" / stem), level_one)
        result.append(level_one)
    return result


def _write_models(folder: Path, spec: SceneSpec, shots: list[Shot], say: Say) -> None:
    from benchmarks.features import sfm_model, truth_model

    shift = np.random.default_rng([spec.seed, 2]).normal(0, spec.pose_error, (len(shots), 3))
    true = truth_model(folder, shots, photo_frame(spec), shift, spec.lens)
    say(f"true cameras: {true.num_reg_images()} photos, {true.num_points3D()} points")
    found = sfm_model(folder, shots, photo_frame(spec), spec.lens, refine_focal=bool(spec.rings))
    say(f"structure from motion: {found.num_reg_images()} photos, {found.num_points3D()} points")


def _poses(shots: list[Shot]) -> NDArray[np.float64]:
    """Camera centres and viewing directions, [N, 6]."""
    return np.array([[*(-s.rotation.T @ s.translation), *s.rotation[2]] for s in shots])


def scenes_main(argv: Sequence[str] | None = None) -> int:
    """Run ``mgf bench scenes NAME``: make a scene and print its folder."""
    parser = Parser(prog="mgf bench scenes", description="Render a synthetic building scene with known truth.")
    parser.add_argument("name", choices=sorted(SCENES), help="which scene")
    parser.add_argument("--photos", type=int, help="number of photos")
    parser.add_argument("--resolution", type=int, help="width of the photos in pixels")
    parser.add_argument("--samples", type=int, help="Cycles samples per pixel")
    parser.add_argument("--seed", type=int, help="another flight and other surroundings")
    parser.add_argument("--pixels", action="store_true", help="also write depth, normal and material of each pixel")
    parser.add_argument("--link", type=Path, help="put a link to the folder here")
    parser.add_argument("--blender", type=Path, help="a Python that has bpy")
    parser.add_argument("--threads", type=count, default=2, help="threads of the renderer")
    args = parser.parse_args(argv)
    spec = scene_spec(args.name, photos=args.photos, width=args.resolution, samples=args.samples, seed=args.seed)
    folder = make_scene(
        args.name, spec, args.blender, args.threads, say=lambda text: print(text, file=sys.stderr, flush=True)
    )
    if args.pixels:
        write_pixels(folder, spec)
    if args.link:
        _link(args.link, folder)
    print(folder)
    return 0


def _link(path: Path, folder: Path) -> None:
    if path.exists() and not path.is_symlink():
        raise BadInput(f"'{path}' is there already and is no link; give another place.")
    path.unlink(missing_ok=True)
    path.symlink_to(folder, target_is_directory=True)


if __name__ == "__main__":
    try:
        sys.exit(scenes_main())
    except BadInput as error:
        print(error, file=sys.stderr)
        sys.exit(2)
