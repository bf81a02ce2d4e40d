# SPDX-License-Identifier: GPL-3.0-or-later
"""The ``mgf`` command: dispatch to the command that the arguments name (:mod:`mgf_engine.cli.arguments`)."""

from __future__ import annotations

import argparse
import contextlib
import json
import logging
import os
import shutil
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from importlib.machinery import ExtensionFileLoader
from pathlib import Path
from types import FrameType, ModuleType
from typing import TYPE_CHECKING, Any

from mgf_engine.cli.arguments import parse_arguments
from mgf_engine.cli.option_list import algorithms_text, options_text
from mgf_engine.console.commands import send_failed, watch_for_cancel
from mgf_engine.console.terminal import drop_output, make_sink, prepare_streams
from mgf_engine.errors import EXIT_CANCELLED, EXIT_DONE, EXIT_FAULT, BadInput, BadInstallation, explain
from mgf_engine.jobs.job_folder import remove_refused
from mgf_engine.messages import Reporter
from mgf_engine.options.algorithms import algorithms_schema
from mgf_engine.options.config import option_fields, options_schema, renamed_values
from mgf_engine.options.user_input import option_pairs, read_config
from mgf_engine.stages import STAGE_NAMES

if TYPE_CHECKING:
    from mgf_engine.jobs.job import Job

