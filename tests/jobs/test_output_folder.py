# SPDX-License-Identifier: GPL-3.0-or-later
"""A run for deliverables of a finished job refuses folders of other things, and keeps a record of its files."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from mgf_engine.errors import BadInput
from mgf_engine.jobs.output_folder import Cost, Deliverables, check_output_folder, warn_of_replacement
from mgf_engine.messages import Message, Reporter
from mgf_engine.options.config import make_config


def test_folders_of_something_else_are_refused(tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").touch()
    with pytest.raises(BadInput, match="holds no drawings"):
        check_output_folder(tmp_path, "drawings.json", "drawings")
    with pytest.raises(BadInput, match="is a file"):
        check_output_folder(tmp_path / "thesis.txt", "drawings.json", "drawings")
    if sys.platform != "win32":  # a device is neither file nor folder: all was drawn before it was refused
        with pytest.raises(BadInput, match="is a file"):
            check_output_folder(Path(os.devnull), "drawings.json", "drawings")
    (tmp_path / "drawings.json").touch()
    check_output_folder(tmp_path, "drawings.json", "drawings")
    check_output_folder(tmp_path / "new", "drawings.json", "drawings")


def test_a_part_is_said_to_take_the_place_of_everything_before(tmp_path: Path) -> None:
    said: list[Message] = []
    warn_of_replacement(tmp_path, "drawings.json", Reporter(said.append))
    assert not said
    for name in ("drawings.json", "plan.svg"):
        (tmp_path / name).touch()
    warn_of_replacement(tmp_path, "drawings.json", Reporter(said.append))
    assert "(2 files); stop it and give --out" in said[0]["text"]


def test_files_are_on_record_and_the_result_names_them(tmp_path: Path) -> None:
    said: list[Message] = []
    cost = Cost({"reading": 1.2, "lines": 2.9})
    work = Deliverables(config=make_config(), folder=tmp_path / ".part", reporter=Reporter(said.append), cost=cost)
    assert work.add("plan.svg", kind="plan") == tmp_path / ".part" / "plan.svg"
    work.send(tmp_path, facades=4)
    (message,) = said
    assert message["type"] == "result" and message["files"] == {"plan.svg": str(tmp_path / "plan.svg")}
    assert message["figures"] == {"facades": 4, "CPU seconds": 4.1} and work.files == {"plan.svg": {"kind": "plan"}}


@pytest.mark.parametrize(
    ("seconds", "shown"), [(0.04, "0.0"), (0.31, "0.3"), (9.94, "9.9"), (10.4, "10"), (75.6, "76")]
)
def test_short_runs_have_a_decimal(tmp_path: Path, seconds: float, shown: str) -> None:
    said: list[Message] = []
    cost = Cost({"lines": seconds})
    Deliverables(config=make_config(), folder=tmp_path, reporter=Reporter(said.append), cost=cost).send(tmp_path)
    assert str(said[0]["figures"]["CPU seconds"]) == shown
