# SPDX-License-Identifier: GPL-3.0-or-later
"""Build the Blender extension: one zip, validated, and the static index Blender installs and updates from.

    python tools/build_extension.py [--out dist] [--targets NAME ... | --wheel FILE | --no-wheel] [--options]

The zip holds the manifest and the content of ``mgf_blender`` at its root, the engine's wheels (one for each system,
all built here) and the pinned versions as data. Validation and index use Blender's own tool, which the ``bpy`` package
carries; run this script with the Python of such an environment, or name the tool with ``--tool``.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import shutil
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from pathlib import Path

REPO = Path(__file__).resolve().parents[1]
#: Fixed time stamps, so that the same sources give the same zip.
_EPOCH = (2020, 1, 1, 0, 0, 0)
_SKIP = {"__pycache__"}
#: The names in ``mgf_engine.native.build.TARGETS``, which this script's Python need not be able to import.
ALL_TARGETS = ("linux-x86_64", "linux-aarch64", "windows-x86_64", "macos-x86_64", "macos-aarch64")


def main(argv: list[str] | None = None) -> int:
    """Build, validate, index; returns the exit code."""
    args = _parser().parse_args(argv)
    if args.options:
        write_options(args.engine_python)
        return 0
    tool = args.tool or find_tool()
    manifest = tomllib.loads((REPO / "blender_manifest.toml").read_text(encoding="utf-8"))
    args.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as temporary:
        stage = Path(temporary) / "stage"
        assemble(stage)
        if not args.no_wheel:
            carry_engine(stage / "wheelhouse", args.wheel, args.targets, args.engine_python)
        target = args.out / f"{manifest['id']}-{manifest['version']}.zip"
        pack(stage, target)
    print(f"{target} ({target.stat().st_size / 1e6:.2f} MB)")
    run_tool(tool, "validate", str(target))
    run_tool(tool, "server-generate", "--repo-dir", str(args.out))
    print(f"{args.out / 'index.json'}: add its address or its folder's file:// address as a repository in Blender")
    return 0


def assemble(stage: Path) -> None:
    """Copy manifest, licence and the add-on's files."""
    shutil.copytree(REPO / "mgf_blender", stage, ignore=shutil.ignore_patterns(*_SKIP, "*.pyc"))
    for name in ("blender_manifest.toml", "LICENSE"):
        shutil.copy2(REPO / name, stage / name)


def carry_engine(folder: Path, wheel: Path | None, targets: list[str], python: Path) -> None:
    """Put the engine's wheels and the pinned versions into ``folder``; builds one wheel per target if none is given.

    Args:
        targets: names in ``mgf_engine.native.build.TARGETS``.
    """
    folder.mkdir()
    if wheel is None:
        command = [str(python), "-m", "pip", "wheel", "--no-deps", "--no-build-isolation", "-q", "-w", str(folder)]
        for target in targets:
            subprocess.run([*command, str(REPO)], check=True, env={**os.environ, "MGF_WHEEL_TARGET": target})
    else:
        shutil.copy2(wheel, folder / wheel.name)
    shutil.copy2(REPO / "constraints.txt", folder / "constraints.txt")


def pack(stage: Path, target: Path) -> None:
    """A zip with sorted names and fixed times."""
    temporary = target.with_suffix(".writing")
    with zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for path in sorted(p for p in stage.rglob("*") if p.is_file()):
            info = zipfile.ZipInfo(path.relative_to(stage).as_posix(), _EPOCH)
            info.compress_type = zipfile.ZIP_DEFLATED
            info.external_attr = 0o644 << 16
            archive.writestr(info, path.read_bytes())
    temporary.replace(target)


def find_tool() -> Path:
    """Blender's extension tool inside the ``bpy`` package of this Python, or of the checkout's own environment."""
    spec = importlib.util.find_spec("bpy")
    roots = [Path(p) for p in (spec.submodule_search_locations or [])] if spec is not None else []
    roots += sorted(REPO.glob(".venv-bpy*/lib/python*/site-packages/bpy"))
    for root in roots:
        for tool in root.glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py"):
            return tool
    sys.exit("Blender's extension tool was not found; install the bpy package, or give --tool FILE.")


def run_tool(tool: Path, *arguments: str) -> None:
    """Run Blender's extension tool; ends this script when it complains."""
    done = subprocess.run([sys.executable, str(tool), *arguments], capture_output=True, text=True)
    if done.returncode != 0:
        sys.exit(f"{arguments[0]} failed:\n{done.stdout}{done.stderr}")
    print(f"{arguments[0]}: ok")


def write_options(python: Path) -> None:
    """Refresh ``mgf_blender/options.json`` from the engine."""
    command = [str(python), "-m", "mgf_engine", "options", "--json"]
    text = subprocess.run(command, check=True, capture_output=True, text=True, cwd=REPO).stdout
    json.loads(text)
    (REPO / "mgf_blender" / "options.json").write_text(text, encoding="utf-8")


def _parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(description="Build the Blender extension.")
    p.add_argument("--out", type=Path, default=REPO / "dist", help="folder for zip and index")
    p.add_argument("--wheel", type=Path, help="the engine's wheel; built when not given")
    p.add_argument("--targets", nargs="+", default=ALL_TARGETS, metavar="NAME", help="systems to carry wheels for")
    p.add_argument("--no-wheel", action="store_true", help="leave the engine out, for quick tests of the add-on")
    p.add_argument("--options", action="store_true", help="only refresh mgf_blender/options.json from the engine")
    default = REPO / ".venv" / "bin" / "python"
    p.add_argument("--engine-python", type=Path, default=default if default.is_file() else Path(sys.executable))
    p.add_argument("--tool", type=Path, help="Blender's bl_pkg/cli/blender_ext.py")
    return p


if __name__ == "__main__":
    sys.exit(main())