#: Environment variables that numpy and torch read when they are imported: the engine's own threads use every core, and
#: busy-waiting threads of these libraries would compete with them (it doubles the time of the masks). OpenCV would
#: print lines of its own about photos that it cannot read, which a warning names.
ENVIRONMENT = {"OPENBLAS_NUM_THREADS": "1", "OMP_WAIT_POLICY": "PASSIVE", "OPENCV_LOG_LEVEL": "SILENT"}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code (0 done, 1 fault, 2 bad input, 3 cancelled)."""
    args = sys.argv[1:] if argv is None else list(argv)
    for name, value in ENVIRONMENT.items():
        os.environ.setdefault(name, value)
    prepare_streams()
    noted: list[int] = []
    try:
        with _noting_ctrl_c(noted):
            code = _run(args)
        sys.stdout.flush()
        return code
    except BrokenPipeError:  # the reader of the pipe has closed it, as `head` does
        drop_output()
        return EXIT_DONE
    except (Exception, KeyboardInterrupt) as error:
        code, text = explain(KeyboardInterrupt() if noted else error, resumable=False)
        if code == EXIT_FAULT:
            traceback.print_exception(error)
        print(text if code == EXIT_CANCELLED else f"Error: {text}", file=sys.stderr)
        return code


class _NoMoreModules:
    """A finder that raises Ctrl-C again for every module that is still to be loaded."""

    def find_spec(self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None) -> None:
        if not _loads_an_extension(sys._getframe()):
            raise KeyboardInterrupt


def _loads_an_extension(frame: FrameType | None) -> bool:
    """Tell whether a module in C or C++ is being loaded: an exception may abort the process there."""
    while frame is not None:
        if isinstance(frame.f_locals.get("self"), ExtensionFileLoader):
            return True
        frame = frame.f_back
    return False


@contextlib.contextmanager
def _noting_ctrl_c(noted: list[int]) -> Iterator[None]:
    """Note each Ctrl-C beside the exception that it raises, and let no further module be loaded.

    The exception alone may be lost: trimesh goes on without whatever it was loading (``except BaseException``). Modules
    in C++ make another one of it ("ImportError: std::bad_cast" with pybind11) or abort, so that it waits for their end.
    """
    finder = _NoMoreModules()

    def note(number: int, frame: FrameType | None) -> None:
        noted.append(number)
        if finder not in sys.meta_path:
            sys.meta_path.insert(0, finder)
        if not _loads_an_extension(frame):
            signal.default_int_handler(number, frame)

    ours = threading.current_thread() is threading.main_thread()
    ours = ours and signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if ours:
        signal.signal(signal.SIGINT, note)
    try:
        yield
    finally:
        if ours:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        if finder in sys.meta_path:
            sys.meta_path.remove(finder)


def _run(args: list[str]) -> int:
    """Run the command that the arguments name; returns the exit code."""
    if args[:1] == ["bench"]:
        return _bench_command(args[1:])
    parsed = parse_arguments(args)
    if parsed.command in ("reconstruct", *STAGE_NAMES):
        return _job_command(parsed)
    if parsed.command in _JOB_COMMANDS:
        return _function(_JOB_COMMANDS[parsed.command])(parsed, _given_options(parsed))
    return _function(_COMMANDS[parsed.command])(parsed)


def _bench_command(args: list[str]) -> int:
    """Run the benchmarks, which are in no wheel but in a checkout: around the package, or the current folder.

    Raises:
        BadInput: neither is a checkout.
    """
    around = (Path(__file__).resolve().parents[2], Path.cwd())
    checkout = next((folder for folder in around if (folder / "benchmarks" / "run.py").is_file()), None)
    if checkout is None:
        raise BadInput(
            "The benchmarks are not in the installed package; run 'mgf bench' from a checkout of the source code, "
            "where the folder 'benchmarks' stands beside 'mgf_engine'."
        )
    sys.path.insert(0, str(checkout))
    from benchmarks.run import bench_main

    return bench_main(args)


def _given_options(args: argparse.Namespace) -> dict[str, Any]:
    """Collect the options from --config, --set and flags; later ones take precedence."""
    given = read_config(args.config) if args.config else {}
    given.update(option_pairs(args.set))
    names = {f.name for f in option_fields()}
    given.update({name: value for name, value in vars(args).items() if name in names})
    if isinstance(given.get("crop_box"), str):
        # The file is read once and its content kept, so that a resumed job has the same box.
        from mgf_engine.scene.crop import read_crop_box

        given["crop_box"] = read_crop_box(given["crop_box"])
    return given


def _job_command(args: argparse.Namespace) -> int:
    """Run a job up to the stage that the command names; returns the exit code."""
    reporter = Reporter(make_sink(args.progress))
    log_path: Path | None = None
    new = not args.out.exists()
    try:
        with watch_for_cancel(reporter, args.cancel_on_eof), _open_job(args) as job:
            log_path = _log_to(job.path("log.txt"))
            for text in renamed_values(_given_options(args)):
                reporter.warning(text)
            from mgf_engine.pipeline import run_job

            run_job(job, reporter, until=STAGE_NAMES[-1] if args.command == "reconstruct" else args.command)
        return EXIT_DONE
    except (Exception, KeyboardInterrupt) as error:
        code = _fail(reporter, error, args.out, log_path)
        if new and isinstance(error, BadInput | BadInstallation):
            # The message says everything, so no log is needed; unlike for a full disk.
            _close_log()
            remove_refused(args.out)
        return code


def _open_job(args: argparse.Namespace) -> Job:
    """Open the job that the arguments ask for."""
    from mgf_engine.jobs.job import Job

    resume = args.resume or args.command in STAGE_NAMES
    return Job.start(args.out, args.scene, args.prompts, args.masks, _given_options(args), resume=resume)


def _fail(reporter: Reporter, error: BaseException, folder: Path, log_path: Path | None) -> int:
    """Report in one sentence why the job in a folder failed, and return the exit code.

    The log gets the sentence, and the traceback of what is neither the user's input nor wish: also where memory or disk
    are too small, it tells which step asked for how much.
    """
    code, text = explain(error, place=folder)
    details = "".join(traceback.format_exception(error))
    expected = code == EXIT_CANCELLED or isinstance(error, BadInput | BadInstallation)
    if log_path is not None:
        logging.getLogger("mgf").error("%s", text if expected else f"{text}\n{details}")
    elif code == EXIT_FAULT:
        print(details, file=sys.stderr)
    shown = str(log_path) if log_path and code == EXIT_FAULT else None
    send_failed(reporter, code, text, shown)
    return code


class _LogFile(logging.FileHandler):
    """The log of a job, which leaves out what a full disk does not take: the message of the job says so."""

    def handleError(self, record: logging.LogRecord) -> None:
        """Print nothing; logging itself would print a traceback."""


def _log_to(path: Path) -> Path:
    """Write the log to a file from now on; an earlier log is replaced."""
    log = logging.getLogger("mgf")
    log.setLevel(logging.INFO)
    log.propagate = False
    _close_log()
    handler = _LogFile(path, encoding="utf-8")
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    log.addHandler(handler)
    return path


def _close_log() -> None:
    """Write no log from now on."""
    log = logging.getLogger("mgf")
    for old in list(log.handlers):
        log.removeHandler(old)
        with contextlib.suppress(OSError):  # a full disk
            old.close()


def _options_command(args: argparse.Namespace) -> int:
    """Print the options as text or JSON."""
    if args.algorithms:
        print(json.dumps(algorithms_schema(), indent=1) if args.json else algorithms_text(_columns()))
        return EXIT_DONE
    schema = options_schema()
    if args.json:
        print(json.dumps(schema, indent=1, ensure_ascii=False))
        return EXIT_DONE
    print(options_text(schema, _columns()))
    return EXIT_DONE


def _columns() -> int:
    """Return the width of the terminal in characters."""
    return shutil.get_terminal_size((100, 24)).columns


def _estimate_command(args: argparse.Namespace) -> int:
    """Print the estimated time and memory of a job."""
    from mgf_engine.cli.estimate_report import estimate_to_dict, format_estimate
    from mgf_engine.jobs.estimate import estimate, inspect_photos, with_clicks
    from mgf_engine.masks.prompts import PromptsFile
    from mgf_engine.options.config import make_config
    from mgf_engine.system.memory import budget_of

    config, photos = make_config(_given_options(args)), inspect_photos(args.scene, args.out)
    photos = with_clicks(photos, PromptsFile.read(args.prompts) if args.prompts else None)
    budget = budget_of(config.memory)
    found = estimate(config, photos, budget=budget)
    data = estimate_to_dict(found, config, photos, budget)
    print(json.dumps(data, indent=1) if args.json else format_estimate(data))
    return EXIT_DONE


def _doctor_command(args: argparse.Namespace) -> int:
    """Print whether everything that a job needs is installed; returns the exit code."""
    if args.gpu:
        from mgf_engine.field.cuda_check import check_gpu

        return check_gpu()
    from mgf_engine.cli.doctor import report

    return report(args.weights)


def _weights_command(args: argparse.Namespace) -> int:
    """Download or copy the weights of EfficientSAM."""
    from mgf_engine.weights import copy_weights, download_weights

    if args.source is not None:
        model, folder = copy_weights(args.source, args.model, args.folder)
        print(f"The weights ({model}) are in {folder}")
        return EXIT_DONE
    reporter = Reporter(make_sink("auto"))
    reporter.stages = ("masks",)
    reporter.stage("masks")
    with contextlib.closing(reporter):
        folder = download_weights(args.model or "vitt", args.folder, reporter)
    print(f"Weights are in {folder}")
    return EXIT_DONE


#: Command -> the function that runs it, imported when it is needed.
_COMMANDS = {
    "options": "cli.main:_options_command",
    "estimate": "cli.main:_estimate_command",
    "doctor": "cli.main:_doctor_command",
    "weights": "cli.main:_weights_command",
    "evaluate": "evaluation.command:evaluate_command",
    "drawings": "drawings.command:drawings_command",
    "models": "models.command:models_command",
    "preview": "masks.preview:preview_command",
    "clean": "cli.clean:clean_command",
    "georef": "georef.command:georef_command",
}
#: The same for commands that start jobs of their own; they are called with the options given for these, too.
_JOB_COMMANDS = {
    "buildings": "town.command:buildings_command",
    "town": "town.run:town_command",
    "suggest-clicks": "town.suggest:suggest_command",
}


def _function(place: str) -> Callable[..., int]:
    """Import a function named as ``module:function`` inside the package."""
    module, _, name = place.partition(":")
    found: Callable[..., int] = getattr(import_module(f"mgf_engine.{module}"), name)
    return found
