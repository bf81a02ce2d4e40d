# SPDX-License-Identifier: GPL-3.0-or-later
"""Prove that a mechanical change changes nothing: hash the masks, field, mesh and texture of a small scene.

``python -m benchmarks.byte_check --write before.json`` at the old commit, ``--against before.json`` at the new one;
the exit code is 1 where anything differs. Seed and threads are fixed. Without ``--scene`` it reconstructs the painted
house of the tests, at presets ``draft`` and ``quick`` as asked for by ``--preset``.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
#: Results compared, relative to the job folder: what a stage hands on and what the user gets.
COMPARED = (
    "masks/labels/*.png",
    "masks/*.npz",
    "checkpoints/field.npz",
    "checkpoints/start.npz",
    "field.ply",
    "mesh.ply",
    "texture.jpg",
    "mesh_texture.npz",
)
PHOTOS = 14
SMALL = ("seed=0", "threads=2", "device=cpu", "passes=6", "resolution=240")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the check; returns 0 where nothing differs, 1 where something does."""
    args = _parser().parse_args(argv)
    with tempfile.TemporaryDirectory() as work:
        scene, prompts = args.scene, args.prompts
        if scene is None:
            scene = painted_house(Path(work) / "house")
            prompts = scene / "prompts.json"
        found = {
            preset: hash_results(
                reconstruct(scene, prompts or scene / "prompts.json", Path(work) / preset, preset, args.set)
            )
            for preset in args.preset
        }
    if args.write:
        args.write.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    if not args.against:
        return 0
    changed = differences(json.loads(args.against.read_text(encoding="utf-8")), found)
    print("\n".join(changed) or "The same to the byte.")
    return 1 if changed else 0


def painted_house(folder: Path) -> Path:
    """Write the house of the tests into a folder and return it."""
    from benchmarks.synthetic.house import build_house

    return Path(build_house(folder, PHOTOS).folder)


def reconstruct(scene: Path, prompts: Path, job: Path, preset: str, options: Sequence[str] = ()) -> Path:
    """Run a job in a process of its own and return its folder.

    Raises:
        SystemExit: the job failed.
    """
    command = [
        sys.executable,
        "-m",
        "mgf_engine",
        "reconstruct",
        str(scene),
        "--prompts",
        str(prompts),
        "--out",
        str(job),
    ]
    for pair in (f"preset={preset}", *SMALL, *options):
        command += ["--set", pair]
    run = subprocess.run([*command, "--progress", "none"], cwd=ROOT)
    if run.returncode:
        raise SystemExit(f"The job at preset '{preset}' failed with exit code {run.returncode}.")
    return job


def hash_results(job: Path) -> dict[str, str]:
    """Hash each result of a job; archives by their arrays, since a zip file carries the time.

    Returns:
        path relative to the job -> SHA-256.
    """
    paths = sorted({path for pattern in COMPARED for path in job.glob(pattern)})
    return {path.relative_to(job).as_posix(): _hash(path) for path in paths}


def differences(before: dict[str, dict[str, str]], after: dict[str, dict[str, str]]) -> list[str]:
    """List the results that differ, are missing or are new, each as one line."""
    lines = []
    for preset in after:
        old, new = before.get(preset, {}), after[preset]
        for name in sorted(old.keys() | new.keys()):
            if old.get(name) != new.get(name):
                state = "differs" if name in old and name in new else "is missing" if name in old else "is new"
                lines.append(f"{preset}: {name} {state}")
    return lines


def _hash(path: Path) -> str:
    if path.suffix != ".npz":
        return hashlib.sha256(path.read_bytes()).hexdigest()
    digest = hashlib.sha256()
    with np.load(path, allow_pickle=False) as arrays:
        for name in sorted(arrays.files):
            array = arrays[name]
            digest.update(f"{name} {array.dtype} {array.shape}".encode() + np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.byte_check", description=__doc__)
    parser.add_argument("--scene", type=Path, help="a scene folder instead of the painted house")
    parser.add_argument("--prompts", type=Path, help="its clicks (default: prompts.json in the scene)")
    parser.add_argument("--preset", nargs="+", default=["draft"], help="presets to run (default: draft)")
    parser.add_argument(
        "--set", action="append", default=[], metavar="NAME=VALUE", help="further options of the engine"
    )
    parser.add_argument("--write", type=Path, metavar="JSON", help="write the hashes")
    parser.add_argument("--against", type=Path, metavar="JSON", help="compare with hashes written before")
    return parser


if __name__ == "__main__":
    sys.exit(main())
