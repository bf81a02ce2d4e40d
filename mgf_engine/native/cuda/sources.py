# SPDX-License-Identifier: GPL-3.0-or-later
"""The CUDA sources: which files there are, which kernels they hold, and a digest that changes with any of them."""

from __future__ import annotations

import hashlib
import re
from functools import cache
from pathlib import Path

KERNELS = Path(__file__).parent.parent / "csrc"
FOLDER = KERNELS / "cuda"


@cache
def programs() -> dict[str, tuple[str, ...]]:
    """Return kernel names by program: ``blend`` is ``csrc/cuda/blend.cu``."""
    return {path.stem: _kernels(path.read_text(encoding="utf-8")) for path in sorted(FOLDER.glob("*.cu"))}


@cache
def program_of(kernel: str) -> str:
    """Return the program that holds a kernel."""
    return next(program for program, names in programs().items() if kernel in names)


@cache
def digest() -> str:
    """Hash the sources and headers."""
    found = hashlib.sha256()
    for path in sorted([*FOLDER.glob("*"), *KERNELS.rglob("*.h")]):
        found.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return found.hexdigest()


def _kernels(text: str) -> tuple[str, ...]:
    """Return names that KERNEL(name, ..), or a macro around it that is written NAME(name, ..) at the margin,
    declares."""
    macros = re.findall(r"^#define (\w+)\((?:name\b[^)]*)\)[\s\\]*\n\s*KERNEL\(name", text, re.MULTILINE)
    pattern = rf"^(?:{'|'.join(['KERNEL', *macros])})\((\w+)"
    return tuple(re.findall(pattern, text, re.MULTILINE))
