# SPDX-License-Identifier: GPL-3.0-or-later
"""What happens to people's work when things go wrong: ``python -m benchmarks.stability_faults --kills 50``.

A small job is killed at random moments until it has died often enough, its disk is full at every file it writes, its
memory is limited, its checkpoint damaged, its photos deleted, the clock set. Each time it must end with one sentence,
resume, and give the very mesh that an undisturbed run gives. Prints one line per fault and exits with 1 when any fails.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from benchmarks.stability_jobs import ENVIRONMENT, check_whole, command, finish, result, start_args
from benchmarks.synthetic.house import House, build_house
from mgf_engine.jobs.job_folder import read_job

# ---- kills ---------------------------------------------------------------------------------------------------------


def kill_at_random(house: House, work: Path, expected: dict[str, str], kills: int, seconds: float, seed: int) -> str:
    """Kill jobs after random times until ``kills`` have died; every job is resumed to its end in between.

    Args:
        seconds: what an undisturbed run takes; kills fall between the start and half of that.
    """
    rng, died, jobs = random.Random(seed), 0, 0
    stages: dict[str, int] = {}
    while died < kills:
        job = work / f"killed-{jobs}"
        jobs += 1
        limit = rng.randint(6, 12)  # then the job may end
        for _ in range(limit):
            wait = rng.uniform(0.02, 0.5) * seconds
            stage, code = kill_after(house, job, wait)
            if code == 0:
                break
            died += 1
            stages[stage] = stages.get(stage, 0) + 1
            if (job / "job.json").exists():
                read_job(job)
        code, message, errors = finish(house, job)
        assert code == 0, (message, errors)
        check_whole(job, expected)
        shutil.rmtree(job)
        print(f"  {died} kills, {jobs} jobs whole, by stage {stages}", flush=True)
    return f"{died} kills at random moments ({stages}), {jobs} jobs resumed to the very same mesh"


def kill_after(house: House, job: Path, wait: float) -> tuple[str, int]:
    """Start or resume a job and kill it after ``wait`` seconds; the stage it was in, and its exit code (-9: killed)."""
    output = job.with_name(job.name + ".out")
    with output.open("w") as stream:
        run = subprocess.Popen(
            command(*start_args(house, job)), stdout=stream, stderr=subprocess.DEVNULL, env=ENVIRONMENT
        )
        try:
            run.wait(wait)
        except subprocess.TimeoutExpired:
            run.kill()
            run.wait()
    messages = [json.loads(line) for line in output.read_text().splitlines() if line.endswith("}")]
    assert run.returncode in (0, -9), messages[-1:]
    names = [m["stage"] for m in messages if m["type"] == "stage" and not m["cached"]]
    return names[-1] if names else "start", run.returncode


# ---- a full disk ---------------------------------------------------------------------------------------------------


def full_at_every_file(house: House, work: Path, expected: dict[str, str]) -> str:
    """No space at the first, second, ... file that the job writes, each once; resumed after each."""
    job, record = work / "full", work / "failed.json"
    run = subprocess.run([sys.executable, "-m", "benchmarks.full_disk", str(record), *map(str, start_args(house, job))],
                         capture_output=True, text=True, env=ENVIRONMENT, timeout=3600)  # fmt: skip
    assert run.returncode == 0, run.stdout[-2000:] + run.stderr[-2000:]
    check_whole(job, expected)
    return f"{len(json.loads(record.read_text()))} files, each with no space once: one sentence, resumed, same mesh"


def file_size_limits(house: House, work: Path, expected: dict[str, str]) -> str:
    """Writes beyond a size fail in the kernel (ulimit -f), in Python and in C alike."""
    import resource

    said = []
    for limit in (0, 1 << 10, 20 << 10, 200 << 10):
        job = work / f"limit-{limit}"

        def preexec(limit: int = limit) -> None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

        code, message, errors = finish(house, job, preexec_fn=preexec)
        assert code == 2 and "Traceback" not in errors, (code, message, errors)
        said.append(limit)
        code, message, errors = finish(house, job)
        assert code == 0, (message, errors)
        check_whole(job, expected)
        shutil.rmtree(job)
    return f"writes beyond {said} bytes refused by the system: one sentence, resumed, same mesh"


# ---- memory, checkpoint, photos, clock, two processes --------------------------------------------------------------


def memory_limits(house: House, work: Path, expected: dict[str, str]) -> str:
    """Address space limits from too little to start with to nearly enough (ulimit -v)."""
    import resource

    ends = {}
    for megabytes in (600, 1000, 1400, 1800, 2200, 2600, 3000):
        job = work / f"memory-{megabytes}"

        def preexec(size: int = megabytes << 20) -> None:
            resource.setrlimit(resource.RLIMIT_AS, (size, size))

        code, message, errors = finish(house, job, preexec_fn=preexec)
        ends[megabytes] = code
        print(
            f"  {megabytes} MB: exit code {code}: {message.get('text', message.get('type'))} {errors[-300:]}",
            flush=True,
        )
        assert code in (0, 2), (megabytes, code, message, errors[-1000:])
        if job.exists():
            code, message, errors = finish(house, job)
            assert code == 0, (message, errors)
            check_whole(job, expected)
            shutil.rmtree(job)
    return f"exit codes by megabytes {ends}; resumed without the limit: same mesh"


def damaged_checkpoints(house: House, work: Path, expected: dict[str, str]) -> str:
    """Checkpoints cut off, overwritten and empty."""
    job = work / "checkpoint"
    until_field(house, job)
    path = job / "checkpoints/training.npz"
    sound = path.read_bytes()
    damages = {"empty": b"", "cut": sound[: len(sound) // 2], "noise": os.urandom(2000),
               "flipped": sound[:5000] + bytes([sound[5000] ^ 255]) + sound[5001:]}  # fmt: skip
    for name, data in damages.items():
        other = work / f"checkpoint-{name}"
        shutil.copytree(job, other)
        (other / "checkpoints/training.npz").write_bytes(data)
        code, message, errors = finish(house, other)
        assert code == 0, (message, errors)
        warnings = read_job(other)["stages"]["field"]["warnings"]
        assert any("checkpoint" in text for text in warnings), warnings
        check_whole(other, expected)
        shutil.rmtree(other)
    return f"checkpoints {', '.join(damages)}: training starts over with a warning, same mesh"


def until_field(house: House, job: Path) -> None:
    """Run a job into its field stage and kill it once a checkpoint is there."""
    run = subprocess.Popen(command(*start_args(house, job)), stdout=subprocess.DEVNULL, env=ENVIRONMENT)
    while not (job / "checkpoints/training.npz").exists():
        assert run.poll() is None, "the job ended without a checkpoint"
        time.sleep(0.02)
    run.kill()
    run.wait()


def deleted_photos(house: House, work: Path, expected: dict[str, str]) -> str:
    """A photo deleted while the field is trained: the job ends well; the next run leaves the photo out."""
    copy = House(work / "deleted-source", house.mesh, house.masks)
    shutil.copytree(house.folder, copy.folder)
    job = work / "deleted"
    run = subprocess.Popen(command(*start_args(copy, job)), stdout=subprocess.PIPE, text=True, env=ENVIRONMENT)
    assert run.stdout is not None
    trained = 0
    for line in run.stdout:
        message = json.loads(line)
        trained += message["type"] == "progress" and message["stage"] == "field"
        if message["type"] == "progress" and message["stage"] == "field" and trained == 1:  # its inputs are on record
            (copy.folder / "images/photo_02.png").unlink()
    assert trained > 1, "the photo was deleted when the field was done already"
    assert run.wait() == 0
    check_whole(job, expected)
    code, message, _ = finish(copy, job)
    assert code == 0, message
    assert "('photo_02.png')" in " ".join(json.loads((job / "report.json").read_text())["warnings"])
    shutil.copy2(house.folder / "images/photo_02.png", copy.folder / "images/photo_02.png")
    code, message, _ = finish(copy, job)
    assert code == 0, message
    check_whole(job, expected)
    return "a photo deleted mid-run: the run ends well, the next one leaves it out and says so, until it is back"


def set_clock(house: House, work: Path, expected: dict[str, str]) -> str:
    """The clock jumps by years to and fro while the job runs, and the photos are from the future."""
    job = work / "clock"
    code = (
        "import itertools, sys, time; real = time.time; n = itertools.count();"
        "time.time = lambda: real() + (1e9 if next(n) % 2 else -1e9);"
        "from mgf_engine.cli.main import main; sys.exit(main(sys.argv[1:]))"
    )
    for photo in (house.folder / "images").iterdir():
        os.utime(photo, (4e9, 4e9))
    arguments = [sys.executable, "-c", code, *map(str, start_args(house, job))]
    run = subprocess.run(arguments, capture_output=True, text=True, env=ENVIRONMENT)
    assert run.returncode == 0, run.stderr
    check_whole(job, expected)
    return "the clock jumps by 60 years to and fro, photos from the year 2096: same mesh"


def two_processes(house: House, work: Path, expected: dict[str, str]) -> str:
    """A second process on a folder in use is turned away and the first one ends undisturbed."""
    job = work / "two"
    first = subprocess.Popen(command(*start_args(house, job)), stdout=subprocess.DEVNULL, env=ENVIRONMENT)
    while not (job / "job.json").exists():
        time.sleep(0.05)
    first.send_signal(signal.SIGSTOP)  # else it may end, on a busy machine, before the others have started
    try:
        turned = [finish(house, job) for _ in range(3)]
    finally:
        first.send_signal(signal.SIGCONT)
    assert all(code == 2 and "in use" in message["text"] for code, message, _ in turned), turned
    assert first.wait() == 0
    check_whole(job, expected)
    return "a second process is turned away with one sentence, the first ends undisturbed"


def old_versions(house: House, work: Path, expected: dict[str, str]) -> str:
    """Job folders of other versions are refused and left as they are."""
    job = work / "old"
    code, _, _ = finish(house, job)
    assert code == 0
    sound = json.loads((job / "job.json").read_text())
    changes: dict[str, Callable[[dict], object]] = {
        "older": lambda d: d.update(format=0),
        "newer": lambda d: d.update(format=99),
        "an option that is gone": lambda d: d["given"].update(no_such_option=3),
        "a stage that is gone": lambda d: d["stages"].update(polish=d["stages"]["mesh"]),
        "no stages": lambda d: d.pop("stages"),
    }
    for change in changes.values():
        data = json.loads(json.dumps(sound))
        change(data)
        (job / "job.json").write_text(json.dumps(data))
        code, message, errors = finish(house, job)
        assert code == 2 and "Traceback" not in errors, (message, errors)
        check_whole(job, expected)
    return f"job files of other versions ({', '.join(changes)}): refused with one sentence, nothing touched"


FAULTS: dict[str, Callable[[House, Path, dict[str, str]], str]] = {
    "full-disk": full_at_every_file,
    "file-size": file_size_limits,
    "memory": memory_limits,
    "checkpoint": damaged_checkpoints,
    "photos": deleted_photos,
    "clock": set_clock,
    "two": two_processes,
    "versions": old_versions,
}


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.stability_faults", description="Disturb a small job in every way."
    )
    parser.add_argument("--kills", type=int, default=50, help="how often jobs are killed at random moments")
    parser.add_argument("--only", nargs="+", choices=[*FAULTS, "kills"], default=["kills", *FAULTS])
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    failed = 0
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        house = build_house(work / "house")
        started = time.monotonic()
        code, message, errors = finish(house, work / "undisturbed")
        assert code == 0, (message, errors)
        seconds, expected = time.monotonic() - started, result(work / "undisturbed")
        print(f"undisturbed: {seconds:.0f} s", flush=True)
        for name in args.only:
            try:
                if name == "kills":
                    text = kill_at_random(house, work, expected, args.kills, seconds, args.seed)
                else:
                    text = FAULTS[name](house, work, expected)
            except AssertionError as error:
                failed += 1
                text = f"FAILED: {error}"
            print(f"{name}: {text}", flush=True)
    print(f"{len(args.only) - failed} passed, {failed} failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
