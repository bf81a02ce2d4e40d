# SPDX-License-Identifier: GPL-3.0-or-later
"""Arguments of the ``mgf`` command; every option comes from :class:`mgf_engine.options.config.Config`."""

from __future__ import annotations

import argparse
import difflib
import re
from collections.abc import Sequence
from importlib import import_module
from typing import Any, NoReturn

from mgf_engine import __version__
from mgf_engine.cli.option_list import default_text
from mgf_engine.console.shared_arguments import (
    add_algorithm_arguments,
    add_config_arguments,
    add_job_argument,
    add_reporting_arguments,
    path_of,
)
from mgf_engine.errors import EXIT_BAD_INPUT, BadInput
from mgf_engine.options.config import option_fields
from mgf_engine.stages import SECTIONS, STAGES


class Parser(argparse.ArgumentParser):
    """An argument parser that reports a mistake in one sentence, without the usage text of argparse.

    Unlike argparse it has public lists of its arguments and commands.

    Attributes:
        arguments: of this parser, in order.
        commands: name -> parser and help text.
    """

    def __init__(self, **given: Any) -> None:
        self.arguments: list[argparse.Action] = []
        self.commands: dict[str, tuple[Parser, str]] = {}
        super().__init__(**given)

    def add_argument(self, *args: Any, **given: Any) -> argparse.Action:
        """Add an argument, and list it."""
        self.arguments.append(super().add_argument(*args, **given))
        return self.arguments[-1]

    def add_command(self, name: str, help: str, **given: Any) -> Parser:
        """Add a command, and list it; ``given`` goes to its parser."""
        if not self.commands:
            self._group = self.add_subparsers(dest="command", required=True, metavar="COMMAND")
        self.commands[name] = self._group.add_parser(name, help=help, **given), help
        return self.commands[name][0]

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Refuse an unknown command with a suggestion of the most similar one."""
        if action.dest == "command" and value not in self.commands:
            likely = difflib.get_close_matches(str(value), self.commands, n=1)
            meant = f"did you mean {likely[0]}? " if likely else ""
            self.exit(EXIT_BAD_INPUT, f"Error: There is no command '{value}'; {meant}'mgf --help' lists all.\n")
        super()._check_value(action, value)

    def error(self, message: str) -> NoReturn:
        for kind, wanted in (("int", "a whole number"), ("float", "a number")):  # argparse names Python's types
            message = message.replace(f": invalid {kind} value: ", f" takes {wanted}, not ", 1)
        message = message.replace(": takes ", " takes ", 1)  # what types say of texts that they refuse
        message = re.sub(r": invalid choice: ('.*?') \(choose from (.*)\)$", r" takes one of \2, not \1", message)
        message = re.sub(r": expected (\d+) arguments?$", r" takes \1 values", message)
        self.exit(EXIT_BAD_INPUT, f"Error: {message[:1].upper()}{message[1:]}; '{self.prog} --help' lists all.\n")


def parse_arguments(args: Sequence[str]) -> argparse.Namespace:
    """Parse the arguments of the ``mgf`` command.

    Raises:
        BadInput: one is unknown; the message names the one that was probably meant.
    """
    parser = make_parser(args[0] if args else "")
    parsed, unknown = parser.parse_known_args(args)
    if not unknown:
        return parsed
    wrong = next((text for text in unknown if text.startswith("-")), unknown[0]).split("=")[0]
    actions = parser.commands[parsed.command][0].arguments
    flags = [flag for action in actions for flag in action.option_strings if flag.startswith("--")]
    parts = [flag for flag in flags if wrong.startswith("--") and wrong[2:] in flag]
    likely = parts or difflib.get_close_matches(wrong, flags, n=1)
    meant = f"; did you mean {likely[0]}?" if likely else ";"
    raise BadInput(f"'mgf {parsed.command}' does not know '{wrong}'{meant} 'mgf {parsed.command} --help' lists all.")


def make_parser(command: str | None = None) -> Parser:
    """Make the parser of all commands.

    Args:
        command: the command that is asked for. Modules of other commands are not imported then, and their arguments
            are missing; None adds those of all commands, as the docs need them.
    """
    parser = Parser(prog="mgf", description="Reconstruct a clean mesh of a building from photos.")
    parser.add_argument("--version", action="version", version=f"mgf {__version__}")
    _add_job_command(parser, "reconstruct", "run all stages: from photos to mesh and report")
    for stage in STAGES:
        _add_job_command(parser, stage.name, f"run the stages up to this one: {stage.help}")
    _add_tools(parser)
    _add_after_the_job(parser, command)
    _add_towns(parser, command)
    parser.add_command("bench", help="run a benchmark suite; see 'mgf bench --help'", add_help=False)
    return parser


def _add_tools(mgf: Parser) -> None:
    """Add the commands about the installation, the options, and estimates of a job."""
    guess = mgf.add_command(
        "estimate", help="estimate time and memory of a job, per stage", argument_default=argparse.SUPPRESS
    )
    _add_inputs(guess)
    guess.add_argument("--out", type=path_of, default=None, metavar="JOB", help="ignored; all stages count as not done")
    guess.add_argument("--json", action="store_true", default=False, help="print JSON")
    _add_options(guess)
    doctor = mgf.add_command("doctor", help="show versions, kernel variant, device, memory and extras")
    doctor.add_argument(
        "--gpu", action="store_true", help="compare the GPU with the CPU, in a minute; auto then uses it"
    )
    doctor.add_argument("--card", dest="gpu", action="store_true", help=argparse.SUPPRESS)  # the old name
    doctor.add_argument("--weights", type=path_of, metavar="FOLDER", help="folder of the EfficientSAM weights")
    options = mgf.add_command("options", help="list all options with default and meaning")
    options.add_argument("--algorithms", action="store_true", help="list the options of the algorithms instead")
    options.add_argument("--json", action="store_true", help="print JSON")
    weights = mgf.add_command("weights", help="download and verify the weights of EfficientSAM or LPIPS")
    weights.add_argument("--model", choices=("vitt", "vits", "lpips-alex", "lpips-vgg"),
                         help="EfficientSAM by size (default vitt), or the LPIPS network")  # fmt: skip
    weights.add_argument("--folder", type=path_of, help="target folder (default: the user's cache folder)")
    weights.add_argument(
        "--from", dest="source", type=path_of, metavar="FOLDER", help="copy the files from this folder"
    )


def _add_after_the_job(mgf: Parser, only: str | None) -> None:
    """Add the commands that work on finished jobs, meshes and single photos."""
    evaluate = mgf.add_command("evaluate", help="compare a mesh with a true mesh, or measure the evenness of its walls")
    _add_arguments_of("evaluation.command", evaluate, only)
    drawings = mgf.add_command(
        "drawings", help="make drawings of a finished job: facade orthophotos, plans, elevations, sections, quantities"
    )
    _add_arguments_of("drawings.command", drawings, only)
    models = mgf.add_command("models", help="models of a finished job: levels of detail, 3D Tiles, solid, USD, points")
    _add_arguments_of("models.command", models, only)
    preview = mgf.add_command("preview", help="make the mask of one photo from its own clicks")
    _add_preview_arguments(preview)
    clean = mgf.add_command("clean", help="list or remove the results of earlier runs of a job")
    add_job_argument(clean)
    clean.add_argument("runs", nargs="*", type=int, metavar="RUN", help="numbers of the runs to remove")
    clean.add_argument("--old", action="store_true", help="remove all runs except the current one")
    georef = mgf.add_command(
        "georef", help="georeference a finished job by GPS, control points or scale bars",
        argument_default=argparse.SUPPRESS,
    )  # fmt: skip
    _add_georef_arguments(georef, only)


def _add_towns(mgf: Parser, only: str | None) -> None:
    """Add the commands for many buildings in one scene."""
    footprints = "every building of a scene, from a map of footprints"
    for name, module, text in (
        ("buildings", "town.command", f"choose photos and clicks of {footprints}"),
        ("town", "town.run", f"reconstruct {footprints}"),
        ("suggest-clicks", "town.suggest", "suggest clicks on one building, from the sparse points"),
    ):
        command = mgf.add_command(name, help=text, argument_default=argparse.SUPPRESS)
        _add_arguments_of(module, command, only)
        add_config_arguments(command)
        _add_options(command)


def _add_arguments_of(module: str, parser: Parser, only: str | None) -> None:
    """Add the arguments that a command's own module declares, unless another command is the only one asked for.

    Such modules import numpy and torch, which take seconds to load.
    """
    if only is None or parser.prog == f"mgf {only}":
        import_module(f"mgf_engine.{module}").add_arguments(parser)


def _add_georef_arguments(parser: Parser, only: str | None) -> None:
    _add_arguments_of("georef.command", parser, only)
    for spec in (f for f in option_fields() if f.metadata["section"] == "georef"):
        _add_option(parser, spec)


def _add_preview_arguments(parser: Parser) -> None:
    parser.add_argument("scene", type=path_of, help="COLMAP project, or folder of photos")
    parser.add_argument("--prompts", type=path_of, required=True, metavar="FILE", help="clicks on the building (JSON)")
    parser.add_argument("--image", required=True, metavar="NAME", help="name of the photo, as in the prompts file")
    parser.add_argument(
        "--out", type=path_of, required=True, metavar="MASK.png", help="255 building, 0 everything else"
    )
    parser.add_argument("--resolution", default=1000, metavar="PX", help="longest side of the mask (default 1000)")
    parser.add_argument("--segmenter", default="auto", help="auto, random_walker or efficientsam (default auto)")
    parser.add_argument("--weights", default="", metavar="FOLDER", help="folder of the EfficientSAM weights")
    add_algorithm_arguments(parser)


def _add_job_command(mgf: Parser, name: str, help: str) -> None:
    parser = mgf.add_command(
        name, help=help, description=help[:1].upper() + help[1:] + ".", argument_default=argparse.SUPPRESS,
        usage=f"mgf {name} [SCENE] --out JOB [--prompts FILE | --masks FOLDER] [OPTION ...]",
    )  # fmt: skip
    _add_inputs(parser, "?")
    parser.add_argument("--out", type=path_of, required=True, metavar="JOB", help="job folder")
    parser.add_argument("--resume", action="store_true", default=False, help="continue the job in the folder")
    add_reporting_arguments(parser)
    _add_options(parser)


def _add_inputs(parser: Parser, scenes: str | None = None) -> None:
    parser.add_argument("scene", nargs=scenes, type=path_of, default=None, help="COLMAP project, or folder of photos")
    parser.add_argument("--prompts", type=path_of, default=None, metavar="FILE", help="clicks on the building (JSON)")
    parser.add_argument("--masks", type=path_of, default=None, metavar="FOLDER", help="masks instead of clicks (PNGs)")
    add_config_arguments(parser)


def _add_options(parser: Parser) -> None:
    parser.epilog = "'mgf options' lists all options, those for experiments too; each has a flag."
    for section in SECTIONS:
        group = parser.add_argument_group(f"{section} options")
        for spec in (f for f in option_fields() if f.metadata["section"] == section):
            parser.arguments.append(_add_option(group, spec))


def _add_option(group: Any, spec: Any) -> argparse.Action:
    """Add the flag of an option of the job to a parser or a group of its arguments; help hides those of experts."""
    flag, meta = "--" + spec.name.replace("_", "-"), spec.metadata
    default = "" if spec.default == "" else f" (default {default_text(spec.default, meta['unit'])})"
    help = argparse.SUPPRESS if meta["level"] == "expert" else f"{meta['help']}{default}".replace("%", "%%")
    if isinstance(spec.default, bool):
        return group.add_argument(flag, action=argparse.BooleanOptionalAction, help=help)
    metavar = "{" + ",".join(meta["choices"]) + "}" if meta["choices"] else type(spec.default).__name__.upper()
    return group.add_argument(flag, metavar=metavar, help=help)
