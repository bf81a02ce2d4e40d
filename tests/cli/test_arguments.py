# SPDX-License-Identifier: GPL-3.0-or-later
"""Arguments of the command line: help, and mistakes named with what was meant."""

import argparse
import re

import pytest

from mgf_engine.cli.arguments import Parser, make_parser, parse_arguments
from mgf_engine.cli.main import main
from tests.support.command_line import mgf


def test_help_lists_the_options_of_daily_work_and_names_the_list_of_the_others() -> None:
    text = mgf("reconstruct", "--help").stdout
    for name in ("--max-gaussians", "--no-openings", "--cancel-on-eof", "--resume", "'mgf options' lists all options"):
        assert name in text
    assert "--no-screening" not in text and text.count("\n  --") < 45


def test_options_for_experiments_have_flags_too() -> None:
    parsed = parse_arguments(["reconstruct", "scene", "--out", "job", "--no-screening", "--smoothing", "3"])
    assert parsed.screening is False and parsed.smoothing == "3"


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (["reconstruct", "scene", "--out", "job", "--gaussians", "5"], "'--gaussians'; did you mean --max-gaussians?"),
        (["town", "scene", "--out", "town", "--footprints=a.gpkg", "--exekutor", "x"], "did you mean --executor?"),
        (["doctor", "--nothing-like-it"], "'mgf doctor' does not know '--nothing-like-it'; 'mgf doctor --help'"),
        (["georef", "job", "one", "two"], "'mgf georef' does not know 'one';"),
    ],
)
def test_an_unknown_argument_is_named_with_the_one_that_was_meant(args, said, capsys) -> None:
    assert main(args) == 2
    error = capsys.readouterr().err
    assert said in error and error.startswith("Error: ") and error.count("\n") == 1


def test_the_parser_lists_every_argument_that_its_help_shows() -> None:
    commands = make_parser().commands
    assert {"reconstruct", "mesh", "models", "georef", "town", "bench"} < set(commands)
    for name in ("reconstruct", "models", "georef", "estimate"):
        parser, help = commands[name]
        shown = set(re.findall(r"(?<![\w-])--[a-z][\w-]*", parser.format_usage() + _flags_in_help(parser)))
        known = (action for action in parser.arguments if action.help != argparse.SUPPRESS)
        listed = {flag for action in known for flag in action.option_strings if flag.startswith("--")}
        assert help and listed == shown


def _flags_in_help(parser: Parser) -> str:
    """The beginnings of the lines that stand for an argument, not the sentences beside them."""
    return "\n".join(
        re.split(r"\s{2,}", line.strip())[0] for line in parser.format_help().splitlines() if line[:3] == "  -"
    )


@pytest.mark.parametrize(
    ("args", "said"),
    [
        ([], "Error: The following arguments are required: COMMAND; 'mgf --help' lists all."),
        (["reconstruct", "scene"], "are required: --out; 'mgf reconstruct --help' lists all."),
        (["town", "scene", "--out", "town", "--cores", "all"], "Argument --cores takes a whole number, not 'all'"),
        (
            ["rekonstruct"],
            "Error: There is no command 'rekonstruct'; did you mean reconstruct? 'mgf --help' lists all.",
        ),
        (
            ["clean", "job", "last"],
            "Error: Argument RUN takes a whole number, not 'last'; 'mgf clean --help' lists all.",
        ),
        (
            ["evaluate", "--reach", "far"],
            "Argument --reach takes a number, not 'far'; 'mgf evaluate --help' lists all.",
        ),
        (["drawings", "job", "--paper", "A9"], "Argument --paper takes one of 'A3', 'A1', not 'A9'; 'mgf drawings"),
        (["suggest-clicks", "scene", "--out", "o", "--point", "1", "2"], "Argument --point takes 3 values; 'mgf sugg"),
        (["xyzzy"], "no command 'xyzzy'; 'mgf --help' lists all."),
    ],
)
def test_a_mistake_in_the_arguments_is_one_sentence(args, said, capsys) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(args)
    error = capsys.readouterr().err
    assert said in error and error.startswith("Error: ") and error.count("\n") == 1
