# SPDX-License-Identifier: GPL-3.0-or-later
"""Tables as surveyors write them."""

from __future__ import annotations

from pathlib import Path

import pytest

from mgf_engine.errors import BadInput
from mgf_engine.georef.tables import number_in, read_table, read_text

NAMES = {"name": ("name", "label"), "east": ("east", "x"), "north": ("north", "y")}


def write(folder: Path, content: str | bytes) -> Path:
    path = folder / "points.csv"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("", "holds no rows"),
        ("# a comment\n", "holds no rows"),
        ("name;x;y\n", "holds no rows"),
        (b"a\0b", "no text file"),
    ],
)
def test_files_without_rows_are_refused(tmp_path: Path, content: str | bytes, said: str) -> None:
    with pytest.raises(BadInput, match=said):
        read_table(write(tmp_path, content), NAMES)


def test_a_missing_and_a_huge_file_are_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="Cannot read"):
        read_text(tmp_path / "nothing.csv")
    huge = tmp_path / "huge.csv"
    with huge.open("wb") as file:
        file.truncate((16 << 20) + 1)
    with pytest.raises(BadInput, match="larger than a table"):
        read_text(huge)


def test_a_field_without_a_number_is_named_by_its_line(tmp_path: Path) -> None:
    table = read_table(write(tmp_path, "name;x;y\n\n# note\nP1;1,5;left\nP2;3\n"), NAMES)
    with pytest.raises(BadInput, match=r"Line 4 of .* has 'left' where a number belongs"):
        table.number(0, 2)
    with pytest.raises(BadInput, match=r"Line 5 of .* has ''"):
        table.number(1, 2)
    assert table.number(0, 1) == 1.5
    assert [table.text(0, 2), table.text(1, 2), table.text(0, None)] == ["left", "", ""]


@pytest.mark.parametrize(
    "content",
    [
        "name,x,y\nP 1,1.5,-2\n",
        "name;x;y\nP 1;1,5;-2\n",
        "Label\tX/East\tY/North\nP 1\t1.5\t-2\n",
        '"name";"x";"y"\n"P 1";"1.5";"-2"\n',
        "\ufeffname,x,y\r\nP 1,1.5,-2\r\n",
        'name, x, y\n"P 1", "1,5", -2\n',
    ],
)
def test_separators_decimal_commas_and_quotes(tmp_path: Path, content: str) -> None:
    table = read_table(write(tmp_path, content), NAMES)
    assert table.columns == {"name": 0, "east": 1, "north": 2} and table.rows[0][0] == "P 1"
    assert (table.number(0, 1), table.number(0, 2)) == (1.5, -2.0)


def test_quotes_hold_the_separator(tmp_path: Path) -> None:
    table = read_table(write(tmp_path, 'name,x,y\n"P 1, old",1.5,-2\nP2,3,4\n'), NAMES)
    assert table.rows == [["P 1, old", "1.5", "-2"], ["P2", "3", "4"]]


def test_a_field_without_end_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="no text file"):
        read_table(write(tmp_path, "name,x,y\nP1," + 200_000 * "1" + ",2\n"), NAMES)


def test_a_table_without_heading_keeps_its_first_row(tmp_path: Path) -> None:
    table = read_table(write(tmp_path, "P1  1.5   2\nP2 3 4\n"), NAMES)
    assert table.columns == {} and table.rows == [["P1", "1.5", "2"], ["P2", "3", "4"]] and table.lines == [1, 2]


@pytest.mark.parametrize("heading", ["", "Name Ost Nord\n"])
def test_blanks_separate_fields_with_decimal_commas(tmp_path: Path, heading: str) -> None:
    table = read_table(
        write(tmp_path, f"{heading}P1 4471,25 -5320,5\nP2 1,0 2\n"), {"name": ("name",), "east": ("ost",)}
    )
    assert [table.number(0, 1), table.number(0, 2), table.number(1, 1)] == [4471.25, -5320.5, 1.0]
    assert [row[0] for row in table.rows] == ["P1", "P2"]


@pytest.mark.parametrize("row", ["P1, 1.5, 2", "P 1,1.5,2", "P1,1,2", "a b c,1.5,2"])
def test_commas_separate_fields_beside_blanks(tmp_path: Path, row: str) -> None:
    assert len(read_table(write(tmp_path, f"{row}\n"), NAMES).rows[0]) == 3


def test_a_heading_in_a_comment_counts_where_no_row_has_one(tmp_path: Path) -> None:
    table = read_table(write(tmp_path, "#Label,X/East,Y/North\nP1,1.5,2\n"), NAMES)
    assert table.columns == {"name": 0, "east": 1, "north": 2} and table.notes == ["Label,X/East,Y/North"]


def test_the_western_code_page_is_read(tmp_path: Path) -> None:
    assert read_text(write(tmp_path, "Südost".encode("cp1252"))) == "Südost"


@pytest.mark.parametrize(
    ("text", "value"),
    [(" 1.5 ", 1.5), ("-1,25", -1.25), ("+3", 3.0), ("1e3", 1000.0), ("1,234,567", None), ("", None), ("nan", None),
     ("inf", None), ("12 m", None)],
)  # fmt: skip
def test_numbers(text: str, value: float | None) -> None:
    assert number_in(text) == value
