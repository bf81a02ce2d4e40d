# SPDX-License-Identifier: GPL-3.0-or-later
"""One table of stages: all that speaks of stages is made from it, so that a sixth one is one entry."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from mgf_engine.options.config import option_fields
from mgf_engine.stages import STAGE_NAMES, STAGES, outputs, stage_named, stage_of_section

ROOT = Path(__file__).resolve().parents[1]
#: A stage that weighs the mesh, put between mesh and deliver before anything else is imported.
SIXTH = """
import sys
from mgf_engine import stages
from mgf_engine.stages import Output, Stage

weigh = Stage(
    name="weigh", help="weigh the building", progress="Weighing the building", share=0.0, run="weighing:weigh",
    sections={"weighing": "Weighing"}, options=("seed",), reads=("mesh",), user_facing=True,
    outputs=(Output("weight.txt", "weight", required=True, kept=True, manifest="weight"),),
    cost={"cpu": {"": 7.0}, "serial": 1.0, "bytes": {"": 1e9}},
)
table = list(stages.STAGES)
table.insert(4, weigh)
source = open(stages.__file__).read()
stages.STAGES = tuple(table)
exec(compile(source[source.index("STAGE_NAMES ="):], stages.__file__, "exec"), stages.__dict__)
"""
JOB = """
import types
from pathlib import Path

def weigh(job, reporter):
    job.path("weight.txt").write_text("1200 t")
    return {"tonnes": 1200, "curve": [7777]}

sys.modules["weighing"] = types.ModuleType("weighing")
sys.modules["weighing"].weigh = weigh

import json
import logging
from mgf_engine import costs, messages, pipeline
from mgf_engine.options import config
from mgf_engine.jobs import estimate
from mgf_engine.jobs import job
from mgf_engine.jobs import results
from mgf_engine.jobs import runs
from mgf_engine.export import report, stage

source = Path(sys.argv[1])
(source / "images").mkdir(parents=True)
for name in "abc":
    (source / "images" / f"{name}.jpg").write_bytes(b"x")
sent = []
with job.Job.start(source / "job", source) as work:
    keys = work.keys
    reporter = messages.Reporter(sent.append)
    reporter.stages = pipeline.STAGE_NAMES
    for name in ("scene", "masks", "field", "mesh"):
        work.finish(name, keys[name], 1.0, 1.0, 1, {}, [])
    work.path("mesh.ply").write_bytes(b"ply")
    reporter.stage("weigh")
    log, heard = logging.getLogger("mgf"), logging.Handler()
    lines = []
    heard.emit = lambda record: lines.append(record.getMessage())
    log.addHandler(heard)
    log.setLevel(logging.INFO)
    pipeline._run_stage(work, "weigh", reporter)
    files, done = pipeline.result_files(work), work.done("weigh")
    linked = report._files(work)
    figures = work.stages["weigh"]["figures"]
    work.path("weight.txt").unlink()
    lost = work.missing_results("weigh")
with job.Job.start(source / "job", user_options={"seed": 5}, resume=True) as work:
    kept_key = work.keys["weigh"] == keys["weigh"]
photos = estimate.PhotoSummary(10, (400, 300))
print(json.dumps({
    "names": list(pipeline.STAGE_NAMES), "files": files, "done": done, "figures": figures, "lost": sorted(lost),
    "kept_key": kept_key, "log": lines, "linked": linked,
    "share": messages.STAGE_SHARE["weigh"], "index": [m["index"] for m in sent if m["type"] == "stage"],
    "schema": config.options_schema()["stages"], "sections": config.options_schema()["sections"],
    "seconds": estimate.estimate(config.make_config(), photos, speed=1.0).seconds["weigh"],
    "costs": costs.COSTS["stages"]["weigh"]["bytes"], "manifest": runs._FILES, "kept": stage._RESULT,
}))
"""


def run(code: str, *arguments: object) -> str:
    command = [sys.executable, "-c", code, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def told(tmp_path_factory) -> dict:
    return json.loads(run(SIXTH + JOB, tmp_path_factory.mktemp("sixth") / "scene"))


def test_a_sixth_stage_runs_and_is_recorded(told: dict) -> None:
    assert told["names"] == ["scene", "masks", "field", "mesh", "weigh", "deliver"]
    assert told["done"] and told["figures"] == {"tonnes": 1200, "curve": [7777]}
    assert told["lost"] == ["weigh"] and not told["kept_key"]  # its result is missed; its options count


def test_the_log_has_the_figures_of_a_stage_but_no_curves(told: dict) -> None:
    assert "'tonnes': 1200" in told["log"][-1] and "7777" not in told["log"][-1]


def test_a_sixth_stage_is_in_messages_and_estimates(told: dict) -> None:
    assert told["index"] == [4] and told["share"] == 0.0
    assert told["seconds"] == pytest.approx(7.0) and told["costs"] == {"": 1e9}


def test_a_sixth_stage_is_in_results_report_and_manifest(told: dict) -> None:
    assert told["files"]["weight"].endswith("weight.txt") and told["linked"]["weight"] == "weight.txt"
    assert "weight" in told["manifest"] and "weight.txt" in told["kept"]


def test_a_sixth_stage_reaches_the_add_on(told: dict) -> None:
    assert list(told["schema"].items())[4] == ("weigh", "Weighing the building")
    assert told["sections"]["weighing"] == "Weighing"


def test_a_sixth_stage_is_a_command(tmp_path: Path) -> None:
    text = run(SIXTH + "from mgf_engine.cli.main import main\nmain(['--help'])")
    assert "weigh the building" in " ".join(text.split())


def test_a_sixth_stage_is_in_the_benchmarks() -> None:
    code = "from benchmarks import charts, stage_cache\nprint(charts.STAGE_COLORS, stage_cache.KEPT, stage_cache._LATE)"
    colors, kept = run(SIXTH + code).split(") {")[0].split("} (")
    assert "'weigh': '#" in colors and "weigh" not in kept


def test_every_stage_says_what_it_reads_and_writes() -> None:
    for place, stage in enumerate(STAGES):
        assert set(stage.reads) <= set(STAGE_NAMES[:place]) and stage.required_outputs
        assert stage.runner().__doc__
        assert {*stage.optional_outputs, *stage.options} <= {f.name for f in option_fields()}
        assert stage_named(stage.name) is stage
    assert stage_of_section("georef").name == "deliver"
    for names in ([o.path for o in outputs()], [o.name for o in outputs() if o.name]):
        assert len(names) == len(set(names))


def test_what_lies_in_a_folder_is_removed_with_it() -> None:
    assert stage_named("field").output_paths == ("checkpoints", "blocks/start", "field.ply")
    assert stage_named("field").required_outputs == ("checkpoints/field.npz",)
