# SPDX-License-Identifier: GPL-3.0-or-later
import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mgf_engine.errors import BadInput
from mgf_engine.options.algorithms import RENAMED_OPTIONS, algorithm_default, check_used
from mgf_engine.options.config import (
    RENAMED,
    SECTIONS,
    Config,
    as_dict,
    make_config,
    option_fields,
    options_schema,
    renamed_values,
)
from mgf_engine.options.presets import PRESETS
from mgf_engine.options.user_input import option_pairs, read_config


def test_defaults_are_valid() -> None:
    config = make_config()
    assert make_config(as_dict(config)) == config


@pytest.mark.parametrize("preset", list(PRESETS))
def test_presets_are_valid_and_options_win_over_them(preset: str) -> None:
    assert make_config({"preset": preset}).preset == preset
    assert make_config({"preset": preset, "iterations": 77}).iterations == 77


@pytest.mark.parametrize(
    ("given_options", "part"),
    [
        ({"iterationz": 3}, "Unknown option 'iterationz'"),
        ({"iterations": -1}, "at least 0"),
        ({"iterations": "many"}, "a whole number"),
        ({"iterations": 1.5}, "a whole number"),
        ({"iterations": True}, "a whole number"),
        ({"opacity_level": "nan"}, "a number"),
        ({"opacity_level": 2}, "at most 0.99"),
        ({"use_masks": "perhaps"}, "true or false"),
        ({"preset": "fast"}, "one of quick, draft, standard, fine"),
        ({"weights": 3}, "text"),
        ({"densify_from": 0.9, "densify_until": 0.1}, "densify_from"),
        ({"max_photos": 2}, "at least 3"),
        ({"iterations": "9" * 5000}, "iterations"),
    ],
)
def test_impossible_options_are_refused_in_one_sentence(given_options: dict, part: str) -> None:
    with pytest.raises(BadInput, match=part) as caught:
        make_config(given_options)
    assert "\n" not in str(caught.value)


def test_long_values_are_shown_in_part() -> None:
    with pytest.raises(BadInput) as caught:
        make_config({"iterations": "9" * 5000})
    assert len(str(caught.value)) < 200


def test_config_files_of_windows_editors_are_read(tmp_path) -> None:
    path = tmp_path / "c.json"
    for encoding in ("utf-8-sig", "utf-16"):  # UTF-16 is what PowerShell writes
        path.write_text('{"iterations": 5}', encoding=encoding)
        assert read_config(path) == {"iterations": 5}


def test_a_folder_in_place_of_a_config_file_is_said_without_numbers_of_the_system(tmp_path) -> None:
    with pytest.raises(BadInput) as caught:
        read_config(tmp_path)
    assert "Errno" not in str(caught.value) and str(caught.value).count(str(tmp_path)) == 1


def test_text_values_are_converted() -> None:
    config = make_config({"iterations": "12", "use_masks": "off", "opacity_level": "0.4"})
    assert (config.iterations, config.use_masks, config.opacity_level) == (12, False, 0.4)


@pytest.mark.parametrize(
    ("photos", "given", "wanted"),
    [(10, {}, 1000), (30, {}, 1500), (146, {}, 3000), (30, {"iterations": 7}, 7), (146, {"iterations": 9000}, 9000),
     (10, {"passes": 20}, 400), (30, {"passes": 20}, 600), (146, {"passes": 20}, 1200)],
)  # fmt: skip
def test_few_photos_train_shorter_unless_a_number_is_given(photos: int, given: dict[str, int], wanted: int) -> None:
    assert make_config(given).run_length(photos) == wanted


def test_schema_lists_every_option_once_with_help() -> None:
    schema = options_schema()
    assert [o["name"] for o in schema["options"]] == [f.name for f in option_fields()]
    for entry in schema["options"]:
        assert entry["section"] in SECTIONS and entry["level"] in ("basic", "advanced", "expert")
        assert entry["help"]
        assert not entry["help"].endswith(".")
    json.dumps(schema)


@pytest.mark.parametrize("content", [b"", b"[1]", b"{", b"\xff\xfe", b"[" * 100_000])
def test_unreadable_config_files_are_refused(tmp_path, content: bytes) -> None:
    path = tmp_path / "c.json"
    path.write_bytes(content)
    with pytest.raises(BadInput):
        read_config(path)


@given(st.dictionaries(st.sampled_from([f.name for f in option_fields()]), st.one_of(st.text(), st.floats(), st.integers(), st.booleans())))  # fmt: skip  # noqa: E501
def test_any_values_give_a_config_or_one_sentence(options: dict) -> None:
    try:
        make_config(options)
    except BadInput as error:
        assert str(error)


def test_a_value_of_an_earlier_version_is_taken_with_a_warning() -> None:
    assert make_config({"segmenter": "grabcut"}).segmenter == "random_walker"
    (text,) = renamed_values({"segmenter": "grabcut", "weights": "grabcut", "seed": 3})
    assert "segmenter=random_walker" in text and "this version only" in text
    assert renamed_values({"segmenter": "random_walker"}) == []


def test_options_of_an_earlier_name_are_taken_with_a_sentence() -> None:
    old = {"patch_match.most_off": "2", "patch_match.held_score": 0.5}
    now = make_config({"patch_match.consistency_max_cost": 2.0, "patch_match.consistency_min_ncc": 0.5})
    assert make_config(old) == now
    assert [text.split(" has been renamed to ")[0] for text in renamed_values(old)] == list(old)
    for name in RENAMED_OPTIONS.values():
        algorithm_default(name)  # fails where there is no such option
    assert not any(is_option(name) for name in RENAMED_OPTIONS), "an option that exists is not another one"


def is_option(name: str) -> bool:
    try:
        algorithm_default(name)
    except (KeyError, StopIteration):
        return False
    return True


def test_the_present_name_wins_over_the_earlier_one() -> None:
    both = {"wall_openings.depth": 3.0, "opening_detection.depth": "2"}  # a job of before, resumed with --set
    assert make_config(both) == make_config({"opening_detection.depth": 2.0})
    assert make_config(dict(reversed(both.items()))) == make_config(both)


def test_commands_take_options_of_a_section_by_its_earlier_name() -> None:
    check_used("drawings", ["wall_openings.depth"])
    with pytest.raises(BadInput, match="does not use the option"):
        check_used("models", ["wall_openings.depth"])


def test_renamed_values_are_choices() -> None:
    assert all(new in Config.__dataclass_fields__[name].metadata["choices"] and old != new
               for name, values in RENAMED.items() for old, new in values.items())  # fmt: skip


def test_options_may_be_set_with_their_section() -> None:
    assert option_pairs(["mesh.max-faces=5", "scene.resolution=300", "seed=2"]) == {
        "max_faces": "5", "resolution": "300", "seed": "2",
    }  # fmt: skip
    with pytest.raises(BadInput, match=r"'mesh', not 'field'; give --set mesh\.max_faces=VALUE\.$"):
        option_pairs(["field.max_faces=5"])
    with pytest.raises(BadInput, match="Unknown option"):
        make_config(option_pairs(["mesh.colour=5"]))


def test_an_unknown_option_is_named_as_it_was_given() -> None:
    with pytest.raises(BadInput, match=r"'photometic\.radius'"):
        make_config(option_pairs(["photometic.radius=3"]))
