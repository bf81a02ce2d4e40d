# SPDX-License-Identifier: GPL-3.0-or-later
"""A test double of the engine: speaks its message schema, obeys --cancel-on-eof and --resume, trains nothing.

The environment variable FAKE_ENGINE says how it behaves: ``ok``, ``slow``, ``stubborn`` (ignores requests to stop),
``silent`` (dies without a word), ``bad`` (bad input), ``full`` (disk full), ``noise`` (prints rubbish too).
"""

import json
import os
import shutil
import struct
import sys
import threading
import time
import zlib
from pathlib import Path

STAGES = [*json.loads((Path(__file__).parent / "options.json").read_text(encoding="utf-8"))["stages"]]
stop = threading.Event()


def send(type_: str, **fields: object) -> None:
    """One message."""
    print(json.dumps({"v": 1, "type": type_, "time": time.time(), **fields}), flush=True)


def watch() -> None:
    """Stop when standard input closes."""
    while sys.stdin.readline():
        pass
    stop.set()


def preview(arguments: list[str], mode: str) -> int:
    """A mask with the building in the left half."""
    out = Path(arguments[arguments.index("--out") + 1])
    prompts = json.loads(Path(arguments[arguments.index("--prompts") + 1]).read_text())
    if list(prompts) != [arguments[arguments.index("--image") + 1]]:
        print("Error: The prompts are of other photos.", file=sys.stderr)
        return 2
    if mode == "bad":
        print("Error: The scene has no photos; give another folder.", file=sys.stderr)
        return 2
    time.sleep(0.5 if mode == "slow" else 0.0)
    rows = (b"\0" + b"\xff" * 4 + b"\0" * 4) * 6
    chunks = [(b"IHDR", struct.pack(">IIBBBBB", 8, 6, 8, 0, 0, 0, 0)), (b"IDAT", zlib.compress(rows)), (b"IEND", b"")]
    body = b"".join(struct.pack(">I", len(d)) + t + d + struct.pack(">I", zlib.crc32(t + d)) for t, d in chunks)
    out.write_bytes(b"\x89PNG\r\n\x1a\n" + body)
    return 0


def picture(path: Path, width: int) -> None:
    """A grey PNG, 6 pixels high."""
    rows = (b"\0" + b"\x80" * width) * 6
    chunks = [
        (b"IHDR", struct.pack(">IIBBBBB", width, 6, 8, 0, 0, 0, 0)),
        (b"IDAT", zlib.compress(rows)),
        (b"IEND", b""),
    ]
    body = b"".join(struct.pack(">I", len(d)) + t + d + struct.pack(">I", zlib.crc32(t + d)) for t, d in chunks)
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + body)


def drawings(arguments: list[str], mode: str) -> int:
    """An orthophoto and a map of deviations of facade A."""
    job = Path(arguments[1])
    (job / "arguments.json").write_text(json.dumps(arguments))
    threading.Thread(target=watch, daemon=True).start()
    if mode == "bad":
        send("failed", code=2, text="The scene has no photos; give another folder.", log=None)
        return 2
    send("stage", stage="drawings", index=0, count=1, cached=False)
    for step in range(5):
        if mode == "silent":
            print("Segmentation fault in kernel", file=sys.stderr, flush=True)
            os._exit(77)
        if stop.is_set():
            send("failed", code=3, text="Cancelled; what was there before is unchanged.", log=None)
            return 3
        send("progress", stage="drawings", fraction=step / 4, overall=step / 4, figures={})
        time.sleep(0.06 if mode == "slow" else 0.0)
    out = job / "drawings"
    out.mkdir(exist_ok=True)
    files = {f"{kind}-A.png": {"kind": kind, "frame": "A"} for kind in ("deviation", "orthophoto")}
    for name in files:
        picture(out / name, int(os.environ.get("FAKE_SIZE", "8")))
    index = {"format": 1, "unit": "metre", "files": {**files, "drawings.html": {"kind": "page"}}}
    (out / "drawings.json").write_text(json.dumps(index))
    send("result", path=str(out), files={}, figures={"facades": 1})
    return 0


def models(arguments: list[str], mode: str) -> int:
    """The models that lie ready in a folder."""
    job = Path(arguments[1])
    (job / "arguments.json").write_text(json.dumps(arguments))
    if mode == "bad":
        text = "These models need ifcopenshell; install with: pip install 'mgf-engine[models]', in the engine's "
        send("failed", code=2, text=text + "environment, or leave them out with --only.", log=None)
        return 2
    send("stage", stage="models", index=0, count=1, cached=False)
    shutil.copytree(os.environ["FAKE_MODELS"], job / "models", dirs_exist_ok=True)
    send("result", path=str(job / "models"), files={}, figures={"CPU seconds": 6})
    return 0


