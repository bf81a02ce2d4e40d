# SPDX-License-Identifier: GPL-3.0-or-later
import hashlib
import sys
import threading
from collections.abc import Iterator
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest
from support.live_terminal import bar_ended, live_terminal

from mgf_engine.cli.main import main
from mgf_engine.errors import BadInput
from mgf_engine.messages import Message, Reporter
from mgf_engine.weights import WEIGHTS, WeightFile, download_weights, find_weights

CONTENT = {
    name: np.random.default_rng(i).bytes(3_000_000 + i) for i, name in enumerate(("encoder.onnx", "decoder.onnx"))
}


class Server(ThreadingHTTPServer):
    """Serves CONTENT; can break off, ignore ranges and damage files. Remembers what was asked."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.asked: list[tuple[str, str | None]] = []
        self.break_after: int | None = None
        self.ranges, self.damage = True, False

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_port}"


class Handler(BaseHTTPRequestHandler):
    server: Server

    def do_GET(self) -> None:
        name, wanted = self.path.lstrip("/"), self.headers.get("Range")
        self.server.asked.append((name, wanted))
        if name not in CONTENT:
            self.send_error(404)
            return
        data = CONTENT[name]
        start = int(wanted.split("=")[1].rstrip("-")) if wanted and self.server.ranges else 0
        self.send_response(206 if start else 200)
        body = data[start:]
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        if self.server.damage:
            body = b"x" + body[1:]
        self.wfile.write(body[: self.server.break_after])

    def log_message(self, *args: object) -> None:
        pass


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[Server]:
    files = tuple(WeightFile(n, len(d), hashlib.sha256(d).hexdigest()) for n, d in CONTENT.items())
    monkeypatch.setitem(WEIGHTS, "vitt", files)
    server = Server()
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield server
    server.shutdown()
    server.server_close()


def reporter(messages: list[Message] | None = None) -> Reporter:
    result = Reporter(*([messages.append] if messages is not None else []), min_interval=0)
    result.stage("masks")
    return result


def test_fetches_checks_and_reports(server: Server, tmp_path: Path):
    messages: list[Message] = []
    folder = download_weights("vitt", tmp_path / "weights", reporter(messages), server.url)
    for name, data in CONTENT.items():
        assert (folder / name).read_bytes() == data
    fractions = [m["fraction"] for m in messages if m["type"] == "progress"]
    assert fractions == sorted(fractions) and fractions[-1] == 1.0 and len(fractions) > 4
    assert find_weights(folder) == ("vitt", folder / "encoder.onnx", folder / "decoder.onnx")
    server.asked.clear()
    download_weights("vitt", folder, reporter(), server.url)
    assert server.asked == []


def test_goes_on_where_it_stopped(server: Server, tmp_path: Path):
    server.break_after = 1_200_000
    with pytest.raises(BadInput, match=r"Cannot download encoder.onnx .*run again"):
        download_weights("vitt", tmp_path, reporter(), server.url)
    assert not (tmp_path / "encoder.onnx").exists()
    have = (tmp_path / "encoder.part").stat().st_size
    assert 0 < have <= 1_200_000
    server.break_after = None
    download_weights("vitt", tmp_path, reporter(), server.url)
    assert ("encoder.onnx", f"bytes={have}-") in server.asked
    assert (tmp_path / "encoder.onnx").read_bytes() == CONTENT["encoder.onnx"]


def test_server_without_ranges(server: Server, tmp_path: Path):
    (tmp_path / "encoder.part").write_bytes(b"some old bytes")
    server.ranges = False
    download_weights("vitt", tmp_path, reporter(), server.url)
    assert (tmp_path / "encoder.onnx").read_bytes() == CONTENT["encoder.onnx"]


def test_damaged_download_is_refused_and_removed(server: Server, tmp_path: Path):
    server.damage = True
    with pytest.raises(BadInput, match="wrong SHA-256"):
        download_weights("vitt", tmp_path, reporter(), server.url)
    assert list(tmp_path.iterdir()) == []


def test_no_network_missing_file_unknown_model_unwritable_folder(server: Server, tmp_path: Path):
    with pytest.raises(BadInput, match="check the network"):
        download_weights("vitt", tmp_path, reporter(), "http://127.0.0.1:9")
    with pytest.raises(BadInput, match="Not Found"):
        download_weights("vitt", tmp_path, reporter(), server.url + "/nowhere")
    with pytest.raises(BadInput, match="no weights called 'vith'"):
        download_weights("vith", tmp_path, reporter(), server.url)
    blocked = tmp_path / "file"
    blocked.write_text("")
    with pytest.raises(BadInput, match="Cannot write"):
        download_weights("vitt", blocked, reporter(), server.url)


def test_damaged_files_in_the_folder(server: Server, tmp_path: Path):
    assert find_weights(tmp_path) is None
    (tmp_path / "encoder.onnx").write_bytes(CONTENT["encoder.onnx"])
    assert find_weights(tmp_path) is None
    (tmp_path / "decoder.onnx").write_bytes(CONTENT["decoder.onnx"][:-1])
    with pytest.raises(BadInput, match="wrong size or SHA-256"):
        find_weights(tmp_path)


def test_published_checksums_are_whole():
    for files in (WEIGHTS["vitt"], WEIGHTS["vits"]):
        for file in files:
            assert len(file.sha256) == 64 and int(file.sha256, 16) and file.size > 1e7


@pytest.fixture
def stick(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A folder that holds the two files, the decoder under a name of its own."""
    files = tuple(WeightFile(n, len(d), hashlib.sha256(d).hexdigest()) for n, d in CONTENT.items())
    monkeypatch.setitem(WEIGHTS, "vitt", files)
    folder = tmp_path / "stick"
    folder.mkdir()
    (folder / "encoder.onnx").write_bytes(CONTENT["encoder.onnx"])
    (folder / "decoder (1).onnx").write_bytes(CONTENT["decoder.onnx"])
    (folder / "photo.jpg").write_bytes(b"else")
    return folder


