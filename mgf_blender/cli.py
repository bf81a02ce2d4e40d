# SPDX-License-Identifier: GPL-3.0-or-later
"""``blender --command mgf …``: the engine's command line through Blender, and ``import`` for headless imports."""

from __future__ import annotations

import subprocess
import sys

import bpy

from .common.errors import UserError
from .common.job import EXIT_BAD_INPUT
from .common.process import clean_environment
from .engine.environment import engine_command
from .headless import main as import_main

_HELP = """usage: blender --command mgf import --scene SCENE [--job JOB] --out FILE.blend
       blender --command mgf reconstruct SCENE --prompts FILE --out JOB [options]
       blender --command mgf (any other command of the engine)
"""
_command: object | None = None


def run(argv: list[str]) -> int:
    """Run ``import`` here and everything else in the engine, with its output and exit codes."""
    if not argv or argv[0] in {"-h", "--help"}:
        print(_HELP, end="")
        return 0
    if argv[0] == "import":
        return import_main(argv[1:])
    try:
        command = engine_command(*argv)
    except UserError as error:
        print(f"Error: {error}", file=sys.stderr)
        return EXIT_BAD_INPUT
    return subprocess.call(command, env=clean_environment())


def register() -> None:
    """Add the command."""
    global _command
    _command = bpy.utils.register_cli_command("mgf", run)


def unregister() -> None:
    """Remove it."""
    global _command
    if _command is not None:
        bpy.utils.unregister_cli_command(_command)
        _command = None
