# SPDX-License-Identifier: GPL-3.0-or-later
"""Programs that nobody here wrote, which read what MGF writes: JSON schema of 3D Tiles, npm packages.

Packages of npm are looked for in ``MGF_NODE_MODULES`` and in the checkout's ``node_modules`` (``make readers``).
"""

from __future__ import annotations

import gzip
import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator
from referencing import Registry, Resource

REPO = Path(__file__).resolve().parents[2]
#: Of 3D Tiles 1.1, CesiumGS/3d-tiles 390f766 (CC BY 4.0), by address; references are relative to it.
_TILES = REPO / "tests" / "models" / "tileset.schema.json.gz"


def tileset_errors(tileset: Any) -> list[str]:
    """What the schema of 3D Tiles finds wrong with a tileset."""
    schemas = json.loads(gzip.decompress(_TILES.read_bytes()))
    found = Registry().with_resources([(key, Resource.from_contents(value)) for key, value in schemas.items()])
    validator = Draft202012Validator({"$ref": "https://tiles/tileset.schema.json"}, registry=found)
    return [f"{error.json_path}: {error.message}" for error in validator.iter_errors(tileset)]


def run_node(package: str, program: str, *arguments: Path) -> Any:
    """What a program of Node prints as JSON; ``package`` in it stands for the package's folder.

    Skips the test where Node or the package is not there.
    """
    folders = [Path(given) for given in [os.environ.get("MGF_NODE_MODULES", "")] if given] + [REPO / "node_modules"]
    folder = next((f / package for f in folders if (f / package).is_dir()), None)
    if folder is None or shutil.which("node") is None:
        pytest.skip(f"the npm package {package} is not on this machine (make readers installs it)")
    script = f"const pkg = require({json.dumps(str(folder))});\n{program}"
    command = ["node", "-e", script, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr[-2000:]
    return json.loads(done.stdout.splitlines()[-1])


def glb_issues(*files: Path) -> list[dict[str, Any]]:
    """Errors and warnings that the Khronos validator of glTF has for files; with :func:`run_node`'s skip."""
    program = """
    const fs = require('fs');
    Promise.all(process.argv.slice(1).map(file => pkg.validateBytes(new Uint8Array(fs.readFileSync(file)))))
      .then(all => console.log(JSON.stringify(all.map(one => one.issues.messages))));
    """
    found = run_node("gltf-validator", program, *files)
    assert len(found) == len(files)
    return [message for messages in found for message in messages if message["severity"] < 2]
