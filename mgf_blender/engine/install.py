# SPDX-License-Identifier: GPL-3.0-or-later
"""Install the engine: a virtual environment made by Blender's own Python, and the pinned packages in it.

Blender's Python is not touched: the engine needs its own numpy and torch.
"""

from __future__ import annotations

import contextlib
import functools
import platform
import re
import shutil
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from ..common.addon import carried_folder
from ..common.errors import UserError
from ..common.text import N_, tr
from . import swap
from .environment import python_of
from .task import CANCELLED, DONE, Step, Task

#: Roughly what the engine takes on disk, for the question before the download.
_SIZE_CPU, _SIZE_CUDA, _SIZE_EITHER = N_("about 2 GB"), N_("about 7 GB"), N_("2 to 7 GB")
_TORCH_INDEX = "https://download.pytorch.org/whl/"
_FREE_CPU, _FREE_CUDA = 3, 7  # GiB
#: The engine's extras with the packages for drawings and map coordinates, and for models.
SURVEY, MODELS = "survey", "models"
#: Names of their ticks in the preferences.
TICKS = {SURVEY: N_("Drawings and Map Coordinates"), MODELS: N_("Models")}
#: Letters of the longest file name in the packages, below site-packages: a licence in torch's wheel.
_LONGEST_NAME = 167
_LONGEST_PATH = 259  # letters that Windows allows unless long paths were switched on
#: What pip prints when an index does not answer, over its versions.
_NO_NETWORK = ("NewConnectionError", "NameResolutionError", "Failed to establish a new connection", "ConnectTimeout",
               "Temporary failure in name resolution", "ReadTimeoutError", "Connection refused",
               "Network is unreachable", "Max retries")  # fmt: skip
#: How pip names the packages that have no build for this Python, above "ResolutionImpossible".
_NO_BUILD = "no matching distributions available for your environment:"
#: How pip and the systems say that a path is too long.
_PATH_TOO_LONG = ("Windows Long Path support", "[WinError 206]", "[Errno 36]", "[Errno 63]", "File name too long")


@dataclass(frozen=True)
class InstallPlan:
    """What to install from where.

    Attributes:
        target: folder of the environment.
        python: interpreter that makes it.
        wheel: the engine's wheel.
        constraints: pinned versions.
        wheel_folder: install from this folder alone, without network; None downloads.
        torch: "cpu" or "cuda".
        default_index: leave the choice of torch's build to the package index in use.
        weights: fetch the weights of EfficientSAM, too.
        weights_folder: where they go; None is the engine's own cache folder.
        survey: the packages for drawings and map coordinates, too; models: those for models.
    """

    target: Path
    python: Path
    wheel: Path
    constraints: Path
    wheel_folder: Path | None
    torch: str
    default_index: bool = False
    weights: bool = False
    weights_folder: Path | None = None
    survey: bool = False
    models: bool = False


def carried_wheel() -> Path:
    """Return the engine's wheel for this machine inside the extension.

    Raises:
        UserError: this copy of the add-on carries none (a checkout that was not built), or none for this machine.
    """
    wheels = sorted(carried_folder().glob("mgf_engine-*.whl"))
    if not wheels:
        raise UserError(
            "This copy of the add-on carries no engine; install the extension's zip, or use an existing environment."
        )
    system, machine = platform.system(), platform.machine().lower()
    fitting = [wheel for wheel in wheels if wheel_fits(wheel.name, system, machine)]
    if not fitting:
        raise UserError(
            "This copy of the add-on carries no engine for {machine}; use an existing environment instead.",
            machine=f"{system} {machine}",
        )
    return fitting[-1]


def wheel_fits(name: str, system: str, machine: str) -> bool:
    """Tell whether a wheel's file name is for ``platform.system()`` and ``platform.machine()`` in small letters."""
    tag = name.removesuffix(".whl").rsplit("-", 1)[-1]
    family = {"x86_64": "x86_64", "amd64": "x86_64", "arm64": "aarch64", "aarch64": "aarch64"}.get(machine, machine)
    wanted = {
        ("Linux", "x86_64"): ("linux", "x86_64"), ("Linux", "aarch64"): ("linux", "aarch64"),
        ("Windows", "x86_64"): ("win", "amd64"), ("Darwin", "x86_64"): ("macosx", "x86_64"),
        ("Darwin", "aarch64"): ("macosx", "arm64"),
    }.get((system, family))  # fmt: skip
    return tag == "any" or (wanted is not None and wanted[0] in tag and tag.endswith(wanted[1]))