def georef(arguments: list[str], mode: str) -> int:
    """Control points with places, or a georeference with residuals."""
    job = Path(arguments[1])
    (job / "arguments.json").write_text(json.dumps(arguments))
    if mode == "bad":
        send("failed", code=2, text="The control points lie on a line; add one beside it.", log=None)
        return 2
    send("stage", stage="georef", index=0, count=1, cached=False)
    if "--predict" in arguments:
        photos = {
            name: [100.0 + 10 * k, 80.0, 5.0] for k, name in enumerate(os.environ.get("FAKE_PHOTOS", "").split("|"))
        }
        points = [
            {"name": name, "role": role, "by": "marks", "pixels": 0.4, "wrong": [], "photos": photos}
            for name, role in (("P1", "control"), ("C1", "check"))
        ]
        places = Path(arguments[arguments.index("--predict") + 1])
        places.write_text(json.dumps({"format": 1, "crs": "", "points": points}))
    else:
        shutil.copyfile(os.environ["FAKE_GEOREF"], job / "georef.json")
        rows = [
            {"name": n, "role": r, "residual": e, "pixels": p, "photos": 3, "used": r == "control", "note": note}
            for n, r, e, p, note in (
                ("P1", "control", [0.003, -0.004, 0.0], 0.5, ""), ("C1", "check", [0.0, 0.0, 0.012], 0.7, ""),
                ("P9", "control", [None, None, None], None, "not marked in any photo"),
            )
        ]  # fmt: skip
        (job / "report.json").write_text(json.dumps({"georeference": {"points": rows}}))
    send("result", path=str(job), files={}, figures={"RMSE of check points": "12.0 mm"})
    return 0


def suggest(arguments: list[str], mode: str) -> int:
    """Two points on the building and one beside it, on every photo of FAKE_PHOTOS."""
    out = Path(arguments[arguments.index("--out") + 1])
    out.mkdir(parents=True, exist_ok=True)
    (out / "arguments.json").write_text(json.dumps(arguments))
    send("stage", stage="scene", index=0, count=1, cached=False)
    send("result", path=str(out), files={}, figures={"photos": 12})
    send("stage", stage="suggest", index=1, count=2, cached=False)
    if mode == "silent":
        os._exit(77)
    if mode == "bad":
        send("failed", code=2, text="Nothing in the sparse points stands on the ground like a building.", log=None)
        return 2
    entry = {"positive": [[100.0, 80.0], [110.0, 85.0]], "negative": [[20.0, 150.0]]}
    photos = os.environ.get("FAKE_PHOTOS", "").split("|")
    (out / "prompts.json").write_text(json.dumps(dict.fromkeys(photos, entry)))
    send("result", path=str(out), files={}, figures={"photos": len(photos)})
    return 0


def record(job: Path, arguments: list[str], done: list[str]) -> None:
    """The job file, with the stages that are done."""
    given = {a.split("=")[0]: a.split("=")[1] for a in arguments if "=" in a}
    stages = {name: {"key": name} for name in done}
    part = job / ".part-job.json"
    part.write_text(json.dumps({"source": arguments[1], "given": given, "stages": stages}))
    part.replace(job / "job.json")


def main() -> int:
    """Play one job."""
    arguments = sys.argv[1:]
    mode = os.environ.get("FAKE_ENGINE", "ok")
    if arguments == ["doctor", "--gpu"]:
        print("GPU: RTX 9000\n" + ("Problem: The GPU did not pass." if mode == "bad" else "The GPU passed in 9 s."))
        return int(mode == "bad")
    if arguments[0] == "doctor":
        print("mgf 9.9\n  torch     2.13.0\nEverything a job needs is here.")
        return 0
    if arguments[0] == "preview":
        return preview(arguments, mode)
    others = {"drawings": drawings, "models": models, "georef": georef, "suggest-clicks": suggest}
    if arguments[0] in others:
        return others[arguments[0]](arguments, mode)
    job = Path(arguments[arguments.index("--out") + 1])
    job.mkdir(parents=True, exist_ok=True)
    (job / "arguments.json").write_text(json.dumps(arguments))
    if "--cancel-on-eof" in arguments and mode != "stubborn":
        threading.Thread(target=watch, daemon=True).start()
    (job / "log.txt").write_text("log\n")
    record(job, arguments, [])
    if mode == "bad":
        send("failed", code=2, text="The scene has no photos; give another folder.", log=None)
        return 2
    if mode == "full":
        send(
            "failed",
            code=2,
            text=f"The disk of '{job}' is full; free some space and run again with --resume.",
            log=None,
        )
        return 2
    send("started", job=str(job), pid=os.getpid(), version="9.9", stages=STAGES)
    send("warning", text="Two photos are blurred; they count less.")
    for i, stage in enumerate(STAGES):
        send("stage", stage=stage, index=i, count=5, cached=mode == "cached")
        (job / f".started-{stage}").touch()
        for step in range(5):
            if mode == "noise":
                print('{"type": 5}\n{broken\n\x00\xff', flush=True)
            if mode == "silent" and stage == "field":
                print("Segmentation fault in kernel", file=sys.stderr, flush=True)
                os._exit(77)
            if stop.is_set():
                send("failed", code=3, text="Cancelled; run again with --resume to continue.", log=None)
                return 3
            send(
                "progress",
                stage=stage,
                fraction=step / 4,
                overall=(i + step / 4) / 5,
                seconds_left=12.0,
                job_seconds_left=20.0,
                figures={"psnr": 20 + i},
            )
            if stage == "field" and step == 2 and os.environ.get("FAKE_PREVIEW"):
                send("preview", stage=stage, path=os.environ["FAKE_PREVIEW"], title="Iteration 1")
            time.sleep(0.06 if mode in ("slow", "stubborn") else 0.002)
        record(job, arguments, STAGES[: i + 1])
    model = os.environ.get("FAKE_MODEL")
    if model and arguments[0] == "scene":
        shutil.copytree(model, job / "scene" / "sfm" / "model", dirs_exist_ok=True)
    finished = os.environ.get("FAKE_RESULT")
    if finished and arguments[0] == "reconstruct":
        shutil.copytree(finished, job, dirs_exist_ok=True)
    speed = None if mode == "cached" else 1.25
    send("result", path=str(job), files={}, figures={"psnr": 27.5}, speed=speed)
    return 0


if __name__ == "__main__":
    sys.exit(main())
