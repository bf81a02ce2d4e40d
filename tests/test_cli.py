# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line as people and scripts meet it: exit codes, one sentence, nothing half written."""

import json
import subprocess
import sys
from pathlib import Path

import pytest


def mgf(*args: object, **more: object) -> subprocess.CompletedProcess:
    command = [sys.executable, "-m", "mgf_engine", *map(str, args)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, **more)  # type: ignore[call-overload]


def failed_sentence(run: subprocess.CompletedProcess) -> str:
    """The text of the one ``failed`` message of a run with ``--progress json``."""
    messages = [json.loads(line) for line in run.stdout.splitlines()]
    failed = [m for m in messages if m["type"] == "failed"]
    assert len(failed) == 1
    assert "Traceback" not in run.stderr
    return failed[0]["text"]


@pytest.mark.parametrize(
    ("make", "args", "part"),
    [
        (None, ["{}/none"], "does not exist"),
        (None, [], "Give the scene"),
        ("empty", ["{}/empty"], "photo"),
        ("empty", ["{}/empty", "--set", "iterations=0"], "at least 1"),
        ("empty", ["{}/empty", "--set", "nonsense"], "NAME=VALUE"),
        ("empty", ["{}/empty", "--preset", "fast"], "one of draft, standard, fine"),
        ("empty", ["{}/empty", "--config", "{}/missing.json"], "Cannot read the config"),
        ("empty", ["{}/empty", "--prompts", "{}/missing.json"], "does not exist"),
        ("empty", ["{}/empty", "--masks", "{}/missing"], "does not exist"),
        ("empty", ["{}/empty", "--crop-box", "-1 2 3"], "crop box has 3 numbers"),
    ],
)
def test_bad_input_ends_with_code_2_and_one_sentence(tmp_path: Path, make, args, part) -> None:
    if make:
        (tmp_path / make).mkdir()
    filled = [a.format(tmp_path) for a in args]
    run = mgf("reconstruct", *filled, "--out", tmp_path / "job", "--progress", "json")
    assert run.returncode == 2
    assert part in failed_sentence(run)
    assert not (tmp_path / "job" / "mesh.ply").exists()


def test_options_are_data_for_other_programs() -> None:
    schema = json.loads(mgf("options", "--json").stdout)
    assert {o["name"] for o in schema["options"]} >= {"preset", "iterations", "use_masks"}


def test_doctor_names_versions_and_the_kernel_variant() -> None:
    run = mgf("doctor")
    assert run.returncode == 0, run.stdout
    assert "kernel variant" in run.stdout
    assert "Everything a job needs is here." in run.stdout


def test_help_lists_every_option() -> None:
    text = mgf("reconstruct", "--help").stdout
    for name in ("--max-gaussians", "--no-screening", "--cancel-on-eof", "--resume"):
        assert name in text
