# SPDX-License-Identifier: GPL-3.0-or-later
"""Work without a window: run a job, import a COLMAP scene and the job's results, and save a .blend.

``batch.py`` is the script that calls it, ``blender --command mgf import`` the other way in. Exit codes are those of the
engine: 0 done, 2 bad input, 3 cancelled, 1 fault.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import sys
import traceback
from pathlib import Path
from typing import Any, NoReturn

import bpy

from .common.errors import UserError
from .common.files import cannot_write
from .common.job import EXIT_BAD_INPUT, EXIT_CANCELLED, EXIT_DONE, EXIT_FAULT, Job
from .drawings.properties import KINDS as DRAWINGS
from .engine import environment
from .models.properties import KINDS as MODELS
from .results.load import import_result
from .results.picture import render_picture
from .scene_import.imported_scene import ImportedScene
from .scene_import.load import import_scene


class Parser(argparse.ArgumentParser):
    """Reports a mistake in one sentence, without the usage text of argparse."""

    def error(self, message: str) -> NoReturn:
        self.exit(EXIT_BAD_INPUT, f"Error: {message[:1].upper()}{message[1:]}; --help lists all arguments.\n")


def parser() -> argparse.ArgumentParser:
    """Return the options of a headless run."""
    p = Parser(prog="mgf batch", description="Import a scene and a job's results; save a .blend.")
    p.add_argument("--scene", type=Path, help="COLMAP model or project folder: cameras with photos, sparse points")
    p.add_argument("--photos", type=Path, help="folder of the photos; searched near the model when not given")
    p.add_argument("--job", type=Path, help="job folder: mesh, renders, figures")
    p.add_argument("--out", type=Path, required=True, help="the .blend to write")
    p.add_argument("--keep-axes", action="store_true", help="keep the model's axes instead of turning it upright")
    p.add_argument("--reconstruct", action="store_true", help="run the engine on the scene first; resumes a begun job")
    p.add_argument("--engine", type=Path, help="Python or environment that has the engine")
    p.add_argument("--prompts", type=Path, help="clicks on the building, for --reconstruct")
    p.add_argument("--masks", type=Path, help="folder of your own masks, for --reconstruct")
    p.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="an option of the engine")
    drawings, models = ([kind for kind, *_ in kinds] for kinds in (DRAWINGS, MODELS))
    p.add_argument("--drawings", nargs="*", choices=drawings, metavar="KIND",
                   help=f"also make the job's drawings: all, or some of {', '.join(drawings)}")  # fmt: skip
    p.add_argument("--models", nargs="*", choices=models, metavar="KIND",
                   help=f"also make the job's models: all, or some of {', '.join(models)}")  # fmt: skip
    p.add_argument("--progress", choices=("plain", "json"), default="plain", help="how the engine's progress is shown")
    p.add_argument("--picture", type=Path, help="also render the mesh to this PNG")
    p.add_argument("--picture-engine", choices=("cycles", "workbench", "eevee"), default="cycles",
                   help="what renders the picture")  # fmt: skip
    p.add_argument("--picture-size", type=int, nargs=2, default=(1280, 800), metavar=("W", "H"),
                   help="of the picture, in pixels")  # fmt: skip
    p.add_argument("--picture-samples", type=int, default=48, help="rays per pixel of the picture (cycles)")
    p.add_argument("--picture-turn", type=float, default=30.0, help="degrees around the building from the cameras")
    return p


def main(argv: list[str]) -> int:
    """Run with the given arguments; returns the exit code."""
    try:
        args = parser().parse_args(argv)
    except SystemExit as error:
        return int(error.code or 0)
    try:
        return _run(args)
    except UserError as error:
        print(f"Error: {error}", file=sys.stderr)
        return EXIT_BAD_INPUT
    except KeyboardInterrupt:
        print("Cancelled; run again to continue.", file=sys.stderr)
        return EXIT_CANCELLED
    except Exception:
        traceback.print_exc()
        return EXIT_FAULT


def _run(args: argparse.Namespace) -> int:
    """Reconstruct, import and deliver what was asked for; returns the first exit code that is not 0."""
    if args.scene is None and args.job is None:
        raise UserError("Nothing to import; give --scene, --job or both.")
    if args.job is None and (args.drawings is not None or args.models is not None):
        raise UserError("Drawings and models are made of a job; give --job.")
    if args.engine is not None:
        os.environ[environment.VARIABLE] = str(args.engine)
    if args.reconstruct:
        code = _reconstruct(args)
        if code != EXIT_DONE:
            return code
    _import(args)
    return _deliver(args)


def _reconstruct(args: argparse.Namespace) -> int:
    """Run the engine as the panel does, but wait for it; returns its exit code."""
    if args.scene is None or args.job is None:
        raise UserError("A reconstruction needs --scene and --job.")
    command = ["reconstruct", str(args.scene.absolute()), "--out", str(args.job.absolute())]
    for flag, path in (("--prompts", args.prompts), ("--masks", args.masks)):
        if path is not None:
            command += [flag, str(path.absolute())]
    for text in args.set:
        command += ["--set", text]
    if (args.job / "job.json").is_file():
        command.append("--resume")
    return _run_engine(args, command)


def _deliver(args: argparse.Namespace) -> int:
    """Make the drawings and models that were asked for; returns the first exit code that is not 0."""
    wanted = []
    if args.drawings is not None:
        wanted.append(["drawings", *(word for kind in args.drawings for word in ("--draw", kind))])
    if args.models is not None:
        wanted.append(["models", *(["--only", ",".join(args.models)] if args.models else [])])
    for command, *options in wanted:
        code = _run_engine(args, [command, str(args.job.absolute()), *options])
        if code != EXIT_DONE:
            return code
        print(f"{command.capitalize()} in {args.job / command}", flush=True)
    return EXIT_DONE


def _run_engine(args: argparse.Namespace, command: list[str]) -> int:
    """Run a command of the engine, show what it says and wait for it; returns its exit code."""
    line = environment.engine_command(*command, "--progress", "json", "--cancel-on-eof")
    show = _show_json if args.progress == "json" else _Plain()
    job = Job(line, args.job.absolute(), "job", command[0], on_message=show)
    code = job.run()
    if code != EXIT_DONE:
        if args.progress == "plain":
            where = f" (log: {job.log})" if job.log and code == EXIT_FAULT else ""
            print(f"{'' if code == EXIT_CANCELLED else 'Error: '}{job.text}{where}", file=sys.stderr)
        if code == EXIT_FAULT and not job.log:
            print("\n".join(job.last_errors), file=sys.stderr)
    return code if code in (EXIT_DONE, EXIT_BAD_INPUT, EXIT_CANCELLED) else EXIT_FAULT


def _show_json(job: Any, message: dict[str, Any]) -> None:
    print(json.dumps(message, ensure_ascii=False, separators=(",", ":")), flush=True)


class _Plain:
    """A line per stage, per tenth of a stage, and per warning."""

    def __init__(self) -> None:
        self._shown = -1

    def __call__(self, job: Any, message: dict[str, Any]) -> None:
        kind = message["type"]
        if kind == "stage":
            self._shown = -1
            print(f"[{job.stage_index + 1}/{job.stage_count}] {job.stage}", flush=True)
        elif kind == "progress" and int(job.fraction * 10) > self._shown:
            self._shown = int(job.fraction * 10)
            left = "" if job.seconds_left is None else f"  {job.seconds_left:.0f} s left"
            figures = "  ".join(f"{k.replace('_', ' ')} {v}" for k, v in job.figures.items())
            print(f"  {job.fraction:4.0%}{left}  {figures}", flush=True)
        elif kind == "warning":
            print(f"Warning: {message.get('text', '')}", flush=True)


def _import(args: argparse.Namespace) -> None:
    """Import scene and results into an empty file, save it, and render its picture."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene, imported = bpy.context.scene, None
    source = _model_source(args)
    if source is not None:
        photos = args.photos or (args.scene if source != args.scene else None)
        done = import_scene(scene, source, photos, upright=not args.keep_axes, named=args.scene)
        imported = done.imported
        print("{cameras} cameras, {points} points".format(**done.counts()), *done.warnings, sep="\n")
    if args.job is not None:
        result = import_result(scene, args.job, imported)
        imported = result.imported
        faces = len(result.mesh.data.polygons) if result.mesh is not None else 0
        print(f"Mesh of {faces} faces, {result.renders} renders")
    scene.view_settings.view_transform = "Standard"  # colours are those of the photos
    if args.picture is not None and not imported.objects("Mesh"):
        raise UserError("There is no mesh to make a picture of; give --job with a finished job.")
    save(args.out.absolute())
    print(f"Saved {args.out}")
    if args.picture is not None:  # last: a picture that fails costs nothing else
        _picture(args, scene, imported)


