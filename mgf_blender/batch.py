# SPDX-License-Identifier: GPL-3.0-or-later
"""Script: run a job, import a COLMAP scene and the job's results, and save a .blend, without a window.

    blender -b --python mgf_blender/batch.py -- --scene SCENE --job JOB --out demo.blend
    python mgf_blender/batch.py --scene SCENE --job JOB --out demo.blend        (an environment with bpy)
    … --reconstruct --engine PYTHON --prompts FILE --set preset=draft            (runs the engine first)
    … --engine PYTHON --drawings --models solid ifc                              (drawings and models of the job, too)

The work is in ``headless.py``. A script is no part of a package, so this one loads the package around it.
"""

from __future__ import annotations

import importlib.util
import os
import sys
from pathlib import Path

PACKAGE = "mgf_blender"


def load_package() -> None:
    """Load the folder of this file as the package ``mgf_blender``, whatever its name is; one that is loaded stays."""
    if PACKAGE in sys.modules:
        return
    folder = Path(__file__).resolve().parent
    spec = importlib.util.spec_from_file_location(
        PACKAGE, folder / "__init__.py", submodule_search_locations=[str(folder)]
    )
    module = importlib.util.module_from_spec(spec)
    sys.modules[PACKAGE] = module
    spec.loader.exec_module(module)


if __name__ == "__main__":
    load_package()
    arguments = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    code = importlib.import_module(f"{PACKAGE}.headless").main(arguments)
    sys.stdout.flush()
    sys.stderr.flush()
    if not Path(sys.executable).name.startswith("blender"):
        os._exit(code)  # some versions of the bpy module crash or hang while the interpreter ends
    sys.exit(code)
