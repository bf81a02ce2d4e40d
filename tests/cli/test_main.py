# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line as people and scripts meet it: exit codes, one sentence, nothing half written."""

import contextlib
import errno
import importlib.util
import json
import logging
import os
import signal
import subprocess
import sys
from importlib.machinery import ExtensionFileLoader, ModuleSpec
from pathlib import Path
from types import ModuleType

import pytest

from mgf_engine.cli import main as cli
from mgf_engine.cli.main import main
from mgf_engine.errors import BadInput, Cancelled
from tests.support.command_line import mgf
from tests.support.jobs import run_here, write_photo_folder


def failed_sentence(run: subprocess.CompletedProcess) -> str:
    """The text of the one ``failed`` message of a run with ``--progress json``."""
    messages = [json.loads(line) for line in run.stdout.splitlines()]
    failed = [m for m in messages if m["type"] == "failed"]
    assert len(failed) == 1
    assert "Traceback" not in run.stderr
    return failed[0]["text"]


def test_libraries_are_told_to_keep_to_one_thread_before_they_are_loaded() -> None:
    """Spinning threads of theirs took the cores from ours: the masks of the demo cost twice the CPU time."""
    program = (
        "import os, sys; from mgf_engine.cli import main as cli; "
        "assert not {'numpy', 'torch', 'scipy'} & set(sys.modules); cli.main(['options']); "
        "print({n: os.environ[n] for n in cli.ENVIRONMENT} == cli.ENVIRONMENT)"
    )
    bare = {name: value for name, value in os.environ.items() if name not in cli.ENVIRONMENT}
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120, env=bare)
    assert run.stdout.endswith("True\n"), run.stderr


@pytest.mark.parametrize("args", [["--version"], ["--help"], ["reconstruct", "--help"], ["recontruct"], ["clean"]])
def test_help_and_slips_are_answered_without_loading_libraries(args: list[str]) -> None:
    """They take seconds to load, which is long for whoever asks for help or has mistyped a word."""
    program = (
        f"import sys; from mgf_engine.cli import main as cli\ntry:\n cli.main({args})\nexcept SystemExit:\n"
        " print(sorted({'numpy', 'scipy', 'torch', 'trimesh'} & set(sys.modules)))"
    )
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120)
    assert run.stdout.endswith("[]\n"), run.stdout[-200:] + run.stderr


@pytest.mark.parametrize(
    ("make", "args", "part"),
    [
        (None, ["{}/none"], "does not exist"),
        (None, [], "Give the scene"),
        ("empty", ["{}/empty"], "photo"),
        ("empty", ["{}/empty", "--set", "iterations=-1"], "at least 0"),
        ("empty", ["{}/empty", "--set", "nonsense"], "NAME=VALUE"),
        ("empty", ["{}/empty", "--preset", "fast"], "one of quick, draft, standard, fine"),
        ("empty", ["{}/empty", "--config", "{}/missing.json"], "Cannot read the config"),
        ("empty", ["{}/empty", "--prompts", "{}/missing.json"], "does not exist"),
        ("empty", ["{}/empty", "--masks", "{}/missing"], "does not exist"),
        ("empty", ["{}/empty", "--crop-box", "-1 2 3"], "crop box has 3 numbers"),
        ("empty", ["{}/" + 300 * "a"], "File name too long"),
        ("empty", ["{}/empty", "--masks", __file__], "is a file; give a folder"),
        ("empty", ["{}/empty", "--prompts", "{}/empty"], "is a folder; give a file"),
    ],
)
def test_bad_input_ends_with_code_2_and_one_sentence(tmp_path: Path, capsys, make, args, part) -> None:
    if make:
        (tmp_path / make).mkdir()
    filled = [a.format(tmp_path) for a in args]
    code, messages = run_here(capsys, "reconstruct", *filled, "--out", tmp_path / "job")
    (failed,) = (m["text"] for m in messages if m["type"] == "failed")
    assert code == 2 and part in failed
    assert not (tmp_path / "job").exists()


