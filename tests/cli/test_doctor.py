# SPDX-License-Identifier: GPL-3.0-or-later
"""``mgf doctor``: versions, kernels, extras and the segmenter of this installation."""

import hashlib
import tomllib
from pathlib import Path

import pytest

from mgf_engine.cli import doctor
from mgf_engine.cli.main import main
from mgf_engine.weights import WEIGHTS, WeightFile


def test_doctor_names_versions_and_the_kernel_variant(capsys) -> None:
    code, said = main(["doctor"]), capsys.readouterr().out
    assert code == 0, said
    assert "kernel variant" in said
    assert "Everything a job needs is here." in said


def test_doctor_refuses_a_folder_of_weights_that_is_none(tmp_path: Path, capsys) -> None:
    assert main(["doctor", "--weights", str(tmp_path / "none")]) == 2
    assert "is not a folder; give the folder of the weights." in capsys.readouterr().err


def test_doctor_lists_each_extra_and_how_to_get_it(tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.setattr(doctor, "is_installed", lambda module: module not in ("ezdxf", "pxr", "snakemake"))
    assert main(["doctor", "--weights", str(tmp_path)]) == 0  # a job needs none of them
    said = " ".join(capsys.readouterr().out.split())
    pinned = f"pip install -c '{Path(__file__).parents[2] / 'constraints.txt'}'"  # the versions that were tested
    assert f"drawings, map coordinates need ezdxf: {pinned} 'mgf-engine[survey]'" in said
    assert f"mgf models, laser scans need usd-core: {pinned} 'mgf-engine[models]'" in said
    assert f"many buildings need snakemake: {pinned} 'mgf-engine[town]'" in said
    assert "LPIPS in reports not measured; 'mgf weights --model lpips-alex' fetches" in said
    monkeypatch.setattr(doctor, "is_installed", lambda module: True)
    files = tuple(WeightFile(n, 3, hashlib.sha256(b"vgg").hexdigest()) for n in ("vgg16.pth", "vgg.pth"))
    monkeypatch.setitem(WEIGHTS, "lpips-vgg", files)
    for file in files:
        (tmp_path / file.name).write_bytes(b"vgg")
    assert main(["doctor", "--weights", str(tmp_path)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "map coordinates yes mgf models, laser scans yes many buildings yes LPIPS in reports VGG-16" in said
    (tmp_path / "vgg.pth").write_bytes(b"ggv")
    assert main(["doctor", "--weights", str(tmp_path)]) == 1
    assert "Problem: 'vgg.pth' is damaged" in " ".join(capsys.readouterr().out.split()).replace(f"{tmp_path}/", "")


def test_doctor_finds_the_pinned_versions_that_a_wheel_carries(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(doctor, "__file__", str(tmp_path / "mgf_engine" / "cli" / "doctor.py"))
    assert doctor.install_command("scipy") == "pip install 'scipy'"
    carried = tmp_path / "mgf_engine" / "constraints.txt"
    carried.parent.mkdir()
    carried.write_text("scipy==1.17.1")
    assert doctor.install_command("scipy") == f"pip install -c '{carried}' 'scipy'"


@pytest.mark.parametrize("extra", ["survey", "models", "town"])
def test_doctor_knows_what_an_extra_brings(extra: str) -> None:
    project = tomllib.loads((Path(doctor.__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8"))
    wanted = project["project"]["optional-dependencies"][extra]
    assert list(doctor.EXTRAS[extra][1].values()) == [text.partition(";")[0].strip() for text in wanted]


def test_doctor_names_the_segmenter_and_how_to_get_the_other(tmp_path: Path, monkeypatch, capsys) -> None:
    assert main(["doctor", "--weights", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "random walker" in said and "'mgf weights' fetches" in said and "(41 MB, Apache-2.0)" in said
    files = tuple(WeightFile(n, 3, hashlib.sha256(b"onx").hexdigest()) for n in ("encoder.onnx", "decoder.onnx"))
    monkeypatch.setitem(WEIGHTS, "vitt", files)
    for file in files:
        (tmp_path / file.name).write_bytes(b"onx")
    assert main(["doctor", "--weights", str(tmp_path)]) == 0
    assert "EfficientSAM (vitt)" in capsys.readouterr().out
    (tmp_path / "decoder.onnx").write_bytes(b"xno")
    assert main(["doctor", "--weights", str(tmp_path)]) == 1
    said = capsys.readouterr().out
    assert "Problem: " in said and "decoder.onnx' is damaged" in said and "Everything" not in said
