# SPDX-License-Identifier: GPL-3.0-or-later
"""Installing and checking the engine: the plan, the steps, and every way it can fail."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from collections import namedtuple
from pathlib import Path
from types import SimpleNamespace

import bpy
import pytest
from layouts import Recorder

from mgf_blender.common import runner
from mgf_blender.common.errors import UserError
from mgf_blender.common.job import Job
from mgf_blender.engine import environment, install, operators, swap
from mgf_blender.engine.status_label import draw_engine_missing
from mgf_blender.engine.task import CANCELLED, DONE, FAILED, Step, Task


def plan(tmp_path: Path, **more: object) -> install.InstallPlan:
    values = {
        "target": tmp_path / "environment", "python": Path(sys.executable), "wheel": tmp_path / "mgf_engine-1.whl",
        "constraints": tmp_path / "constraints.txt", "wheel_folder": None, "torch": "cpu",
    }  # fmt: skip
    return install.InstallPlan(**{**values, **more})


@pytest.fixture(autouse=True)
def room(monkeypatch):
    """A disk with room for the engine, whatever this machine has left."""
    _set_free(monkeypatch, 64 << 30)


def _set_free(monkeypatch: pytest.MonkeyPatch, free: int) -> None:
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage(1 << 40, (1 << 40) - free, free))


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


def test_full_disk_is_said_before_anything_is_written(tmp_path, monkeypatch):
    _set_free(monkeypatch, 5 << 30)
    install.make_task(plan(tmp_path), tmp_path / "other" / "log.txt")
    with pytest.raises(UserError, match="the engine needs 7 GB"):
        install.make_task(plan(tmp_path, torch="cuda"), tmp_path / "log.txt")
    monkeypatch.setattr(install.sys, "platform", "linux")
    with pytest.raises(UserError, match="the engine needs 7 GB"):  # PyPI has the CUDA build
        install.make_task(plan(tmp_path, default_index=True), tmp_path / "log.txt")
    _set_free(monkeypatch, 1 << 20)
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


def test_the_question_before_the_download_says_what_may_come(monkeypatch):
    monkeypatch.setattr(install.sys, "platform", "linux")
    sizes = [install.size(torch, default) for torch in ("cpu", "cuda") for default in (False, True)]
    assert sizes == ["about 2 GB", "2 to 7 GB", "about 7 GB", "about 7 GB"]
    monkeypatch.setattr(install.sys, "platform", "win32")
    assert install.size("cpu", True) == "about 2 GB"
    prefs = SimpleNamespace(torch_build="AUTO", wheel_folder="", default_index=False)
    monkeypatch.setattr(operators, "preferences", lambda: prefs)
    for there, size in ((True, "7 GB"), (False, "2 GB")):
        monkeypatch.setattr(install, "has_nvidia", lambda there=there: there)
        assert size in operators._install_question()


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


def shortened(tmp_path: Path, ending: str) -> Task:
    """An installation whose packages are left out: the environment, and a check that ends in some way."""
    task = install.make_task(plan(tmp_path), tmp_path / "log.txt")
    made = Step(task.steps[0].title, [*task.steps[0].command, "--without-pip"])
    task.steps = [made, Step("Checking the engine", [task.steps[-1].command[0], "-c", ending])]
    return task


def prefix_of(tmp_path: Path) -> str:
    python = environment.python_of(tmp_path / "environment")
    done = subprocess.run([python, "-c", "import sys; print(sys.prefix)"], capture_output=True, text=True, check=True)
    return done.stdout.strip()


def folders(tmp_path: Path) -> list[str]:
    swap.wait()
    return sorted(p.name for p in tmp_path.iterdir() if p.is_dir())


def test_a_new_engine_takes_the_old_ones_place_only_after_its_check(tmp_path):
    assert shortened(tmp_path, "0").run() == DONE
    assert folders(tmp_path) == ["environment"] and prefix_of(tmp_path) == str(tmp_path / "environment")
    mark = tmp_path / "environment" / "first"
    mark.touch()
    assert shortened(tmp_path, "raise SystemExit('no kernels')").run() == FAILED
    assert mark.is_file() and folders(tmp_path) == ["environment"]
    assert shortened(tmp_path, "0").run() == DONE
    assert not mark.exists() and folders(tmp_path) == ["environment"]


def test_a_cancelled_installation_leaves_no_half_and_says_so(tmp_path):
    for words, left in (("nothing was installed", []), ("the engine from before is kept", ["environment"])):
        task = shortened(tmp_path, "import time; time.sleep(60)")
        while task.title != "Checking the engine":
            assert task.drain()
        assert folders(tmp_path) == [*left, "environment-new"]
        task.cancel()
        assert task.run() == CANCELLED and words in task.text
        assert folders(tmp_path) == left
        assert shortened(tmp_path, "0").run() == DONE


def test_blender_ended_in_the_middle_of_an_installation(tmp_path, monkeypatch):
    target = tmp_path / "environment"
    monkeypatch.delenv(environment.VARIABLE, raising=False)
    monkeypatch.setattr(environment, "managed_environment", lambda: target)
    with pytest.raises(UserError, match="is not installed"):
        environment.engine_python()
    task = shortened(tmp_path, "import time; time.sleep(60)")
    while task.title != "Checking the engine":
        task.drain()
    with pytest.raises(UserError, match="installation was interrupted"):
        environment.engine_python()
    task.cancel()
    task.run()
    swap.wait()
    assert shortened(tmp_path, "0").run() == DONE
    swap.wait()
    target.rename(tmp_path / "environment-old")  # the new one was about to come here
    assert environment.engine_python() == environment.python_of(target)


def test_panels_say_that_the_engine_is_being_installed(addon, tmp_path, monkeypatch):
    monkeypatch.delenv(environment.VARIABLE, raising=False)
    monkeypatch.setattr(environment, "managed_environment", lambda: tmp_path / "environment")
    task = shortened(tmp_path, "import time; time.sleep(60)")
    monkeypatch.setattr(operators, "_task", task)
    monkeypatch.setattr(operators, "_kind", "install")
    while task.title != "Checking the engine":
        task.drain()
    layout = Recorder()
    assert draw_engine_missing(layout)
    said = " ".join(text for text, _ in layout.texts)
    assert "is being installed" in said and "interrupted" not in said and "Checking the engine" in said
    task.cancel()
    task.run()
    swap.wait()
    layout = Recorder()
    assert draw_engine_missing(layout)
    assert "is not installed" in " ".join(text for text, _ in layout.texts)


def test_what_cannot_be_installed_is_not_asked(addon, monkeypatch):
    monkeypatch.setattr(operators, "preferences", lambda: SimpleNamespace(wheel_folder=""))
    asked, said = [], []
    manager = SimpleNamespace(invoke_confirm=lambda *_, **__: asked.append(1) or {"RUNNING_MODAL"})
    operator = SimpleNamespace(report=lambda kind, text: said.append(text))
    context = SimpleNamespace(window_manager=manager)
    assert not bpy.app.online_access
    assert operators.MGF_OT_install_engine.invoke(operator, context, None) == {"CANCELLED"}
    assert not asked and "Online access is off" in said[0]


def test_an_engine_in_use_is_kept(tmp_path, monkeypatch):
    """Windows does not rename a folder whose programs run."""
    assert shortened(tmp_path, "0").run() == DONE

    def refuse(path: Path, to: Path) -> None:
        raise PermissionError(13, "Access is denied", str(path))

    monkeypatch.setattr(Path, "rename", refuse)
    task = shortened(tmp_path, "0")
    assert task.run() == FAILED and "in use" in task.text and "Access is denied" in task.text
    with pytest.raises(UserError, match="close other Blender windows"):
        swap.remove(tmp_path / "environment")
    assert folders(tmp_path) == ["environment"] and prefix_of(tmp_path)


def test_an_old_engine_is_removed_where_no_process_can_start(tmp_path, monkeypatch):
    """A machine without memory for one more process, or without room for its output."""
    target = tmp_path / "environment"

    def refuse(*_: object, **__: object) -> None:
        raise BlockingIOError(11, "Resource temporarily unavailable")

    for broken in (subprocess, "Popen"), (tempfile, "mkstemp"):
        assert shortened(tmp_path, "0").run() == DONE
        task = shortened(tmp_path, "0")
        while task.title != "Checking the engine":
            assert task.drain()
        with monkeypatch.context() as context:
            context.setattr(*broken, refuse)
            assert task.run() == DONE
            assert folders(tmp_path) == ["environment"]
            swap.remove(target)
            assert folders(tmp_path) == []


def test_the_engine_is_not_replaced_under_a_running_job(addon, tmp_path, monkeypatch):
    monkeypatch.setattr(operators, "managed_environment", lambda: tmp_path / "environment")
    assert bpy.ops.mgf.install_engine.poll() and bpy.ops.mgf.remove_engine.poll()
    job = Job(["true"], tmp_path / "job", "A job")
    monkeypatch.setattr(runner, "_jobs", [job])
    assert job.live and not bpy.ops.mgf.install_engine.poll() and not bpy.ops.mgf.remove_engine.poll()
    job.status = "DONE"
    shortened(tmp_path, "0").run()
    swap.wait()
    bpy.ops.mgf.remove_engine()
    assert folders(tmp_path) == []


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


def test_check_engine(addon, engine, monkeypatch, tmp_path):
    assert bpy.ops.mgf.check_engine() == {"FINISHED"}
    assert operators.current()[1].output[-1] == "Everything a job needs is here."
    monkeypatch.setenv("MGF_ENGINE_PYTHON", sys.executable)
    with pytest.raises(RuntimeError, match="has no MGF engine"):
        bpy.ops.mgf.check_engine()
    monkeypatch.setenv("MGF_ENGINE_PYTHON", str(tmp_path / "gone"))
    with pytest.raises(RuntimeError, match="There is no Python"):
        bpy.ops.mgf.check_engine()


def test_check_gpu(addon, engine):
    assert bpy.ops.mgf.check_gpu() == {"FINISHED"}
    assert operators.current()[1].output[-1] == "The GPU passed in 9 s."
    engine("bad")
    with pytest.raises(RuntimeError, match=r"^Error: The GPU did not pass\."):
        bpy.ops.mgf.check_gpu()


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