def test_a_folder_that_was_there_before_is_left_with_its_log(tmp_path: Path) -> None:
    (tmp_path / "photos").mkdir()
    (tmp_path / "job").mkdir()
    assert main(["scene", str(tmp_path / "photos"), "--out", str(tmp_path / "job")]) == 2
    assert (tmp_path / "job" / "log.txt").is_file()


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (MemoryError("34 GiB of samples"), ["Out of memory", "in run_job", "MemoryError: 34 GiB of samples"]),
        (BadInput("These are no photos."), ["These are no photos."]),
        (Cancelled(), ["Cancelled"]),
    ],
)
def test_the_log_tells_why_a_job_ended(tmp_path: Path, monkeypatch, capsys, error, said) -> None:
    """A job that ran out of memory left a log that ended with the beginning of its stage."""

    def run_job(*args: object, **more: object) -> None:
        raise error

    monkeypatch.setattr("mgf_engine.pipeline.run_job", run_job)
    (tmp_path / "photos").mkdir()
    (tmp_path / "job").mkdir()
    main(["scene", str(tmp_path / "photos"), "--out", str(tmp_path / "job"), "--progress", "plain"])
    log = (tmp_path / "job" / "log.txt").read_text(encoding="utf-8")
    assert all(words in log for words in said)
    assert ("Traceback" in log) == isinstance(error, MemoryError)
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a device of Linux")
def test_a_log_on_a_full_disk_is_no_matter(capfd) -> None:
    cli._log_to(Path("/dev/full"))
    logging.getLogger("mgf").info("stage scene begins")
    cli._close_log()
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("style", ["none", "plain", "auto"])
def test_what_is_wrong_is_said_however_little_progress_is_shown(tmp_path: Path, capsys, style: str) -> None:
    command = ["reconstruct", str(tmp_path / "nowhere"), "--out", str(tmp_path / "job"), "--progress", style]
    assert main(command) == 2
    said = capsys.readouterr()
    assert not said.out
    assert said.err.startswith("Error: ") and "does not exist" in said.err and said.err.count("\n") == 1


def test_a_folder_in_place_of_the_log_is_named(tmp_path: Path, capsys) -> None:
    (tmp_path / "photos").mkdir()
    (tmp_path / "job").mkdir()
    args = ["scene", str(tmp_path / "photos"), "--out", str(tmp_path / "job"), "--progress", "plain"]
    assert main(args) == 2  # no photos
    (tmp_path / "job" / "log.txt").unlink()
    (tmp_path / "job" / "log.txt").mkdir()
    assert main(args) == 2
    assert "log.txt' (Is a directory)" in capsys.readouterr().err


def test_an_option_value_of_an_earlier_version_is_warned_of(tmp_path: Path, capsys) -> None:
    (tmp_path / "photos").mkdir()
    args = ["scene", str(tmp_path / "photos"), "--out", str(tmp_path / "job"), "--progress", "plain"]
    assert main([*args, "--segmenter", "grabcut"]) == 2  # no photos
    said = capsys.readouterr()
    assert "grabcut has been renamed to segmenter=random_walker" in said.out + said.err


def test_ctrl_c_while_a_module_is_being_loaded_cancels(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """pybind11 makes an error of its own of it, which was a traceback and exit code 1."""

    def load(args: list[str]) -> int:
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            raise ImportError("std::bad_cast") from None
        return 0

    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    monkeypatch.setattr("mgf_engine.cli.main._run", load)
    try:
        assert main(["evaluate"]) == 3
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)
    assert capsys.readouterr().err == "Cancelled; run again to continue.\n"


class _Extension(ExtensionFileLoader):
    """What loads a module in C++, during which Ctrl-C comes."""

    loaded = False

    def create_module(self, spec: ModuleSpec) -> None:
        signal.raise_signal(signal.SIGINT)

    def exec_module(self, module: ModuleType) -> None:
        self.loaded = True