@functools.cache
def has_nvidia() -> bool:
    """Tell whether an NVIDIA driver is on this machine."""
    return shutil.which("nvidia-smi") is not None


def size(torch: str, default_index: bool) -> str:
    """Return roughly what the engine takes on disk, to be translated.

    Args:
        torch: "cpu" or "cuda".
        default_index: the build is whichever the configured package index has.
    """
    if torch == "cuda":
        return _SIZE_CUDA
    return _SIZE_EITHER if _may_bring_cuda(default_index) else _SIZE_CPU


def _may_bring_cuda(default_index: bool) -> bool:
    """Tell whether the CUDA build can come without having been asked for: on Linux that is what PyPI has."""
    return default_index and sys.platform == "linux"


def make_task(plan: InstallPlan, log: Path) -> Task:
    """Make the steps of an installation; nothing runs before the task is drained.

    Raises:
        UserError: the disk has too little room, the folder's path is too long, or the wheel folder lacks the
            engine's dependencies.
    """
    _check_room(plan)
    if sys.platform == "win32" and not _long_paths_allowed():
        check_length(str(swap.unfinished(plan.target)))
    if plan.wheel_folder is not None and not any(plan.wheel_folder.glob("torch-*.whl")):
        raise UserError(
            "'{wheel_folder}' holds no wheel of torch; fill it with 'pip download' on a machine with network.",
            wheel_folder=plan.wheel_folder,
        )
    with contextlib.suppress(OSError):  # without a log the panel still says how it goes
        log.parent.mkdir(parents=True, exist_ok=True)
        log.write_text(time.strftime("Installation started %Y-%m-%d %H:%M:%S\n"), encoding="utf-8")
    return Task(_steps(plan), log, explain, on_end=lambda task: _clear_away(task, plan.target),
                finish=lambda: swap.replace_engine(plan.target))  # fmt: skip


def _steps(plan: InstallPlan) -> list[Step]:
    place = swap.unfinished(plan.target)
    python = str(python_of(place))
    install = [python, "-m", "pip", "--disable-pip-version-check", "--no-input", "install", "--only-binary", ":all:",
               "-c", str(plan.constraints)]  # fmt: skip
    folder = ["--no-index", "--find-links", str(plan.wheel_folder)] if plan.wheel_folder is not None else []
    return [
        Step(N_("Creating the environment"), [str(plan.python), "-I", "-m", "venv", "--clear", str(place)], 0.5),
        # torch alone from the index of its builds: with a second index beside it, pip takes the gigabytes of CUDA
        # from there when the first does not answer. What torch needs comes with the engine.
        Step(N_("Installing torch"), [*install, *(folder or _torch_index(plan)), "--no-deps", "torch"], 6),
        Step(N_("Installing the engine"), [*install, *folder, _engine(plan)], 3),
        *_weights_step(plan, python),
        Step(N_("Checking the engine"), [python, "-m", "mgf_engine", "doctor"], 0.5),
    ]


def _engine(plan: InstallPlan) -> str:
    """Return the wheel as pip takes it, with the extra packages that were ticked."""
    extras = [name for name, wanted in ((SURVEY, plan.survey), (MODELS, plan.models)) if wanted]
    return f"{plan.wheel}[{','.join(extras)}]" if extras else str(plan.wheel)


def _weights_step(plan: InstallPlan, python: str) -> list[Step]:
    """Return the weights of EfficientSAM; the engine works without."""
    if not plan.weights:
        return []
    command = [python, "-m", "mgf_engine", "weights"]
    if plan.wheel_folder is not None:
        command += ["--from", str(plan.wheel_folder)]
    if plan.weights_folder is not None:
        command += ["--folder", str(plan.weights_folder)]
    return [Step(N_("Fetching the EfficientSAM weights"), command, 0.5, needed=False)]


def _clear_away(task: Task, target: Path) -> None:
    """Remove what a failed or cancelled installation made, and say what that means for the engine."""
    if task.status == DONE:
        return
    swap.discard(swap.unfinished(target))
    if task.status == CANCELLED:
        kept, none = N_("Cancelled; the engine from before is kept."), N_("Cancelled; nothing was installed.")
        task.text = tr(kept if python_of(target).is_file() else none)