def _model_source(args: argparse.Namespace) -> Path | None:
    """Return the COLMAP model to import: the scene's own, or the one the engine found for a folder of photos."""
    found = args.job / "scene" / "sfm" / "model" if args.job is not None else None
    if args.scene is not None and found is not None and (found / "images.bin").is_file():
        return found
    return args.scene


def _picture(args: argparse.Namespace, scene: bpy.types.Scene, imported: ImportedScene) -> None:
    path = args.picture.absolute()
    path.parent.mkdir(parents=True, exist_ok=True)
    size, engine = tuple(args.picture_size), args.picture_engine.upper()
    render_picture(scene, imported, path, size, args.picture_samples, engine, args.picture_turn)
    print(f"Picture {path}")


def save(path: Path) -> None:
    """Write the .blend to a temporary name first, so that a full disk leaves no half file.

    Raises:
        UserError: the file cannot be written.
    """
    temporary = path.with_name(f".{path.stem}.writing.blend")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        bpy.ops.wm.save_as_mainfile(filepath=str(temporary), copy=True, compress=True, relative_remap=True)
        os.replace(temporary, path)
    except (RuntimeError, OSError) as error:
        for left in (temporary, temporary.with_name(temporary.name + "@")):
            with contextlib.suppress(OSError):
                left.unlink(missing_ok=True)
        raise UserError(cannot_write(path, error)) from error
