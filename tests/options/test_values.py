# SPDX-License-Identifier: GPL-3.0-or-later
from __future__ import annotations

from typing import Any

import pytest

from mgf_engine.errors import BadInput
from mgf_engine.options.values import check_limits, convert, shorten


@pytest.mark.parametrize(
    ("given", "default", "wanted"),
    [
        ("on", False, True), (0, True, False), (" No ", True, False), ("7", 1, 7), (7.0, 1, 7), ("1e-3", 1.0, 1e-3),
        (3, 1.0, 3.0), ("text", "", "text"), ("1, 2.5", (0.0, 0.0), (1.0, 2.5)), ([1, 2], (0, 0), (1, 2)),
    ],
)  # fmt: skip
def test_values_take_the_type_of_the_default(given: Any, default: Any, wanted: Any) -> None:
    found = convert("radius", given, default)
    assert found == wanted and type(found) is type(wanted)


@pytest.mark.parametrize(
    ("given", "default", "said"),
    [
        ("perhaps", False, "true or false"), (True, 1, "a whole number"), (7.5, 1, "a whole number"),
        ("nan", 1.0, "a number"), ("1e999", 1.0, "a number"), (None, "", "text"), ("1,2,3", (0.0, 0.0), "2 numbers"),
        ("x", (1,), "1 numbers"), (10**400, 1.0, "a number"),
    ],
)  # fmt: skip
def test_other_values_are_refused_in_a_sentence(given: Any, default: Any, said: str) -> None:
    with pytest.raises(BadInput, match=f"Option radius takes {said}"):
        convert("radius", given, default)


def test_limits_hold_for_each_number() -> None:
    check_limits("radius", 1.0, 1.0, 1.0)
    check_limits("radius", (1, 2), None, 2)
    with pytest.raises(BadInput, match=r"at least 1, not 0\.5"):
        check_limits("radius", 0.5, 1.0, None)
    with pytest.raises(BadInput, match="at most 2, not 3"):
        check_limits("radius", (1, 3), 0, 2)
    with pytest.raises(BadInput, match="at most 2147483647, not 2147483648"):
        check_limits("seed", 2**31, 0, 2**31 - 1)


def test_long_values_are_shortened() -> None:
    assert len(shorten("x" * 500)) == 60 and shorten(10**60) == "a number of many digits" and shorten(5) == "5"