def test_files_from_a_stick_are_known_by_their_checksum(stick: Path, tmp_path: Path, capsys: pytest.CaptureFixture):
    target = tmp_path / "a" / "weights"
    assert main(["weights", "--from", str(stick), "--folder", str(target)]) == 0
    assert str(target) in capsys.readouterr().out
    found = find_weights(target)
    assert found is not None and found[0] == "vitt"
    assert sorted(p.name for p in target.iterdir()) == sorted(CONTENT)
    assert main(["weights", "--from", str(target), "--folder", str(target)]) == 0  # where they are already


def test_a_stick_with_damaged_or_no_files_is_refused_and_nothing_written(
    stick: Path, tmp_path: Path, capsys: pytest.CaptureFixture
):
    target = tmp_path / "weights"
    with (stick / "encoder.onnx").open("r+b") as file:
        file.write(b"x")
    for folder, words in ((stick, "does not hold"), (tmp_path / "nowhere", "is not a folder")):
        assert main(["weights", "--from", str(folder), "--folder", str(target)]) == 2
        said = capsys.readouterr().err
        assert words in said and said.count("\n") == 1 and not target.exists()
    assert main(["weights", "--from", str(stick), "--model", "vits", "--folder", str(target)]) == 2
    said = capsys.readouterr().err
    assert "vits" in said and "vitt" not in said


def test_the_command_ends_its_bar(server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys):
    files = [replace(file, place=server.url) for file in WEIGHTS["vitt"]]
    monkeypatch.setitem(WEIGHTS, "vitt", tuple(files))
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    live_terminal(monkeypatch)
    assert main(["weights", "--folder", str(tmp_path)]) == 0
    said = capsys.readouterr()
    assert bar_ended(said.err) and said.out == f"Weights are in {tmp_path}\n"
    (tmp_path / "encoder.onnx").unlink()
    server.damage = True
    assert main(["weights", "--folder", str(tmp_path)]) == 2
    said = capsys.readouterr()
    assert bar_ended(said.err) and "arrived damaged" in said.err
