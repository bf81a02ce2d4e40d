# SPDX-License-Identifier: GPL-3.0-or-later
"""Installing and checking the engine: the plan, the steps, and every way it can fail."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from installation import plan

from mgf_blender.common.errors import UserError
from mgf_blender.engine import environment, install
from mgf_blender.engine.task import CANCELLED, DONE, FAILED, Step, Task

pytestmark = pytest.mark.usefixtures("free_space")


def test_steps_of_a_download(tmp_path):
    steps = install.make_task(plan(tmp_path), tmp_path / "log.txt").steps
    commands = [" ".join(s.command) for s in steps]
    assert "-m venv" in commands[0] and "torch" in commands[1] and "--index-url" in commands[1]
    assert commands[1].count("http") == 1 and "whl/cpu" in commands[1] and "--no-deps" in commands[1]
    assert all("--only-binary :all:" in c and "-c " in c for c in commands[1:3]) and "http" not in commands[2]
    assert "mgf_engine-1.whl" in commands[2] and "doctor" in commands[3]
    assert "whl/cu" in " ".join(install.make_task(plan(tmp_path, torch="cuda"), tmp_path / "log.txt").steps[1].command)


def test_the_packages_for_drawings_come_where_they_are_ticked(addon, tmp_path, monkeypatch):
    def engine(**more):
        return install.make_task(plan(tmp_path, **more), tmp_path / "log.txt").steps[2].command[-1]

    assert engine() == str(tmp_path / "mgf_engine-1.whl")
    assert engine(survey=True) == str(tmp_path / "mgf_engine-1.whl") + "[survey]"
    assert engine(models=True) == str(tmp_path / "mgf_engine-1.whl") + "[models]"
    assert engine(survey=True, models=True) == str(tmp_path / "mgf_engine-1.whl") + "[survey,models]"


def test_wheel_folder_means_no_network(tmp_path):
    folder = tmp_path / "wheels"
    folder.mkdir()
    with pytest.raises(UserError, match="no wheel of torch"):
        install.make_task(plan(tmp_path, wheel_folder=folder), tmp_path / "log.txt")
    (folder / "torch-2.whl").touch()
    steps = install.make_task(plan(tmp_path, wheel_folder=folder), tmp_path / "log.txt").steps
    assert all("--no-index" in s.command for s in steps[1:3]) and "http" not in str([s.command for s in steps])


def test_full_disk_is_said_before_anything_is_written(tmp_path, monkeypatch, free_space):
    free_space(5 << 30)
    install.make_task(plan(tmp_path), tmp_path / "other" / "log.txt")
    with pytest.raises(UserError, match="the engine needs 7 GB"):
        install.make_task(plan(tmp_path, torch="cuda"), tmp_path / "log.txt")
    monkeypatch.setattr(install.sys, "platform", "linux")
    with pytest.raises(UserError, match="the engine needs 7 GB"):  # PyPI has the CUDA build
        install.make_task(plan(tmp_path, default_index=True), tmp_path / "log.txt")
    free_space(1 << 20)
    with pytest.raises(UserError, match="the engine needs 3 GB"):
        install.make_task(plan(tmp_path), tmp_path / "log.txt")
    assert not (tmp_path / "environment").exists() and not (tmp_path / "log.txt").exists()


def _no_build_of(package: str, asked: str) -> str:
    """What pip 26 says where a package has no build for the Python in use."""
    return (
        f"The conflict is caused by:\n    mgf-engine{asked}\n    The user requested (constraint) {package}==1\n\n"
        "Additionally, some packages in these conflicts have no matching distributions available for your environment:"
        f"\n    {package}\n\nERROR: ResolutionImpossible: for help visit https://pip.pypa.io"
    )


@pytest.mark.parametrize(
    ("output", "words"),
    [
        ("Retrying (Retry(total=4)) after connection broken by 'NewConnectionError'", "cannot be reached"),
        (
            "WARNING: Retrying after connection broken by 'NameResolutionError(\"Failed to resolve "
            "'download.pytorch.org' ([Errno -2] Name or service not known)\")'\n    torch\n"
            "ERROR: ResolutionImpossible: for help visit",
            "cannot be reached",
        ),
        ("OSError: [Errno 28] No space left on device", "disk is full"),
        ("No module named ensurepip", "cannot make environments"),
        ("ERROR: No matching distribution found for torch==2.13.0", "No build of torch==2.13.0 fits"),
        ("ERROR: ResolutionImpossible: for help visit", "do not fit together"),
        (_no_build_of("xatlas", ' [models] 0.1.0 depends on xatlas; extra == "models"'), "without 'Models', or"),
        (_no_build_of("torch", " 0.1.0 depends on torch"), "No build of torch fits Python"),
        (
            "ERROR: Could not install packages due to an OSError: [Errno 2] No such file or directory: 'C:\\x'\n"
            "HINT: This error might have occurred since this system does not have Windows Long Path support enabled.",
            "path is too long",
        ),
        ("OSError: [WinError 206] The filename or extension is too long: 'C:\\x'", "path is too long"),
        ("something odd", "something odd"),
        ("ERROR: Could not build this.\n  see the page\n  (above, or)", "(Could not build this)"),
        ("word " * 90, "word …)"),
    ],
)
def test_pip_failures_are_one_sentence(output, words):
    text = install.explain(Step("Installing torch", []), ["Collecting torch", *output.split("\n"), ""])
    assert words in text and text.endswith(".") and "\n" not in text


def test_on_windows_the_environment_has_a_short_path(monkeypatch):
    monkeypatch.setattr(environment.sys, "platform", "win32")
    monkeypatch.setenv("LOCALAPPDATA", "/Users/maximilian.mustermann/AppData/Local")
    target = environment.managed_environment()
    assert target == Path("/Users/maximilian.mustermann/AppData/Local/mgf/engine")
    install.check_length("C:" + str(target))


def test_too_long_a_path_is_said_before_anything_is_written(tmp_path, monkeypatch):
    # The longest name in the pinned wheel of torch has 167 letters, Windows allows 259 in all.
    fits = "C:\\" + "x" * (259 - 167 - len("C:\\" + "\\Lib\\site-packages\\"))
    install.check_length(fits)
    with pytest.raises(UserError, match=r"1 character.s. too long"):
        install.check_length(fits + "x")
    monkeypatch.setattr(install.sys, "platform", "win32")
    monkeypatch.setattr(install, "_long_paths_allowed", lambda: False)
    deep = tmp_path / ("x" * 80)
    with pytest.raises(UserError, match="enable long paths"):
        install.make_task(plan(tmp_path, target=deep / "engine"), tmp_path / "log.txt")
    assert not deep.exists() and not (tmp_path / "log.txt").exists()
    monkeypatch.setattr(install, "_long_paths_allowed", lambda: True)
    assert install.make_task(plan(tmp_path, target=deep / "engine"), tmp_path / "log.txt").steps


def test_an_index_of_torch_that_does_not_answer_is_named_and_no_other_is_asked(tmp_path):
    step = install.make_task(plan(tmp_path), tmp_path / "log.txt").steps[1]
    text = install.explain(step, ["Retrying after 'NewConnectionError'"])
    assert "download.pytorch.org" in text and "other builds" in text and text.endswith(".")
    step = install.make_task(plan(tmp_path, default_index=True), tmp_path / "log.txt").steps[1]
    assert "pytorch.org" not in install.explain(step, ["Retrying after 'NewConnectionError'"])


def test_weights_are_fetched_or_taken_from_the_wheel_folder(tmp_path):
    def weights(**more):
        steps = install.make_task(plan(tmp_path, **more), tmp_path / "log.txt").steps
        return [s for s in steps if "weights" in s.command]

    assert weights() == []
    (step,) = weights(weights=True, weights_folder=tmp_path / "mine")
    assert step.command[-2:] == ["--folder", str(tmp_path / "mine")] and not step.needed
    (tmp_path / "torch-2.whl").touch()
    (step,) = weights(weights=True, wheel_folder=tmp_path)
    assert step.command[-2:] == ["--from", str(tmp_path)]


def test_an_installation_without_its_weights_is_done_and_says_so(tmp_path):
    fails = [sys.executable, "-c", "raise SystemExit('Error: Cannot download the encoder; check the network.')"]
    steps = [Step("Fetching", [*fails, "mgf_engine"], needed=False), Step("Next", [sys.executable, "-c", "0"])]
    task = Task(steps, tmp_path / "log.txt", install.explain)
    assert task.run() == DONE and task.note == "Cannot download the encoder; check the network."


def test_a_real_environment_is_made_and_a_failing_step_stops(tmp_path):
    log = tmp_path / "folder" / "log.txt"
    python = tmp_path / "environment" / "bin" / "python"
    steps = [
        Step(
            "Creating the environment",
            [sys.executable, "-I", "-m", "venv", "--without-pip", str(tmp_path / "environment")],
        ),
        Step("Asking it", [str(python), "-c", "print('hello from it')"]),
        Step("Failing", [str(python), "-c", "raise SystemExit('broken on purpose')"]),
        Step("Never", [str(python), "-c", "print('never')"]),
    ]
    ends = []
    task = Task(steps, log, install.explain, on_end=ends.append)
    assert task.run() == FAILED and "broken on purpose" in task.text and ends == [task]
    text = log.read_text()
    assert "hello from it" in text and "never" not in text.replace("== Never", "") and 0 < task.fraction < 1


def test_cancel_ends_the_running_step(tmp_path):
    task = Task(
        [Step("Sleeping", [sys.executable, "-c", "import time; time.sleep(60)"])], tmp_path / "l", install.explain
    )
    task.drain()
    task.cancel()
    assert task.run() == CANCELLED


def test_unwritable_log_does_not_stop_the_work():
    assert Task([Step("x", [sys.executable, "-c", "0"])], Path("/proc/no/log"), install.explain).run() == DONE


@pytest.mark.parametrize(
    ("system", "machine", "fits"),
    [
        ("Linux", "x86_64", "manylinux_2_17_x86_64"), ("Linux", "aarch64", "manylinux_2_17_aarch64"),
        ("Windows", "amd64", "win_amd64"), ("Darwin", "arm64", "macosx_12_0_arm64"),
        ("Darwin", "x86_64", "macosx_12_0_x86_64"), ("Windows", "arm64", None), ("FreeBSD", "amd64", None),
    ],
)  # fmt: skip
def test_each_machine_gets_its_own_wheel(tmp_path, monkeypatch, system, machine, fits):
    tags = ("manylinux_2_17_x86_64", "manylinux_2_17_aarch64", "win_amd64", "macosx_12_0_arm64", "macosx_12_0_x86_64")
    for tag in tags:
        (tmp_path / f"mgf_engine-0.1.0-py3-none-{tag}.whl").touch()
    monkeypatch.setattr(install, "carried_folder", lambda: tmp_path)
    monkeypatch.setattr(install.platform, "system", lambda: system)
    monkeypatch.setattr(install.platform, "machine", lambda: machine)
    if fits is None:
        with pytest.raises(UserError, match="no engine for"):
            install.carried_wheel()
    else:
        assert install.carried_wheel().name.endswith(f"-{fits}.whl")
