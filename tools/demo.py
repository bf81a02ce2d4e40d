# SPDX-License-Identifier: GPL-3.0-or-later
"""``make demo``: the whole job from photos to a ``.blend``, headless, through the add-on.

Without ``--scene`` it renders a small building scene with Cycles first. The results are ``demo.blend``,
``demo.png`` (a picture of the mesh) and the job folder with the mesh and the report.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))  # the benchmarks are not installed

from benchmarks.catalogue import scene_spec  # noqa: E402
from benchmarks.scenes import make_scene  # noqa: E402
from mgf_engine.errors import EXIT_BAD_INPUT, BadInput  # noqa: E402


def main() -> int:
    """Run the demo; returns the exit code of the first step that fails, or 0."""
    args = _parser().parse_args()
    out = args.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    scene, prompts = args.scene, args.prompts
    try:
        if not args.blender_python.is_file():
            raise BadInput(f"There is no Python '{args.blender_python}'; give one that has bpy.")
        if scene is None:
            print("Rendering the demo scene with Cycles (once; kept in the cache) ...", flush=True)
            scene = make_scene("demo", scene_spec("demo"), blender=args.blender_python)
    except BadInput as error:
        print(f"Error: {error}", file=sys.stderr)
        return EXIT_BAD_INPUT
    if prompts is None:
        prompts = scene / "prompts.json"
    command = [
        str(args.blender_python), str(ROOT / "mgf_blender" / "batch.py"), "--", "--reconstruct",
        "--engine", sys.executable, "--scene", str(scene), "--prompts", str(prompts), "--job", str(out / "job"),
        "--out", str(out / "demo.blend"), "--picture", str(out / "demo.png"), "--set", f"preset={args.preset}",
    ]  # fmt: skip
    code = subprocess.run(command, cwd=ROOT).returncode
    if code:
        return code
    for name in ("demo.blend", "demo.png", "job/mesh.ply", "job/report.html"):
        print(f"  {out / name}")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--blender-python", type=Path, required=True, help="a Python that has bpy")
    parser.add_argument("--out", type=Path, default=Path("demo"), help="folder for the results")
    parser.add_argument("--scene", type=Path, help="a COLMAP scene of your own")
    parser.add_argument("--prompts", type=Path, help="clicks for it (default: prompts.json in the scene)")
    parser.add_argument("--preset", default="draft", help="draft, standard or fine")
    return parser


if __name__ == "__main__":
    sys.exit(main())
