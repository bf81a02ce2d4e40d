# SPDX-License-Identifier: GPL-3.0-or-later
"""Headless: import a COLMAP scene and a job's results and save a .blend, without a window.

    blender -b --python mgf_blender/batch.py -- --scene SCENE --job JOB --out demo.blend
    python mgf_blender/batch.py --scene SCENE --job JOB --out demo.blend        (an environment with bpy)

Exit codes are the engine's: 0 done, 2 bad input, 3 cancelled, 1 fault.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib.util
import os
import sys
from pathlib import Path

EXIT_DONE, EXIT_FAULT, EXIT_BAD_INPUT, EXIT_CANCELLED = 0, 1, 2, 3


def parser() -> argparse.ArgumentParser:
    """The options of a headless run."""
    p = argparse.ArgumentParser(prog="mgf batch", description="Import a scene and a job's results; save a .blend.")
    p.add_argument("--scene", type=Path, help="COLMAP model or project folder: cameras with photos, sparse points")
    p.add_argument("--photos", type=Path, help="folder of the photos; searched near the model when not given")
    p.add_argument("--job", type=Path, help="job folder: mesh, renders, figures")
    p.add_argument("--out", type=Path, required=True, help="the .blend to write")
    p.add_argument("--keep-axes", action="store_true", help="keep the model's axes instead of turning it upright")
    p.add_argument("--picture", type=Path, help="also render the mesh to this PNG")
    p.add_argument("--picture-engine", choices=("cycles", "workbench", "eevee"), default="cycles")
    p.add_argument("--picture-size", type=int, nargs=2, default=(1280, 800), metavar=("W", "H"))
    p.add_argument("--picture-samples", type=int, default=48)
    p.add_argument("--picture-turn", type=float, default=30.0, help="degrees around the building from the cameras")
    return p


def main(argv: list[str]) -> int:
    """Run with the given arguments; returns the exit code."""
    package = _package()
    import bpy

    UserError = importlib.import_module(f"{package}.common.errors").UserError
    args = parser().parse_args(argv)
    try:
        if args.scene is None and args.job is None:
            raise UserError("Nothing to import; give --scene, --job or both.")
        _run(package, args, bpy)
    except UserError as error:
        print(f"mgf: {error}", file=sys.stderr)
        return EXIT_BAD_INPUT
    except KeyboardInterrupt:
        print("mgf: cancelled", file=sys.stderr)
        return EXIT_CANCELLED
    return EXIT_DONE


def _run(package: str, args: argparse.Namespace, bpy) -> None:
    load_scene = importlib.import_module(f"{package}.scene_import.load")
    load_result = importlib.import_module(f"{package}.results.load")
    errors = importlib.import_module(f"{package}.common.errors")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene, tree = bpy.context.scene, None
    if args.scene is not None:
        done = load_scene.import_scene(scene, args.scene, args.photos, upright=not args.keep_axes)
        tree = done.tree
        print(f"mgf: {done.cameras} cameras, {done.points} points", *done.warnings, sep="\nmgf: ")
    if args.job is not None:
        result = load_result.import_result(scene, args.job, tree)
        tree = result.tree
        faces = len(result.mesh.data.polygons) if result.mesh is not None else 0
        print(f"mgf: mesh of {faces} faces, {result.renders} renders")
    _dress(scene)
    if args.picture is not None:
        if not tree.objects("Mesh"):
            raise errors.UserError("There is no mesh to make a picture of; give --job with a finished job.")
        picture = importlib.import_module(f"{package}.results.picture")
        path = args.picture.absolute()
        path.parent.mkdir(parents=True, exist_ok=True)
        picture.render_picture(
            scene, tree, path, tuple(args.picture_size), args.picture_samples, args.picture_engine.upper(),
            args.picture_turn,
        )  # fmt: skip
        print(f"mgf: picture {path}")
    save(bpy, args.out.absolute(), errors.UserError)
    print(f"mgf: saved {args.out}")


def _dress(scene) -> None:
    """Settings of a fresh file that suit colours out of photos."""
    scene.view_settings.view_transform = "Standard"


def save(bpy, path: Path, user_error: type[Exception]) -> None:
    """Write the .blend to a temporary name first, so that a full disk leaves no half file."""
    temporary = path.with_name(f".{path.stem}.writing.blend")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        bpy.ops.wm.save_as_mainfile(filepath=str(temporary), copy=True, compress=True, relative_remap=True)
        os.replace(temporary, path)
    except (RuntimeError, OSError) as error:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise user_error(f"Cannot save '{path}' ({error}); check the folder and the free space.") from error


def _package() -> str:
    """The name of the add-on's package; run as a script, the folder of this file is loaded as one."""
    if __package__:
        return __package__
    folder = Path(__file__).resolve().parent
    name = "mgf_blender"
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(
            name, folder / "__init__.py", submodule_search_locations=[str(folder)]
        )
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        spec.loader.exec_module(module)
    return name


if __name__ == "__main__":
    arguments = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    code = main(arguments)
    sys.stdout.flush()
    sys.stderr.flush()
    if "bpy" in sys.modules and not Path(sys.executable).name.startswith("blender"):
        os._exit(code)  # some versions of the bpy module crash or hang while the interpreter ends
    sys.exit(code)