@pytest.mark.parametrize("where", ["swallowed", "extension"])
def test_ctrl_c_cancels_at_the_next_module(
    where: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """trimesh loads what it can do without in ``try: … except BaseException``: the command went on to its end. An
    exception while a module in C++ is being loaded aborted the process."""
    (tmp_path / "loaded_after_ctrl_c.py").write_text("")
    monkeypatch.syspath_prepend(tmp_path)
    extension = _Extension("extension", "extension.so")

    def load(args: list[str]) -> int:
        if where == "extension":
            importlib.util.module_from_spec(ModuleSpec("extension", extension))
            extension.exec_module(ModuleType("extension"))
        else:
            with contextlib.suppress(BaseException):
                signal.raise_signal(signal.SIGINT)
        importlib.import_module("loaded_after_ctrl_c")
        return 0

    before, finders = signal.signal(signal.SIGINT, signal.default_int_handler), list(sys.meta_path)
    monkeypatch.setattr("mgf_engine.cli.main._run", load)
    try:
        assert main(["evaluate"]) == 3
    finally:
        signal.signal(signal.SIGINT, before)
    assert capsys.readouterr().err == "Cancelled; run again to continue.\n"
    assert "loaded_after_ctrl_c" not in sys.modules and sys.meta_path == finders
    assert extension.loaded == (where == "extension")


_IN_A_COMMAND = """
import mgf_engine.cli.main as cli
cli._run = lambda args: exec("signal.raise_signal(signal.SIGINT)", {"signal": signal})
"""
_WHILE_IT_IS_LOADED = """
import mgf_engine.errors
class Finder:
    def find_spec(self, name, path, target=None):
        if name == "mgf_engine.cli.main":
            exec("signal.raise_signal(signal.SIGINT)")
sys.meta_path.insert(0, Finder())
"""


@pytest.mark.parametrize(
    ("where", "said"),
    [(_IN_A_COMMAND, "Cancelled; run again to continue.\n"), (_WHILE_IT_IS_LOADED, "Cancelled.\n")],
)
def test_ctrl_c_inside_an_exec_ends_with_the_exit_code(where: str, said: str, tmp_path: Path) -> None:
    """Dataclasses of modules that are being loaded are made so; Python ended by the signal, after our sentence."""
    code = f"""
import signal, sys
from mgf_engine.__main__ import main
signal.signal(signal.SIGINT, signal.default_int_handler)
{where}
sys.exit(main())
"""
    (tmp_path / "interrupted.py").write_text(code)
    places = os.pathsep.join([str(tmp_path), str(Path(__file__).parents[2])])
    run = subprocess.run(
        [sys.executable, "-m", "interrupted"],  # Python looks at the signal after -m, and not after -c
        capture_output=True, text=True, timeout=120, env={**os.environ, "PYTHONPATH": places},
    )  # fmt: skip
    assert (run.returncode, run.stderr) == (3, said)


def test_terminals_without_unicode_get_escapes(tmp_path: Path) -> None:
    narrow = {**os.environ, "PYTHONIOENCODING": "ascii"}
    run = mgf("scene", tmp_path / "mühle", "--out", tmp_path / "job", "--progress", "json", env=narrow)
    assert run.returncode == 2
    assert "mühle" in failed_sentence(run)
    run = mgf("bench", "smoke", "--page-only", "--out", tmp_path / "mühle", env=narrow)
    assert (run.returncode, run.stderr) == (0, "")
    assert "m\\xfchle" in run.stdout


@pytest.mark.skipif(os.name == "nt", reason="paths of Windows have one encoding")
def test_an_encoding_that_lacks_letters_of_a_path_is_named(tmp_path: Path) -> None:
    source = write_photo_folder(tmp_path / "Häuser")
    narrow = {**os.environ, "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    (tmp_path / "config.json").write_text(json.dumps({"control": str(source / "points.csv")}), encoding="utf-8")
    run = mgf("scene", source, "--out", tmp_path / "job", "--config", tmp_path / "config.json", env=narrow)
    assert run.returncode == 2 and "PYTHONUTF8=1" in run.stderr and "Traceback" not in run.stderr


@pytest.mark.skipif(os.name == "nt", reason="Windows keeps the folder that a program is in")
@pytest.mark.parametrize("arguments", ["scene photos --out job", "bench smoke"])
def test_a_current_folder_that_is_gone_is_said(tmp_path: Path, arguments: str) -> None:
    (tmp_path / "gone").mkdir()
    command = f"rmdir ../gone; '{sys.executable}' -m mgf_engine {arguments}"
    environment = {**os.environ, "PYTHONPATH": str(Path(cli.__file__).parents[2])}
    run = subprocess.run(["sh", "-c", command], cwd=tmp_path / "gone", env=environment, capture_output=True, text=True)
    assert (run.returncode, run.stderr.splitlines()[-1]) == (2, "Error: The current folder is gone; go to another one.")


def test_a_kernel_variant_that_cannot_run_is_refused_before_any_work(tmp_path: Path) -> None:
    (tmp_path / "photos").mkdir()
    args = ("scene", tmp_path / "photos", "--out", tmp_path / "job", "--progress", "json")
    run = mgf(*args, env={**os.environ, "MGF_KERNEL_VARIANT": "z80"})
    assert run.returncode == 2
    assert "Kernel variant 'z80'" in failed_sentence(run)


def test_a_file_for_a_job_folder_is_called_a_file(tmp_path: Path, capsys) -> None:
    (tmp_path / "file").write_text("mine")
    assert main(["mesh", "--out", str(tmp_path / "file"), "--progress", "plain"]) == 2
    assert "is a file; give a folder" in capsys.readouterr().err


@pytest.mark.parametrize(
    "arguments",
    [["reconstruct", "", "--out", "job"], ["town", "scene", "--out", ""], ["models", "job", "--out", ""],
     *([command, ""] for command in ("clean", "drawings", "evaluate", "georef", "models", "suggest-clicks"))],
)  # fmt: skip
def test_an_empty_path_is_not_this_folder(arguments: list[str], capsys) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(arguments)
    assert "empty; give a path" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("error", "code", "part"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), 2, "The disk is full"),
        (OSError(errno.ENOSPC, "No space left on device", "/far/off/mesh.ply"), 2, "The disk of '/far/off' is full"),
        (PermissionError(errno.EACCES, "Permission denied", "x"), 2, "No permission for 'x'"),
        (PermissionError(errno.EACCES, "Permission denied", "job/.part-x1y2.json"), 2, "No permission for 'job'"),
        (MemoryError(), 2, "Out of memory"),
        (KeyboardInterrupt(), 3, "Cancelled"),
        (ZeroDivisionError("oops"), 1, "Unexpected error: ZeroDivisionError: oops"),
    ],
)
def test_commands_without_a_job_end_in_a_sentence_too(monkeypatch, capsys, error, code, part) -> None:
    def fail(args: object) -> int:
        raise error

    monkeypatch.setattr(cli, "_doctor_command", fail)
    assert main(["doctor"]) == code
    said = capsys.readouterr().err
    assert part in said.splitlines()[-1] and "--resume" not in said
    assert ("Traceback" in said) == (code == 1)