def explain(step: Step, lines: list[str]) -> str:
    """Return one sentence for a failed step, from pip's last words."""
    output = "\n".join(lines)
    said = next((line for line in reversed(lines) if line.startswith("Error: ")), None)
    if said is not None and "mgf_engine" in step.command:
        return said.removeprefix("Error: ")
    if "No space left on device" in output or "not enough space" in output:
        return tr("The disk is full; free some space and install again.")
    if any(sign in output for sign in _PATH_TOO_LONG):
        return tr("A file's path is too long; enable long paths in Windows and install again.")
    if any(sign in output for sign in _NO_NETWORK):
        if _TORCH_INDEX in " ".join(step.command):
            return tr("The index of torch's builds ({url}) cannot be reached, and other indexes have other builds; "
                      "check the network, install from a wheel folder, or use the configured package index.",
                      url=_TORCH_INDEX)  # fmt: skip
        return tr("The package index cannot be reached; check the network, or install from a wheel folder.")
    if "ensurepip" in output:
        return tr("This Python cannot make environments (ensurepip is missing); use an existing environment instead.")
    missing = _package_without_build(output)
    if missing:
        return _no_build(missing, output)
    if "ResolutionImpossible" in output:
        return tr("The packages do not fit together; fill the wheel folder with 'pip download -c constraints.txt'.")
    spoken = [line for line in lines if line.strip()]
    last = next(
        (line for line in reversed(spoken) if line.lower().startswith("error: ")), (spoken or ["no output"])[-1]
    )
    text = N_("{step} failed ({reason}); open the log for the details.")
    return tr(text, step=tr(step.title), reason=short(last))


def _package_without_build(output: str) -> str:
    """Return the package of which pip found no build for this Python, or nothing."""
    for mark in (_NO_BUILD, "No matching distribution found for "):
        if mark in output:
            return output.rsplit(mark, 1)[-1].split()[0].rstrip(";")
    return ""


def _no_build(name: str, output: str) -> str:
    """Return the sentence for a package that has no build; one that was ticked can be left out."""
    version = f"{sys.version_info.major}.{sys.version_info.minor}"
    extra = re.search(rf'{re.escape(re.split("[=<>~!]", name)[0])}\b[^\n]*; extra == "(\w+)"', output)
    if extra is not None and extra[1] in TICKS:
        text = N_("No build of {name} fits Python {version} on this system; install without '{extra}', or use an "
                  "existing environment.")  # fmt: skip
        return tr(text, name=name, version=version, extra=tr(TICKS[extra[1]]))
    text = N_("No build of {name} fits Python {version} on this system; use an existing environment instead.")
    return tr(text, name=name, version=version)


def short(line: str) -> str:
    """Return a line of another program as the reason in a sentence: at most 160 letters, cut between words."""
    text = " ".join(line.split()).removeprefix("ERROR: ").removeprefix("error: ").rstrip(".")
    return text if len(text) <= 160 else text[:160].rsplit(" ", 1)[0] + " …"


def _torch_index(plan: InstallPlan) -> list[str]:
    """Return the index that has the wanted build of torch; none for the one this machine is configured for."""
    if plan.default_index or sys.platform == "darwin":
        return []
    return ["--index-url", _TORCH_INDEX + ("cpu" if plan.torch == "cpu" else "cu128")]


def check_length(target: str) -> None:
    """Refuse an environment whose files would have paths that Windows does not allow.

    Raises:
        UserError: the path is too long.
    """
    excess = len(target) + len("\\Lib\\site-packages\\") + _LONGEST_NAME - _LONGEST_PATH
    if excess > 0:
        raise UserError(
            "The path '{folder}' is {count} character(s) too long for the engine on Windows; enable long paths in "
            "Windows (LongPathsEnabled), or use an existing environment in a shorter folder.",
            folder=target,
            count=excess,
        )


def _long_paths_allowed() -> bool:
    """Tell whether this Windows was told to allow paths of more than 259 letters."""
    import winreg

    try:
        with winreg.OpenKey(winreg.HKEY_LOCAL_MACHINE, r"SYSTEM\CurrentControlSet\Control\FileSystem") as key:
            return bool(winreg.QueryValueEx(key, "LongPathsEnabled")[0])
    except OSError:
        return False


def _check_room(plan: InstallPlan) -> None:
    folder = next(p for p in (plan.target, *plan.target.parents) if p.exists())
    small = plan.torch == "cpu" and not (plan.wheel_folder is None and _may_bring_cuda(plan.default_index))
    free, needed = shutil.disk_usage(folder).free, _FREE_CPU if small else _FREE_CUDA
    if free < needed << 30:
        raise UserError(
            "Only {free:.1f} GB are free in '{folder}'; the engine needs {needed} GB, so free some space.",
            free=free / 2**30,
            folder=folder,
            needed=needed,
        )
