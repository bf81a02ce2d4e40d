# SPDX-License-Identifier: GPL-3.0-or-later
"""Options of the algorithms: documented, checked, carried by the config to the stage that they belong to."""

from __future__ import annotations

import json
import re
from dataclasses import fields, is_dataclass
from typing import Any

import pytest

from mgf_engine.cli.main import main
from mgf_engine.errors import BadInput
from mgf_engine.field.targets import TargetOptions
from mgf_engine.masks.propagation.random_walker_options import RandomWalkerOptions
from mgf_engine.options.algorithm_table import ALGORITHMS, COMMANDS, Algorithm
from mgf_engine.options.algorithms import algorithms_schema, parameter
from mgf_engine.options.config import SECTIONS, Config, as_dict, make_config
from mgf_engine.options.user_input import option_pairs
from mgf_engine.stages import STAGE_NAMES

OPTIONS = algorithms_schema()
UNITS = {
    "",
    "px",
    "degrees",
    "rad",
    "ground px",
    "ground px²",
    "px²",
    "grey levels",
    "point spacings",
    "m",
    "m²",
    "s",
    "1/px²",
}


@pytest.mark.parametrize("algorithm", ALGORITHMS, ids=lambda a: a.section)
def test_each_algorithm_has_a_dataclass_with_defaults_and_a_stage(algorithm: Algorithm) -> None:
    kind = algorithm.load()
    assert is_dataclass(kind) and kind.__dataclass_params__.frozen and kind().__class__ is kind
    assert algorithm.stage in (*STAGE_NAMES, *COMMANDS) and algorithm.section not in SECTIONS
    assert algorithm.title[0].isupper() and not algorithm.title.endswith(".")
    parameters = list(algorithm.parameters())
    assert parameters, "a section without options"
    for spec in parameters:
        kinds = [type(n).__name__ for n in spec.default] if isinstance(spec.default, tuple) else []
        declared = f"tuple[{', '.join(kinds)}]" if kinds else type(spec.default).__name__
        assert spec.type == declared, f"{spec.name}: the default is {declared}"
    assert make_config().algorithm(kind) == kind()


def test_sections_are_unique() -> None:
    assert len({a.section for a in ALGORITHMS}) == len({a.options for a in ALGORITHMS}) == len(ALGORITHMS)


@pytest.mark.parametrize("entry", OPTIONS, ids=lambda entry: entry["name"])
def test_help_is_a_phrase_with_a_known_unit_and_the_default_is_allowed(entry: dict[str, Any]) -> None:
    text = entry["help"]
    assert text[0].isupper() and not text.endswith(".") and len(text) <= 160
    assert not re.match(r"(What|Which|Where|How|Whether)\b", text), "name the thing: 'Number of …', 'Radius of …'"
    assert entry["unit"] in UNITS
    value = entry["default"]
    for number in value if isinstance(value, tuple) else (value,):
        assert entry["low"] is None or number >= entry["low"]
        assert entry["high"] is None or number <= entry["high"]


def test_a_set_option_reaches_its_dataclass_and_the_job_file() -> None:
    config = make_config(option_pairs(["random-walker.rounds=6", "random_walker.sky_odds=-3", "seed=2"]))
    options = config.algorithm(RandomWalkerOptions)
    assert (options.rounds, options.sky_odds, options.track_weight) == (6, -3.0, RandomWalkerOptions.track_weight)
    assert config.algorithms_of("masks") == {"random_walker.rounds": 6, "random_walker.sky_odds": -3.0}
    assert config.algorithms_of("mesh") == {}
    assert make_config(json.loads(json.dumps(as_dict(config)))) == config


def test_an_option_of_the_job_reaches_the_algorithms_that_use_it() -> None:
    options = make_config({"mask_margin": 0.02, "targets.least_gap": 4}).algorithm(TargetOptions)
    assert (options.margin, options.least_gap) == (0.02, 4.0)
    assert TargetOptions().margin == Config.mask_margin
    assert "targets.margin" not in {entry["name"] for entry in OPTIONS}  # one name for one option


def test_an_option_at_its_default_changes_no_job() -> None:
    assert make_config({"random_walker.rounds": "4"}) == make_config()


@pytest.mark.parametrize(
    ("given", "part"),
    [
        ({"random_walker.loops": 3}, "'mgf options --algorithms' lists the options of random_walker"),
        ({"random_walkers.rounds": 3}, "Unknown option 'random_walkers.rounds'"),
        ({"random_walker.rounds": 2.5}, "takes a whole number"),
        ({"random_walker.rounds": 0}, "must be at least 1, not 0"),
        ({"random_walker.building_above": 2}, "must be at most 1"),
        ({"random_walker.sky_odds": "nan"}, "takes a number"),
    ],
)
def test_bad_values_are_refused_in_one_sentence(given: dict[str, Any], part: str) -> None:
    with pytest.raises(BadInput, match=re.escape(part)):
        make_config(given)


def test_numbers_in_a_row_are_read_from_text_and_lists(monkeypatch: pytest.MonkeyPatch) -> None:
    spec = next(iter(fields(_pair())))
    monkeypatch.setattr(Algorithm, "parameters", lambda self: iter([spec]))
    for value in ("4, 60", [4, 60], (4.0, 60.0)):
        assert make_config({"random_walker.angles": value}).algorithms == {"random_walker.angles": (4.0, 60.0)}
    with pytest.raises(BadInput, match="takes 2 numbers with commas between them"):
        make_config({"random_walker.angles": "4"})


def _pair() -> type:
    from dataclasses import make_dataclass

    return make_dataclass("Pair", [("angles", tuple, parameter((4.0, 55.0), "Angles", "degrees"))], frozen=True)


def test_the_list_shows_every_option(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["options", "--algorithms"]) == 0
    printed = capsys.readouterr().out
    assert all(f"  {entry['name']}=" in printed for entry in OPTIONS)
    assert main(["options", "--algorithms", "--json"]) == 0
    assert [entry["name"] for entry in json.loads(capsys.readouterr().out)] == [entry["name"] for entry in OPTIONS]