def test_an_installed_package_runs_the_benchmarks_of_the_checkout_that_one_is_in(tmp_path, monkeypatch, capsys) -> None:
    """As in the tutorial: pip install, then 'mgf bench scenes demo' in the checkout."""
    monkeypatch.setattr(cli, "__file__", str(tmp_path / "site-packages" / "mgf_engine" / "cli" / "main.py"))
    monkeypatch.chdir(tmp_path)
    assert main(["bench", "scenes", "--help"]) == 2
    assert "run 'mgf bench' from a checkout" in capsys.readouterr().err
    monkeypatch.chdir(Path(__file__).parents[2])
    with pytest.raises(SystemExit) as ended:
        main(["bench", "scenes", "--help"])
    assert ended.value.code == 0 and "townhall40" in capsys.readouterr().out


def test_a_reader_that_closes_the_pipe_is_no_fault() -> None:
    command = f"{sys.executable} -m mgf_engine options --json | head -c 1"
    run = subprocess.run(["sh", "-c", command], capture_output=True, text=True, timeout=120)
    assert (run.stdout, run.stderr) == ("{", "")


@pytest.mark.skipif(os.name == "nt", reason="a shell of Unix")
def test_a_job_whose_progress_nobody_reads_is_not_done(tmp_path: Path) -> None:
    (tmp_path / "photos").mkdir()
    command = f"{{ '{sys.executable}' -m mgf_engine scene photos --out job --progress json; echo $? > code; }} | true"
    run = subprocess.run(["sh", "-c", command], cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert ((tmp_path / "code").read_text(), run.stderr) == ("3\n", "")


@pytest.mark.skipif(os.name == "nt", reason="a shell of Unix")
@pytest.mark.parametrize("arguments", ["options", "scene nowhere --out job --progress json"])
def test_closed_streams_are_no_fault(tmp_path: Path, arguments: str) -> None:
    command = f"exec 1>&- 2>&-; '{sys.executable}' -m mgf_engine {arguments}"
    run = subprocess.run(["sh", "-c", command], cwd=tmp_path, timeout=120)
    assert run.returncode == (0 if arguments == "options" else 2)


def test_options_are_data_for_other_programs(capsys) -> None:
    assert main(["options", "--json"]) == 0
    schema = json.loads(capsys.readouterr().out)
    assert {o["name"] for o in schema["options"]} >= {"preset", "iterations", "use_masks"}


def test_a_point_that_is_no_place_is_refused_before_any_work(tmp_path: Path, capsys) -> None:
    out = tmp_path / "out"
    assert main(["suggest-clicks", str(tmp_path), "--out", str(out), "--point", "nan", "0", "0"]) == 2
    assert "--point takes three finite numbers" in capsys.readouterr().err
    assert not out.exists()


def test_suggested_clicks_of_no_scene_leave_nothing(tmp_path: Path, capsys) -> None:
    (tmp_path / "empty").mkdir()
    assert main(["suggest-clicks", str(tmp_path / "empty"), "--out", str(tmp_path / "out")]) == 2
    assert "Traceback" not in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("command", ["drawings", "models", "georef", "clean"])
def test_a_folder_without_a_job_is_left_as_it_was(tmp_path: Path, capsys, command: str) -> None:
    assert main([command, str(tmp_path)]) == 2
    assert "holds no job" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
