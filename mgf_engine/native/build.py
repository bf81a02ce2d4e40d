# SPDX-License-Identifier: GPL-3.0-or-later
"""Compiles the C kernels into one shared library per processor variant, with the compiler in the ``ziglang`` wheel.

``python -m mgf_engine.native.build`` builds for the machine at hand, ``--targets`` for others: every target can be
built on every machine. A library is rebuilt only when a source, a flag or the compiler changed. Imported by
``setup.py`` too, so it needs nothing beyond the standard library (and ``ziglang`` to compile).

gcc is no alternative: it splits the 64-byte vectors of the kernels badly on AVX2 (five times slower).
"""

from __future__ import annotations

import argparse
import hashlib
import importlib.metadata
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

KERNELS = Path(__file__).parent / "csrc"
LIBRARIES = Path(__file__).parent / "lib"

FLAGS = (
    "-shared", "-O3", "-std=gnu17", "-fPIC", "-fvisibility=hidden", "-Wall", "-Wextra", "-Wno-psabi",
    "-ffp-contract=fast", "-fno-math-errno", "-fno-trapping-math", "-fno-sanitize=undefined", "-s",
)  # fmt: skip
#: Variants per processor family, best last; the first one runs on every processor of the family.
VARIANTS = {
    "x86_64": {"x86-64": "x86_64", "x86-64-v3": "x86_64_v3", "x86-64-v4": "x86_64_v4"},
    "aarch64": {"neon": "generic"},
}


@dataclass(frozen=True)
class BuildTarget:
    """An operating system and processor family that libraries are built for.

    Attributes:
        triple: what zig calls it, with the oldest C library it must run on.
        suffix: of shared libraries there.
        wheel_platform: platform tag of a wheel that carries them.
    """

    triple: str
    suffix: str
    wheel_platform: str

    @property
    def family(self) -> str:
        return self.triple.split("-")[0]


TARGETS = {
    "linux-x86_64": BuildTarget("x86_64-linux-gnu.2.17", ".so", "manylinux_2_17_x86_64"),
    "linux-aarch64": BuildTarget("aarch64-linux-gnu.2.17", ".so", "manylinux_2_17_aarch64"),
    "windows-x86_64": BuildTarget("x86_64-windows-gnu", ".dll", "win_amd64"),
    "macos-x86_64": BuildTarget("x86_64-macos.12.0", ".dylib", "macosx_12_0_x86_64"),
    "macos-aarch64": BuildTarget("aarch64-macos.12.0", ".dylib", "macosx_12_0_arm64"),
}


def host_target() -> str:
    """Return this machine's name in :data:`TARGETS`.

    Raises:
        RuntimeError: the kernels do not support it.
    """
    system = {"Linux": "linux", "Windows": "windows", "Darwin": "macos"}.get(platform.system(), platform.system())
    machine = platform.machine().lower()
    name = system + "-" + {"amd64": "x86_64", "arm64": "aarch64"}.get(machine, machine)
    if name not in TARGETS:
        raise RuntimeError(f"The kernels do not support this machine ({name}); supported are {', '.join(TARGETS)}.")
    return name


def library_path(target: str, variant: str) -> Path:
    """Return where the library of a variant lies, whether it is built or not."""
    return LIBRARIES / f"mgf-{target.split('-')[0]}-{variant}{TARGETS[target].suffix}"


def build(targets: Iterable[str] = (), variants: Iterable[str] = (), *, force: bool = False) -> list[Path]:
    """Build every library of the targets that is missing or out of date.

    Args:
        targets: names in :data:`TARGETS`; none means the machine at hand.
        variants: names in :data:`VARIANTS`; none means all of each target's family.
        force: build even what is up to date.

    Returns:
        paths of all libraries of the targets, built now or before.

    Raises:
        RuntimeError: the compiler is missing or fails.
    """
    LIBRARIES.mkdir(exist_ok=True)
    wanted = [
        (target, variant, cpu)
        for target in (list(targets) or [host_target()])
        for variant, cpu in VARIANTS[TARGETS[target].family].items()
        if not list(variants) or variant in variants
    ]
    with ThreadPoolExecutor(max_workers=os.cpu_count() or 1) as pool:
        return list(pool.map(lambda job: _build_one(job[0], job[1], job[2], force), wanted))


def _build_one(target: str, variant: str, cpu: str, force: bool) -> Path:
    path = library_path(target, variant)
    stamp = path.with_suffix(path.suffix + ".sha256")
    flags = [*FLAGS, "-target", TARGETS[target].triple, f"-mcpu={cpu}"]
    digest = _digest(flags)
    if not force and path.is_file() and stamp.is_file() and stamp.read_text(encoding="ascii").strip() == digest:
        return path
    sources = [str(p) for p in sorted(KERNELS.rglob("*.c"))]
    with tempfile.TemporaryDirectory(prefix="partial", dir=LIBRARIES) as work:  # takes import libraries, too
        partial = Path(work) / path.name
        command = [sys.executable, "-m", "ziglang", "cc", *flags, "-I", str(KERNELS), "-o", str(partial), *sources]
        if TARGETS[target].suffix == ".so":
            command.append("-lm")
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            raise RuntimeError(
                f"Building {path.name} failed; is ziglang installed (pip install ziglang)?\n{done.stderr}"
            )
        if done.stderr:
            print(done.stderr, file=sys.stderr)  # warnings
        os.replace(partial, path)
    stamp.write_text(digest + "\n", encoding="ascii")
    return path


def _digest(flags: list[str]) -> str:
    """Hash the sources, the flags and the compiler."""
    digest = hashlib.sha256(repr(flags).encode())
    try:
        digest.update(importlib.metadata.version("ziglang").encode())
    except importlib.metadata.PackageNotFoundError as error:
        raise RuntimeError("The kernels are compiled by the ziglang package; run 'pip install ziglang'.") from error
    for source in sorted(KERNELS.rglob("*.[ch]")):
        digest.update(source.relative_to(KERNELS).as_posix().encode() + b"\0" + source.read_bytes() + b"\0")
    return digest.hexdigest()


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="Compile the kernels, one shared library per processor variant.")
    parser.add_argument("--targets", nargs="+", choices=[*TARGETS, "all"], default=[], help="default: this machine")
    parser.add_argument("--variants", nargs="+", default=[], help="only these variants, such as x86-64-v3")
    parser.add_argument("--force", action="store_true", help="build even what is up to date")
    given = parser.parse_args(arguments)
    targets = list(TARGETS) if "all" in given.targets else given.targets
    try:
        for path in build(targets, given.variants, force=given.force):
            print(path)
    except RuntimeError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
