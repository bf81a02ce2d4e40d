# SPDX-License-Identifier: GPL-3.0-or-later
"""The ``mgf`` command: thin, every option comes from :class:`mgf_engine.config.Config`."""

from __future__ import annotations

import argparse
import contextlib
import json
import logging
import os
import shutil
import sys
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mgf_engine import __version__
from mgf_engine.algorithms import algorithms_schema
from mgf_engine.config import option_fields, option_pairs, options_schema, read_config, renamed_values
from mgf_engine.errors import EXIT_DONE, EXIT_FAULT, BadInput, explain
from mgf_engine.messages import Reporter
from mgf_engine.option_list import algorithms_text, default_text, options_text
from mgf_engine.reported import send_failed, watch_for_cancel
from mgf_engine.stages import SECTIONS, STAGE_NAMES, STAGES
from mgf_engine.terminal import drop_output, make_sink, prepare_streams

#: For numpy and torch, which read it when they are loaded: the engine's own threads take every core, and threads of
#: libraries that wait for work by spinning take them away again (half of the time of the masks).
ENVIRONMENT = {"OPENBLAS_NUM_THREADS": "1", "OMP_WAIT_POLICY": "PASSIVE"}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code (0 done, 1 fault, 2 bad input, 3 cancelled)."""
    args = sys.argv[1:] if argv is None else list(argv)
    for name, value in ENVIRONMENT.items():
        os.environ.setdefault(name, value)
    prepare_streams()
    try:
        code = _run(args)
        sys.stdout.flush()
        return code
    except BrokenPipeError:  # the reader has seen enough, as `head` does
        drop_output()
        return EXIT_DONE
    except (Exception, KeyboardInterrupt) as error:
        code, text = explain(error, resumable=False)
        if code == EXIT_FAULT:
            traceback.print_exception(error)
        print(f"Error: {text}", file=sys.stderr)
        return code


def _run(args: list[str]) -> int:
    if args[:1] == ["bench"]:
        return _bench_command(args[1:])
    parsed = _parser().parse_args(args)
    if parsed.command in ("reconstruct", *STAGE_NAMES):
        return _job_command(parsed)
    return int(_OTHER_COMMANDS[parsed.command](parsed))


def _bench_command(args: list[str]) -> int:
    """Run the benchmarks, which stand beside the package in a checkout and are in no wheel.

    Raises:
        BadInput: there is no checkout around this package.
    """
    checkout = Path(__file__).resolve().parent.parent
    if not (checkout / "benchmarks" / "run.py").is_file():
        raise BadInput(
            "The benchmarks are not in the installed package; run 'mgf bench' from a checkout of the source code, "
            "where the folder 'benchmarks' stands beside 'mgf_engine'."
        )
    sys.path.insert(0, str(checkout))
    from benchmarks.run import bench_main

    return bench_main(args)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="mgf", description="Reconstruct a clean mesh of a building from photos.")
    parser.add_argument("--version", action="version", version=f"mgf {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    _add_job_command(commands, "reconstruct", "run all stages: from photos to mesh and report")
    for stage in STAGES:
        _add_job_command(commands, stage.name, f"run the stages up to this one: {stage.help}")
    guess = commands.add_parser(
        "estimate", help="estimate time and memory of a job, per stage", argument_default=argparse.SUPPRESS
    )
    _add_inputs(guess)
    guess.add_argument("--out", type=_path, default=None, metavar="JOB", help="ignored; all stages count as not done")
    guess.add_argument("--json", action="store_true", default=False, help="print JSON")
    _add_options(guess)
    doctor = commands.add_parser("doctor", help="show versions, kernel variant, device and memory")
    doctor.add_argument(
        "--card", action="store_true", help="compare the card with the CPU, in a minute; auto then uses it"
    )
    doctor.add_argument("--weights", type=_path, metavar="FOLDER", help="folder of the EfficientSAM weights")
    options = commands.add_parser("options", help="list all options with default and meaning")
    options.add_argument("--algorithms", action="store_true", help="list the options of the algorithms instead")
    options.add_argument("--json", action="store_true", help="print JSON")
    weights = commands.add_parser("weights", help="download and verify the weights of EfficientSAM or LPIPS")
    weights.add_argument("--model", choices=("vitt", "vits", "lpips-alex", "lpips-vgg"),
                         help="EfficientSAM by size (default vitt), or the LPIPS network")  # fmt: skip
    weights.add_argument("--folder", type=_path, help="target folder (default: the user's cache folder)")
    weights.add_argument("--from", dest="source", type=_path, metavar="FOLDER", help="copy the files from this folder")
    evaluate = commands.add_parser(
        "evaluate", help="compare a mesh with a true mesh, or measure the evenness of its walls"
    )
    _add_evaluate_arguments(evaluate)
    drawings = commands.add_parser(
        "drawings", help="make drawings of a finished job: facade orthophotos, plans, elevations, sections, quantities"
    )
    _add_drawings_arguments(drawings)
    models = commands.add_parser(
        "models", help="models of a finished job: levels of detail, 3D Tiles, solid, USD, points"
    )
    _add_models_arguments(models)
    preview = commands.add_parser("preview", help="make the mask of one photo from its own clicks")
    _add_preview_arguments(preview)
    clean = commands.add_parser("clean", help="list or remove the results of earlier runs of a job")
    clean.add_argument("job", type=_path, metavar="JOB", help="job folder")
    clean.add_argument("runs", nargs="*", type=int, metavar="RUN", help="numbers of the runs to remove")
    clean.add_argument("--old", action="store_true", help="remove all runs except the current one")
    georef = commands.add_parser(
        "georef", help="georeference a finished job by GPS, control points or scale bars",
        argument_default=argparse.SUPPRESS,
    )  # fmt: skip
    _add_georef_arguments(georef)
    buildings = commands.add_parser(
        "buildings", help="choose photos and clicks of every building of a scene, from a map of footprints",
        argument_default=argparse.SUPPRESS,
    )  # fmt: skip
    _add_buildings_arguments(buildings)
    town = commands.add_parser(
        "town", help="reconstruct every building of a scene, from a map of footprints",
        argument_default=argparse.SUPPRESS,
    )  # fmt: skip
    _add_town_arguments(town)
    suggest = commands.add_parser(
        "suggest-clicks", help="suggest clicks on one building, from the sparse points",
        argument_default=argparse.SUPPRESS,
    )  # fmt: skip
    _add_suggest_arguments(suggest)
    commands.add_parser("bench", help="run a benchmark suite; see 'mgf bench --help'", add_help=False)
    return parser


def _path(text: str) -> Path:
    if not text:  # which pathlib takes for the present folder
        raise argparse.ArgumentTypeError("is empty; give a path")
    return Path(text)


def _add_evaluate_arguments(parser: argparse.ArgumentParser) -> None:
    from mgf_engine.evaluation.command import add_arguments

    add_arguments(parser)


def _add_drawings_arguments(parser: argparse.ArgumentParser) -> None:
    from mgf_engine.drawings.command import add_arguments

    add_arguments(parser)


def _add_models_arguments(parser: argparse.ArgumentParser) -> None:
    from mgf_engine.models.command import add_arguments

    add_arguments(parser)


def _add_buildings_arguments(parser: argparse.ArgumentParser) -> None:
    from mgf_engine.town.command import add_arguments

    add_arguments(parser)
    _add_config_arguments(parser)


def _add_town_arguments(parser: argparse.ArgumentParser) -> None:
    from mgf_engine.town.run import add_arguments

    add_arguments(parser)
    _add_config_arguments(parser)


def _add_suggest_arguments(parser: argparse.ArgumentParser) -> None:
    from mgf_engine.town.suggest import add_arguments

    add_arguments(parser)
    _add_config_arguments(parser)


def _add_config_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--config", type=_path, default=None, metavar="FILE", help="options from a JSON file")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="set any option by name, as max_faces=5 or mesh.max_faces=5",
    )
    _add_options(parser)


def _add_georef_arguments(parser: argparse.ArgumentParser) -> None:
    from mgf_engine.georef.command import add_arguments

    parser.add_argument("job", type=_path, metavar="JOB", help="folder of a finished job")
    add_arguments(parser)
    for spec in (f for f in option_fields() if f.metadata["section"] == "georef"):
        _add_option(parser, spec)


def _add_preview_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scene", type=_path, help="COLMAP project, or folder of photos")
    parser.add_argument("--prompts", type=_path, required=True, metavar="FILE", help="clicks on the building (JSON)")
    parser.add_argument("--image", required=True, metavar="NAME", help="name of the photo, as in the prompts file")
    parser.add_argument("--out", type=_path, required=True, metavar="MASK.png", help="255 building, 0 everything else")
    parser.add_argument("--resolution", default=1000, metavar="PX", help="longest side of the mask (default 1000)")
    parser.add_argument("--segmenter", default="auto", help="auto, random_walker or efficientsam (default auto)")
    parser.add_argument("--weights", default="", metavar="FOLDER", help="folder of the EfficientSAM weights")


def _add_job_command(commands: Any, name: str, help: str) -> None:
    parser = commands.add_parser(
        name, help=help, description=help[:1].upper() + help[1:] + ".", argument_default=argparse.SUPPRESS,
        usage=f"mgf {name} [SCENE] --out JOB [--prompts FILE | --masks FOLDER] [OPTION ...]",
    )  # fmt: skip
    _add_inputs(parser, "?")
    parser.add_argument("--out", type=_path, required=True, metavar="JOB", help="job folder")
    parser.add_argument("--resume", action="store_true", default=False, help="continue the job in the folder")
    styles = ("auto", "bar", "plain", "json", "none")
    parser.add_argument("--progress", choices=styles, default="auto", help="style of messages (default auto)")
    parser.add_argument("--cancel-on-eof", action="store_true", default=False, help="cancel when standard input closes")
    _add_options(parser)


def _add_inputs(parser: argparse.ArgumentParser, scenes: str | None = None) -> None:
    parser.add_argument("scene", nargs=scenes, type=_path, default=None, help="COLMAP project, or folder of photos")
    parser.add_argument("--prompts", type=_path, default=None, metavar="FILE", help="clicks on the building (JSON)")
    parser.add_argument("--masks", type=_path, default=None, metavar="FOLDER", help="masks instead of clicks (PNGs)")
    parser.add_argument("--config", type=_path, default=None, metavar="FILE", help="read options from a JSON file")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="set an option; repeatable")


def _add_options(parser: argparse.ArgumentParser) -> None:
    for section in SECTIONS:
        group = parser.add_argument_group(f"{section} options")
        for spec in (f for f in option_fields() if f.metadata["section"] == section):
            _add_option(group, spec)


def _add_option(group: Any, spec: Any) -> None:
    flag, meta = "--" + spec.name.replace("_", "-"), spec.metadata
    default = "" if spec.default == "" else f" (default {default_text(spec.default, meta['unit'])})"
    help = f"{meta['help']}{default}".replace("%", "%%")
    if isinstance(spec.default, bool):
        group.add_argument(flag, action=argparse.BooleanOptionalAction, help=help)
    else:
        metavar = "{" + ",".join(meta["choices"]) + "}" if meta["choices"] else type(spec.default).__name__.upper()
        group.add_argument(flag, metavar=metavar, help=help)


def _given_options(args: argparse.Namespace) -> dict[str, Any]:
    """Options from --config, then --set, then flags; the later wins."""
    given = read_config(args.config) if args.config else {}
    given.update(option_pairs(args.set))
    names = {f.name for f in option_fields()}
    given.update({name: value for name, value in vars(args).items() if name in names})
    if isinstance(given.get("crop_box"), str):  # a file is read once, so that a resumed job keeps its box
        from mgf_engine.scene.crop import read_crop_box

        given["crop_box"] = read_crop_box(given["crop_box"])
    return given


def _job_command(args: argparse.Namespace) -> int:
    reporter = Reporter(make_sink(args.progress))
    log_path: Path | None = None
    try:
        job = _open_job(args)
        with job:
            log_path = _log_to(job.path("log.txt"))
            watch_for_cancel(reporter, args.cancel_on_eof)
            for text in renamed_values(_given_options(args)):
                reporter.warning(text)
            from mgf_engine.pipeline import run_job

            run_job(job, reporter, until=STAGE_NAMES[-1] if args.command == "reconstruct" else args.command)
        return EXIT_DONE
    except (Exception, KeyboardInterrupt) as error:
        return _fail(reporter, error, log_path)


def _open_job(args: argparse.Namespace) -> Any:
    from mgf_engine.job import Job

    resume = args.resume or args.command in STAGE_NAMES
    return Job.start(args.out, args.scene, args.prompts, args.masks, _given_options(args), resume)


def _fail(reporter: Reporter, error: BaseException, log_path: Path | None) -> int:
    """Say in one sentence why the job ends early; the traceback of a fault goes to the log."""
    code, text = explain(error)
    log = logging.getLogger("mgf")
    if code == EXIT_FAULT:
        details = "".join(traceback.format_exception(error))
        with contextlib.suppress(OSError):
            log.error("%s", details)
        if log_path is None:
            print(details, file=sys.stderr)
    shown = str(log_path) if log_path and code == EXIT_FAULT else None
    send_failed(reporter, code, text, shown)
    return code


def _log_to(path: Path) -> Path:
    log = logging.getLogger("mgf")
    log.setLevel(logging.INFO)
    log.propagate = False
    for old in list(log.handlers):
        log.removeHandler(old)
        old.close()
    handler = logging.FileHandler(path, encoding="utf-8")
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    log.addHandler(handler)
    return path


def _options_command(args: argparse.Namespace) -> int:
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
    """Width of the terminal in characters."""
    return shutil.get_terminal_size((100, 24)).columns


def _estimate_command(args: argparse.Namespace) -> int:
    from mgf_engine.config import make_config
    from mgf_engine.estimate import as_data, as_table, estimate, inspect_photos, with_clicks
    from mgf_engine.masks.prompts import PromptsFile
    from mgf_engine.memory import budget_of

    config, photos = make_config(_given_options(args)), inspect_photos(args.scene, args.out)
    photos = with_clicks(photos, PromptsFile.read(args.prompts) if args.prompts else None)
    budget = budget_of(config.memory)
    found = estimate(config, photos, budget=budget)
    data = as_data(found, config, photos, budget)
    print(json.dumps(data, indent=1) if args.json else as_table(data))
    return EXIT_DONE


def _doctor_command(args: argparse.Namespace) -> int:
    if args.card:
        from mgf_engine.field.cuda_check import check_card

        return check_card()
    from mgf_engine.doctor import report

    return report(args.weights)


def _weights_command(args: argparse.Namespace) -> int:
    from mgf_engine.masks.segmenters.download import copy_weights, download_weights

    if args.source is not None:
        model, folder = copy_weights(args.source, args.model, args.folder)
        print(f"The weights ({model}) are in {folder}")
        return EXIT_DONE
    reporter = Reporter(make_sink("auto"))
    reporter.stages = ("masks",)
    reporter.stage("masks")
    folder = download_weights(args.model or "vitt", args.folder, reporter)
    print(f"Weights are in {folder}")
    return EXIT_DONE


def _evaluate_command(args: argparse.Namespace) -> int:
    from mgf_engine.evaluation.command import evaluate_command

    return evaluate_command(args)


def _drawings_command(args: argparse.Namespace) -> int:
    from mgf_engine.drawings.command import drawings_command

    return drawings_command(args)


def _models_command(args: argparse.Namespace) -> int:
    from mgf_engine.models.command import models_command

    return models_command(args)


def _preview_command(args: argparse.Namespace) -> int:
    from mgf_engine.masks.preview import preview_command

    return preview_command(args)


def _clean_command(args: argparse.Namespace) -> int:
    from mgf_engine.clean import clean_command

    return clean_command(args)


def _georef_command(args: argparse.Namespace) -> int:
    from mgf_engine.georef.command import georef_command

    return georef_command(args)


def _buildings_command(args: argparse.Namespace) -> int:
    from mgf_engine.town.command import buildings_command

    return buildings_command(args, _given_options(args))


def _town_command(args: argparse.Namespace) -> int:
    from mgf_engine.town.run import town_command

    return town_command(args, _given_options(args))


def _suggest_command(args: argparse.Namespace) -> int:
    from mgf_engine.town.suggest import suggest_command

    return suggest_command(args, _given_options(args))


_OTHER_COMMANDS = {
    "town": _town_command,
    "suggest-clicks": _suggest_command,
    "buildings": _buildings_command,
    "georef": _georef_command,
    "clean": _clean_command,
    "doctor": _doctor_command,
    "drawings": _drawings_command,
    "models": _models_command,
    "estimate": _estimate_command,
    "options": _options_command,
    "weights": _weights_command,
    "evaluate": _evaluate_command,
    "preview": _preview_command,
}
