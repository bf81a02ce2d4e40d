# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line as people and scripts meet it: exit codes, one sentence, nothing half written."""

import errno
import hashlib
import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
import trimesh

from benchmarks.synthetic.colmap_scene import reconstruction, write_model
from mgf_engine import cli, doctor
from mgf_engine.cli import main
from mgf_engine.cli_arguments import Parser, make_parser
from mgf_engine.masks.segmenters import download
from mgf_engine.masks.segmenters.download import WeightFile


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


def test_libraries_are_told_to_keep_to_one_thread_before_they_are_loaded() -> None:
    """Spinning threads of theirs took the cores from ours: the masks of the demo cost twice the CPU time."""
    program = (
        "import os, sys; from mgf_engine import cli; assert not {'numpy', 'torch', 'scipy'} & set(sys.modules); "
        "cli.main(['options']); print({n: os.environ[n] for n in cli.ENVIRONMENT} == cli.ENVIRONMENT)"
    )
    bare = {name: value for name, value in os.environ.items() if name not in cli.ENVIRONMENT}
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120, env=bare)
    assert run.stdout.endswith("True\n"), run.stderr


@pytest.mark.parametrize("args", [["--version"], ["--help"], ["reconstruct", "--help"], ["recontruct"], ["clean"]])
def test_help_and_slips_are_answered_without_loading_libraries(args: list[str]) -> None:
    """They take seconds to load, which is long for whoever asks for help or has mistyped a word."""
    program = (
        f"import sys; from mgf_engine import cli\ntry:\n cli.main({args})\nexcept SystemExit:\n"
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
def test_bad_input_ends_with_code_2_and_one_sentence(tmp_path: Path, make, args, part) -> None:
    if make:
        (tmp_path / make).mkdir()
    filled = [a.format(tmp_path) for a in args]
    run = mgf("reconstruct", *filled, "--out", tmp_path / "job", "--progress", "json")
    assert run.returncode == 2
    assert part in failed_sentence(run)
    assert not (tmp_path / "job").exists()


def test_a_folder_that_was_there_before_is_left_with_its_log(tmp_path: Path) -> None:
    (tmp_path / "photos").mkdir()
    (tmp_path / "job").mkdir()
    assert mgf("scene", tmp_path / "photos", "--out", tmp_path / "job").returncode == 2
    assert (tmp_path / "job" / "log.txt").is_file()


@pytest.mark.parametrize("style", ["none", "plain", "auto"])
def test_what_is_wrong_is_said_however_little_progress_is_shown(tmp_path: Path, style: str) -> None:
    run = mgf("reconstruct", tmp_path / "nowhere", "--out", tmp_path / "job", "--progress", style)
    assert run.returncode == 2 and not run.stdout
    assert run.stderr.startswith("Error: ") and "does not exist" in run.stderr and run.stderr.count("\n") == 1


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


def test_terminals_without_unicode_get_escapes(tmp_path: Path) -> None:
    narrow = {**os.environ, "PYTHONIOENCODING": "ascii"}
    run = mgf("scene", tmp_path / "mühle", "--out", tmp_path / "job", "--progress", "json", env=narrow)
    assert run.returncode == 2
    assert "mühle" in failed_sentence(run)
    run = mgf("bench", "smoke", "--page-only", "--out", tmp_path / "mühle", env=narrow)
    assert (run.returncode, run.stderr) == (0, "")
    assert "m\\xfchle" in run.stdout


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


@pytest.fixture
def triangle(tmp_path: Path) -> str:
    path = tmp_path / "triangle.ply"
    trimesh.Trimesh(np.eye(3), [[0, 1, 2]]).export(path)
    return str(path)


@pytest.mark.parametrize(
    ("args", "part"),
    [
        (["--thresholds", "nan"], "larger than 0"),
        (["--thresholds", "0.1", "inf"], "larger than 0"),
        (["--samples", "10000000000000"], "at most"),
        (["--json", "{}"], "Cannot write the figures"),
        (["--json", __file__ + "/figures.json"], "Cannot write the figures"),
        (["--picture", "{}"], "Cannot write the picture"),
        (["--leave-out", "{}/triangle.ply"], "to be scored"),
        (["--leave-out", "{}/nothing.ply"], "There is no mesh"),
        (["--scene", "{}"], "There is no COLMAP model"),
        (["--photo-size", "0"], "--photo-size must be"),
    ],
)
def test_evaluate_refuses_in_one_sentence(tmp_path: Path, triangle: str, capsys, args, part) -> None:
    filled = [a.format(tmp_path) for a in args]
    assert main(["evaluate", triangle, "--truth", triangle, "--samples", "100", *filled]) == 2
    said = capsys.readouterr().err
    assert part in said and said.count("\n") == 1
    assert [p.name for p in tmp_path.iterdir()] == ["triangle.ply"]


def test_evaluate_leaves_a_part_of_the_truth_out(tmp_path: Path, triangle: str, capsys) -> None:
    far = np.eye(3) + 5
    trimesh.Trimesh(far, [[0, 1, 2]]).export(tmp_path / "far.ply")
    trimesh.Trimesh(np.r_[np.eye(3), far], [[0, 1, 2], [3, 4, 5]]).export(tmp_path / "both.ply")
    command = ["evaluate", triangle, "--truth", str(tmp_path / "both.ply"), "--samples", "1000"]
    assert main(command) == 0 and " 50.00%" in capsys.readouterr().out
    assert main([*command, "--leave-out", str(tmp_path / "far.ply")]) == 0
    assert " 50.00%" not in (said := capsys.readouterr().out) and said.count("100.00%") == 3


def test_evaluate_says_what_it_needs(triangle: str, capsys) -> None:
    for given, part in (
        ([], "Nothing to compare"),
        (["--scene", "x", "--picture", "a.png"], "compare with a true mesh"),
    ):
        assert main(["evaluate", triangle, *given]) == 2
        said = capsys.readouterr().err
        assert part in said and said.count("\n") == 1


def test_evaluate_gives_materials_and_evenness(tmp_path: Path, triangle: str, capsys) -> None:
    (tmp_path / "triangle_materials.json").write_text('["brick", "glass"]', encoding="utf-8")
    np.save(tmp_path / "triangle_materials.npy", np.array([1], np.int32))
    scene, figures = tmp_path / "scene", tmp_path / "figures.json"
    write_model(reconstruction(), scene / "sparse" / "0")
    assert main(["evaluate", triangle, "--truth", triangle, "--samples", "100", "--json", str(figures)]) == 0
    said = capsys.readouterr().out
    assert "glass" in said and "brick" not in said and "normals: median 0.0" in said and "plane" not in said
    assert json.loads(figures.read_text())["materials"]["glass"]["f1"] == [100.0]
    assert main(["evaluate", triangle, "--scene", str(scene), "--json", str(figures)]) == 0
    said = capsys.readouterr().out
    assert "  all 100.0%         0.000            0.0   0.0" in said and "accuracy" not in said
    (plane,) = json.loads(figures.read_text())["evenness"]["planes"]
    assert plane["share"] == 1.0 and plane["rms"] < 1e-6


def test_evaluate_measures_a_job_in_the_coordinates_of_its_photos(tmp_path: Path) -> None:
    """Its georeferenced mesh, a thousand times as large, is not in the units of the COLMAP model."""
    scene, job, figures = tmp_path / "scene", tmp_path / "job", tmp_path / "figures.json"
    write_model(reconstruction(), scene / "sparse" / "0")
    (job / "georeferenced").mkdir(parents=True)
    mesh = trimesh.creation.icosphere(subdivisions=2)
    mesh.export(job / "mesh.ply")
    mesh.apply_scale(1000).export(job / "georeferenced" / "mesh.ply")
    (job / "georeferenced" / "georef.json").write_text('{"offset": [0, 0, 0]}', encoding="utf-8")
    found = []
    for mesh_or_job in (job / "mesh.ply", job):
        assert main(["evaluate", str(mesh_or_job), "--scene", str(scene), "--json", str(figures)]) == 0
        found.append(json.loads(figures.read_text())["evenness"]["planes"])
    assert found[0] and found[0] == found[1]


def test_evaluate_writes_its_figures_where_no_folder_is_yet(tmp_path: Path, triangle: str) -> None:
    figures = tmp_path / "new" / "figures.json"
    assert main(["evaluate", triangle, "--truth", triangle, "--samples", "100", "--json", str(figures)]) == 0
    assert json.loads(figures.read_text())["f1"] == [100.0]


@pytest.mark.parametrize(
    ("error", "code", "part"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), 2, "The disk is full"),
        (OSError(errno.ENOSPC, "No space left on device", "/far/off/mesh.ply"), 2, "The disk of '/far/off' is full"),
        (PermissionError(errno.EACCES, "Permission denied", "x"), 2, "No permission for 'x'"),
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
    monkeypatch.setattr(cli, "__file__", str(tmp_path / "site-packages" / "mgf_engine" / "cli.py"))
    monkeypatch.chdir(tmp_path)
    assert main(["bench", "scenes", "--help"]) == 2
    assert "run 'mgf bench' from a checkout" in capsys.readouterr().err
    monkeypatch.chdir(Path(__file__).parents[1])
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


def test_options_are_data_for_other_programs() -> None:
    schema = json.loads(mgf("options", "--json").stdout)
    assert {o["name"] for o in schema["options"]} >= {"preset", "iterations", "use_masks"}


def test_doctor_names_versions_and_the_kernel_variant() -> None:
    run = mgf("doctor")
    assert run.returncode == 0, run.stdout
    assert "kernel variant" in run.stdout
    assert "Everything a job needs is here." in run.stdout


def test_doctor_lists_each_extra_and_how_to_get_it(tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.setattr(doctor, "_installed", lambda module: module not in ("ezdxf", "pxr", "snakemake"))
    assert main(["doctor", "--weights", str(tmp_path)]) == 0  # a job needs none of them
    said = " ".join(capsys.readouterr().out.split())
    pinned = f"pip install -c '{Path(__file__).parents[1] / 'constraints.txt'}'"  # the versions that were tested
    assert f"drawings, map coordinates need ezdxf: {pinned} 'mgf-engine[survey]'" in said
    assert f"mgf models, laser scans need usd-core: {pinned} 'mgf-engine[models]'" in said
    assert f"many buildings need snakemake: {pinned} 'mgf-engine[town]'" in said
    assert "LPIPS in reports not measured; 'mgf weights --model lpips-alex' fetches" in said
    monkeypatch.setattr(doctor, "_installed", lambda module: True)
    files = tuple(WeightFile(n, 3, hashlib.sha256(b"vgg").hexdigest()) for n in ("vgg16.pth", "vgg.pth"))
    monkeypatch.setitem(download.WEIGHTS, "lpips-vgg", files)
    for file in files:
        (tmp_path / file.name).write_bytes(b"vgg")
    assert main(["doctor", "--weights", str(tmp_path)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "map coordinates yes mgf models, laser scans yes many buildings yes LPIPS in reports VGG-16" in said
    (tmp_path / "vgg.pth").write_bytes(b"ggv")
    assert main(["doctor", "--weights", str(tmp_path)]) == 1
    assert "Problem: 'vgg.pth' is damaged" in " ".join(capsys.readouterr().out.split()).replace(f"{tmp_path}/", "")


def test_doctor_finds_the_pinned_versions_that_a_wheel_carries(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(doctor, "__file__", str(tmp_path / "mgf_engine" / "doctor.py"))
    assert doctor.install_command("scipy") == "pip install 'scipy'"
    carried = tmp_path / "mgf_engine" / "constraints.txt"
    carried.parent.mkdir()
    carried.write_text("scipy==1.17.1")
    assert doctor.install_command("scipy") == f"pip install -c '{carried}' 'scipy'"


@pytest.mark.parametrize("extra", ["survey", "models", "town"])
def test_doctor_knows_what_an_extra_brings(extra: str) -> None:
    project = tomllib.loads((Path(doctor.__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8"))
    wanted = project["project"]["optional-dependencies"][extra]
    assert list(doctor.EXTRAS[extra][1].values()) == [text.partition(";")[0].strip() for text in wanted]


def test_doctor_names_the_segmenter_and_how_to_get_the_other(tmp_path: Path, monkeypatch, capsys) -> None:
    assert main(["doctor", "--weights", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "random walker" in said and "'mgf weights' fetches" in said and "(41 MB, Apache-2.0)" in said
    files = tuple(WeightFile(n, 3, hashlib.sha256(b"onx").hexdigest()) for n in ("encoder.onnx", "decoder.onnx"))
    monkeypatch.setitem(download.WEIGHTS, "vitt", files)
    for file in files:
        (tmp_path / file.name).write_bytes(b"onx")
    assert main(["doctor", "--weights", str(tmp_path)]) == 0
    assert "EfficientSAM (vitt)" in capsys.readouterr().out
    (tmp_path / "decoder.onnx").write_bytes(b"xno")
    assert main(["doctor", "--weights", str(tmp_path)]) == 1
    said = capsys.readouterr().out
    assert "Problem: " in said and "decoder.onnx' is damaged" in said and "Everything" not in said


def test_help_lists_every_option() -> None:
    text = mgf("reconstruct", "--help").stdout
    for name in ("--max-gaussians", "--no-screening", "--cancel-on-eof", "--resume"):
        assert name in text


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
        listed = {flag for action in parser.arguments for flag in action.option_strings if flag.startswith("--")}
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
        (["town", "scene", "--out", "town", "--cores", "all"], "invalid int value: 'all'"),
        (
            ["rekonstruct"],
            "Error: There is no command 'rekonstruct'; did you mean reconstruct? 'mgf --help' lists all.",
        ),
        (["xyzzy"], "no command 'xyzzy'; 'mgf --help' lists all."),
    ],
)
def test_a_mistake_in_the_arguments_is_one_sentence(args, said, capsys) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(args)
    error = capsys.readouterr().err
    assert said in error and error.startswith("Error: ") and error.count("\n") == 1
