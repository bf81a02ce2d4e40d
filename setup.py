# SPDX-License-Identifier: GPL-3.0-or-later
"""Builds the kernels into the wheel; everything else is in pyproject.toml.

The libraries are called through ctypes, so a wheel depends on the platform but not on the Python version.
``MGF_WHEEL_TARGET`` (a name in ``mgf_engine.native.build.TARGETS``) makes a wheel for another platform.
"""

import os
import sys
from pathlib import Path

from setuptools import Distribution, setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_py import build_py

sys.path.insert(0, str(Path(__file__).parent))
from mgf_engine.native import build as kernels


def wheel_target() -> str:
    target = os.environ.get("MGF_WHEEL_TARGET", "") or kernels.host_target()
    if target not in kernels.TARGETS:
        raise SystemExit(f"MGF_WHEEL_TARGET is one of {', '.join(kernels.TARGETS)}, not '{target}'.")
    return target


class BuildWithKernels(build_py):
    """Compiles the kernels before the package's files are collected."""

    def run(self) -> None:
        carried = {path.name for path in kernels.build([wheel_target()])}
        super().run()
        if not self.editable_mode:  # for `mgf doctor`, which finds it beside the package in a checkout
            self.copy_file("constraints.txt", str(Path(self.build_lib) / "mgf_engine" / "constraints.txt"))
        collected = Path(self.build_lib) / "mgf_engine" / "native" / "lib"
        for path in collected.glob("*") if collected.is_dir() else ():
            if path.name not in carried:  # stamps and libraries of other platforms
                path.unlink()


class PlatformWheel(bdist_wheel):
    """A wheel for one platform and every Python 3."""

    def get_tag(self) -> tuple[str, str, str]:
        return "py3", "none", kernels.TARGETS[wheel_target()].wheel_platform


class PlatformDistribution(Distribution):
    """Tells setuptools that the wheel holds machine code."""

    def has_ext_modules(self) -> bool:
        return True


setup(cmdclass={"build_py": BuildWithKernels, "bdist_wheel": PlatformWheel}, distclass=PlatformDistribution)
