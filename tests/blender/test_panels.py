# SPDX-License-Identifier: GPL-3.0-or-later
"""What the panels say from the empty scene to the finished mesh, and when something is wrong."""

from __future__ import annotations

import json
import time
import venv
from pathlib import Path
from types import SimpleNamespace

import bpy
import pytest
from conftest import REPO
from layouts import draw

from mgf_blender import preferences
from mgf_blender.common import runner
from mgf_blender.common import text as panel_text
from mgf_blender.common.job import DONE, FAILED
from mgf_blender.engine import current_task
from mgf_blender.engine.task import Step, Task
from mgf_blender.jobs import status_label
from mgf_blender.jobs.engine_messages import in_panel_terms
from mgf_blender.jobs.start import job_options
from mgf_blender.preferences import MGF_Preferences
from mgf_blender.prompts import files
from mgf_blender.prompts.panel import MGF_PT_masks, MGF_PT_prompts
from mgf_blender.reconstruct.panel import MGF_PT_mark, MGF_PT_options, MGF_PT_reconstruct
from mgf_blender.reconstruct.start import make_job
from mgf_blender.results import async_import
from mgf_blender.results.panel import MGF_PT_results
from mgf_blender.scene_import.panel import MGF_PT_placement, MGF_PT_scene, MGF_PT_source

VIEWPORT = (MGF_PT_scene, MGF_PT_placement, MGF_PT_source, MGF_PT_mark, MGF_PT_reconstruct, MGF_PT_options,
            MGF_PT_results)  # fmt: skip


@pytest.fixture
def marked(addon, house):
    """The house is imported and one click is on it: a job may begin, in a folder of its own."""
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    addon.job_folder = str(house.folder.parent / "new job")
    files.add_click(addon.photos[0], 9, 9, False, "building")


def all_panels() -> str:
    """Everything both editors say now."""
    return "\n".join(draw(cls).said for cls in (*VIEWPORT, MGF_PT_prompts, MGF_PT_masks))


def test_empty_scene_shows_the_ways_in(addon, engine):
    assert draw(MGF_PT_scene).said == "Import Photos\nImport COLMAP Scene\nImport Result"
    assert [draw(cls).said for cls in VIEWPORT[1:5]] == [""] * 4
    assert "Import a scene in the 3D viewport first" in draw(MGF_PT_prompts).said


def test_the_scene_panel_shows_the_search_for_cameras(addon, engine, house):
    """Its bar stood at the end of Reconstruct, below all options, and nothing else could be done there meanwhile."""
    engine("slow")
    addon.source, addon.job_folder = str(house.folder / "images"), str(house.folder.parent / "new job")
    runner.submit(make_job(bpy.context.scene, "scene"))
    drawn = draw(MGF_PT_scene)
    assert "mgf.cancel_job" in [name for name, *_ in drawn.operators] and "Import" not in drawn.said
    assert draw(MGF_PT_reconstruct).said == ""
    bpy.ops.mgf.cancel_job()
    while runner.pump():
        time.sleep(0.01)
    assert "Import Photos" in draw(MGF_PT_scene).said
    assert "Cancelled" in draw(MGF_PT_reconstruct).said


def test_missing_engine_is_said_before_anything_is_imported(addon, monkeypatch, house):
    monkeypatch.delenv("MGF_ENGINE_PYTHON", raising=False)
    for _ in range(2):
        said = " ".join(all_panels().split())
        assert "The engine is not installed; press Install Engine" in said and "Set Up Engine" in said
        assert "Reconstruct Building" not in said
        bpy.ops.mgf.import_colmap(filepath=str(house.folder))


def test_from_import_to_mesh(addon, engine, house):
    engine("ok", FAKE_RESULT=house.job)
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    addon.job_folder = str(house.folder.parent / "new job")
    said = all_panels()
    assert "12 cameras" in said and "0 of 3 photos marked" in said and "Mark Building" in said
    assert "About " in said and " GB of memory" in said
    files.add_click(addon.photos[0], 9, 9, False, "building")
    files.add_click(addon.photos[0], 90, 9, True, "building")
    files.add_click(addon.photos[0], 90, 90, False, "door")
    said = all_panels()
    assert "1 of 3 photos marked" in said and "1 on it, 1 off it, 1 on parts" in said
    bpy.ops.mgf.reconstruct()
    said = all_panels()
    assert "Mesh finished in " in said and "Open Report" in said and "new job: 16 faces" in said and "PSNR" in said
    assert "Open Log" in said and "mgf.open_job_file" in [name for name, *_ in draw(MGF_PT_results).operators]


def test_memory_is_limited_by_a_tick(addon, engine, house):
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    addon.options.property_unset("memory")
    assert "Memory (GB)" in draw(MGF_PT_reconstruct).said and not addon.limit_memory
    addon.limit_memory = True
    assert addon.options.memory == 8.0
    addon.options.memory = 3.0
    assert addon.limit_memory and "memory=3.0" in " ".join(job_options(bpy.context.scene, house.folder / "job"))
    addon.limit_memory = False
    assert addon.options.memory == 0 and "memory" not in " ".join(job_options(bpy.context.scene, house.folder / "job"))


def test_options_for_experiments_are_shown_to_developers_and_where_a_job_set_them(addon, engine, house):
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    view = bpy.context.preferences.view
    assert not view.show_developer_ui
    shown = draw(MGF_PT_options).props
    assert "max_gaussians" in shown and "texture_size" in shown and "resolution" not in shown
    assert "smoothing" not in shown and len(shown) < 25
    addon.options.smoothing += 1
    assert "smoothing" in draw(MGF_PT_options).props
    addon.options.property_unset("smoothing")
    view.show_developer_ui = True
    try:
        assert {"smoothing", "max_gaussians", "densify_from"} <= set(draw(MGF_PT_options).props)
    finally:
        view.show_developer_ui = False


def test_running_waiting_and_cancelled(addon, engine, house, marked):
    engine("slow")
    runner.submit(make_job(bpy.context.scene))
    # Drawn before there is a log, the button would be grey under the pointer and stay so until the pointer moves.
    assert "Open Log" not in draw(MGF_PT_reconstruct).said
    assert "mgf.open_job_file" not in [name for name, *_ in draw(MGF_PT_results).operators]
    assert "Waiting" in draw(MGF_PT_reconstruct).said or "Starting" in draw(MGF_PT_reconstruct).said
    end = time.monotonic() + 20
    while "Reading photos, " not in draw(MGF_PT_reconstruct).said and time.monotonic() < end:
        runner.pump()
        time.sleep(0.01)
    drawn = draw(MGF_PT_reconstruct)
    assert "20 s left" in drawn.said and "Reconstruct Building" not in drawn.said
    assert "mgf.cancel_job" in [name for name, *_ in drawn.operators] and "Open Log" in drawn.said
    bpy.ops.mgf.cancel_job()
    assert "Stopping" in draw(MGF_PT_reconstruct).said
    while runner.pump():
        time.sleep(0.01)
    said = draw(MGF_PT_reconstruct).said
    assert "Cancelled" in said and "Resume" in said and "Reconstruct Building" in said


@pytest.mark.parametrize(
    ("engine_says", "panel_says"),
    [
        ("The disk of '/a b' is full; free some space and run again with --resume.",
         "The disk of '/a b' is full; free some space and press Resume."),
        ("The GPU's memory is full; lower --resolution or --max-gaussians, or use --device cpu.",
         "The GPU's memory is full; lower Resolution or Max Gaussians, or use Device cpu."),
        ("There are no clicks on the building; give --prompts FILE, or --masks FOLDER with your own masks.",
         "There are no clicks on the building; give points, or Own Masks with your own masks."),
        ("Out of memory; lower --resolution or --max-gaussians and run again with --resume.",
         "Out of memory; lower Resolution or Max Gaussians and press Reconstruct Building."),
        ("Compressed levels of detail need DracoPy; install with: pip install 'mgf-engine[models]', in the engine's "
         "environment, or leave out --draco.",
         "Compressed levels of detail need DracoPy; tick Models in the preferences and press Install Engine, or switch "
         "Compress off; in an environment of your own: pip install 'mgf-engine[models]'."),
        ("Device: CPU. Found the GPU X: run 'mgf doctor --gpu' (a minute) so that auto uses it, or use it unchecked by "
         "'--device cuda'.",
         "Device: CPU. Found the GPU X: press Check GPU in the preferences (a minute) so that auto uses it, or use it "
         "unchecked by Device cuda."),
        ("A plain - and a -- stay.", "A plain - and a -- stay."),
    ],
)  # fmt: skip
def test_sentences_of_the_engine_speak_of_the_panel(engine_says, panel_says):
    assert in_panel_terms(engine_says) == panel_says


@pytest.mark.parametrize(
    ("engine_says", "panel_says"),
    [
        ("Cancelled; run again with --resume to continue.", "Cancelled; press Resume to continue."),
        ("Out of memory; lower --resolution or --max-gaussians and run again with --resume.",
         "Out of memory; lower Resolution or Max Gaussians and press Reconstruct Building."),
    ],
)  # fmt: skip
def test_how_a_job_ended_is_said_in_the_users_language(engine_says, panel_says, monkeypatch):
    german = json.loads((Path(preferences.__file__).parent / "languages" / "de_DE.json").read_text(encoding="utf-8"))
    monkeypatch.setattr(panel_text, "look_up", lambda text: german.get(text, text))
    assert status_label._outcome(SimpleNamespace(text=engine_says, status="FAILED")) == german[panel_says] != panel_says


def test_a_full_disk_is_named_in_the_users_language(monkeypatch):
    german = json.loads((Path(preferences.__file__).parent / "languages" / "de_DE.json").read_text(encoding="utf-8"))
    monkeypatch.setattr(panel_text, "look_up", lambda text: german.get(text, text))
    said = "The disk of '/jobs/a' is full; free some space and run again with --resume."
    shown = status_label._outcome(SimpleNamespace(text=said, status="FAILED"))
    assert "„/jobs/a“" in shown and "Fortsetzen" in shown


def test_a_full_disk_points_to_the_button(addon, engine, house, marked):
    engine("full")
    with pytest.raises(RuntimeError):
        bpy.ops.mgf.reconstruct()
    said = " ".join(draw(MGF_PT_reconstruct).said.split())
    assert "free some space and press Resume." in said and "--resume" not in said


def test_a_python_without_the_engine_leads_to_the_preferences(addon, engine, house, marked, monkeypatch):
    bare = house.folder.parent / "bare"
    venv.create(bare, with_pip=False)
    monkeypatch.setenv("MGF_ENGINE_PYTHON", str(next(bare.glob("[bS][ic][nr]*/python*"))))
    with pytest.raises(RuntimeError):
        bpy.ops.mgf.reconstruct()
    drawn = draw(MGF_PT_reconstruct)
    assert "has no MGF engine" in " ".join(drawn.said.split())
    assert "mgf.show_preferences" in [name for name, *_ in drawn.operators]


def test_the_button_says_which_picture_there_is(addon, engine, house, marked):
    job = make_job(bpy.context.scene)
    engine("slow")
    runner.submit(job)
    assert "Show " not in draw(MGF_PT_reconstruct).said
    for stage, words in (("masks", "Show Masks"), ("field", "Show Render")):
        job._apply({"type": "preview", "stage": stage, "path": "a.jpg", "title": ""})
        assert words in draw(MGF_PT_reconstruct).said


def test_weak_masks_can_be_looked_at_after_the_job(addon, engine, house, marked):
    bpy.ops.mgf.reconstruct()
    sheet = Path(addon.job_folder) / "masks" / "contact_sheet.jpg"
    sheet.parent.mkdir(exist_ok=True)
    sheet.write_bytes(b"x")
    job = runner.jobs(addon.key)[-1]
    assert "Contact Sheet" not in draw(MGF_PT_reconstruct).said
    job.warnings.append("2 of 12 masks are weak and left out (a.jpg); look at the contact sheet.")
    drawn = draw(MGF_PT_reconstruct)
    assert "Open Contact Sheet" in drawn.said
    assert "masks/contact_sheet.jpg" in [getattr(given, "name", "") for _, given, _ in drawn.operators]


def test_what_a_job_is_busy_with_is_not_said_after_its_end(addon, engine, house, marked):
    job = make_job(bpy.context.scene)
    engine("slow")
    runner.submit(job)
    runner.pump()
    job.warnings.append(
        "7 of 24 photos could be registered at first; structure from motion runs again with affine-covariant "
        "features, which match photos taken farther apart."
    )
    assert "runs again" in " ".join(draw(MGF_PT_reconstruct).said.split())
    job.status = DONE
    assert "runs again" not in " ".join(draw(MGF_PT_reconstruct).said.split())
    job.status = FAILED  # where it may tell why
    assert "runs again" in " ".join(draw(MGF_PT_reconstruct).said.split())


def test_buttons_stand_above_what_comes_and_goes(addon, engine, house, marked):
    """A warning that arrives, or a figure, moves no button under the pointer."""
    bpy.ops.mgf.reconstruct()
    said = draw(MGF_PT_reconstruct).said
    assert said.index("Mesh finished") < said.index("Open Log") < said.index("Two photos are blurred")


def test_the_bar_says_what_goes_before_the_training(addon, engine, house, marked):
    """Preset quick trains nothing: the bar said Training all the while."""
    job = make_job(bpy.context.scene)
    engine("slow")
    runner.submit(job)
    runner.pump()
    job._apply({"type": "stage", "stage": "field", "index": 2, "count": 5, "cached": False})
    assert "Training" in draw(MGF_PT_reconstruct).said
    progress = {"type": "progress", "stage": "field", "fraction": 0.4, "overall": 0.2}
    job._apply({**progress, "figures": {"start": "dense", "block": 2}})
    said = draw(MGF_PT_reconstruct).said
    assert "Matching photos" in said and "Training" not in said and "dense" not in said and "Block" in said
    job._apply({**progress, "figures": {"iteration": 3}})
    assert "Training" in draw(MGF_PT_reconstruct).said


def test_resume_is_offered_where_a_second_run_in_the_folder_failed(addon, engine, house, marked):
    """The results of the first run, still in the folder, do not hide it."""
    engine("ok", FAKE_RESULT=house.job)
    bpy.ops.mgf.reconstruct()
    assert "mgf.resume" not in [name for name, *_ in draw(MGF_PT_reconstruct).operators]
    engine("silent")
    with pytest.raises(RuntimeError):
        bpy.ops.mgf.reconstruct()
    drawn = draw(MGF_PT_reconstruct)
    assert "press Resume" in " ".join(drawn.said.split())
    assert "mgf.resume" in [name for name, *_ in drawn.operators] and "interrupted" not in drawn.said


def test_own_masks_need_no_points(addon, engine, house):
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    addon.masks_folder = str(house.folder)
    assert draw(MGF_PT_mark).said == "Your own masks are used"
    addon.masks_folder, addon.options.use_masks = "", False
    assert draw(MGF_PT_mark).said == "Masks are switched off"


def test_results_on_their_way_into_an_empty_scene(addon, house):
    async_import.begin(bpy.context.scene, house.job)
    assert "Importing the results" in draw(MGF_PT_scene).said
    async_import.forget(bpy.context.scene)
    assert "Importing the results" not in draw(MGF_PT_scene).said


def test_results_on_their_way_and_broken(addon, engine, house):
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    addon.job_folder = str(house.job)
    (house.job / "mesh.ply").write_bytes(b"solid")
    async_import.begin(bpy.context.scene, house.job)
    assert "Importing the results" in draw(MGF_PT_results).said
    while async_import.pump():
        time.sleep(0.005)
    assert "not a PLY file" in " ".join(draw(MGF_PT_results).said.split())


@pytest.mark.parametrize(
    ("extra", "line"),
    [
        ("survey", "missing; tick Drawings and Map Coordinates and press Reinstall Engine"),
        ("models", "missing; tick Models and press Reinstall Engine"),
        ("town", "missing; mgf town needs an existing environment with mgf-engine[town]"),
    ],
)
def test_a_check_of_an_engine_installed_here_names_ticks_and_not_pip(extra, line):
    said = f"need rasterio, ezdxf: pip install -c '/home/me/constraints.txt' 'mgf-engine[{extra}]'"
    assert preferences._in_panel_terms(said, managed=True) == line
    assert preferences._in_panel_terms(said, managed=False) == said
    assert preferences._in_panel_terms("yes", managed=True) == "yes"


@pytest.mark.parametrize("managed", [True, False])
def test_a_check_names_the_button_of_the_weights(managed):
    said = "random walker, which needs no weights; 'mgf weights' fetches those of EfficientSAM, the paper's segmenter "
    said += "(41 MB, Apache-2.0)"
    shown = preferences._in_panel_terms(said, managed)
    assert shown == said.replace("'mgf weights' fetches", "the arrow beside Mask Weights fetches")
    engine = (REPO / "mgf_engine" / "masks" / "segmenters" / "messages.py").read_text()
    first, _, second = said.rpartition("'mgf weights'")
    assert first.removesuffix("; ") in engine and second.partition("(41")[0] in engine  # the engine still says so


@pytest.mark.parametrize("source", ["MANAGED", "EXISTING"])
def test_preferences(addon, engine, source, monkeypatch):
    class Stand:
        draw, _draw_install, _draw_task = (vars(MGF_Preferences)[n] for n in ("draw", "_draw_install", "_draw_task"))
        bl_rna = MGF_Preferences.bl_rna
        engine_source, wheel_folder = source, ""

    def said(props: bool = False) -> str:
        from layouts import Recorder

        stand = Stand()
        stand.layout = Recorder()
        stand.draw(bpy.context)
        return "\n".join(stand.layout.props) if props else stand.layout.said

    current_task.forget()
    monkeypatch.setattr(preferences, "has_nvidia", lambda: True)
    assert "Check GPU" in said()
    bpy.ops.mgf.check_gpu()
    assert "The GPU passed in 9 s." in said()
    monkeypatch.setattr(preferences, "has_nvidia", lambda: False)
    assert "Check GPU" not in said()
    current_task.forget()
    assert "Check Engine" in said() and ("Install Engine" in said()) == (source == "MANAGED")
    assert ("Also Install" in said()) == (source == "MANAGED")
    monkeypatch.setattr(preferences, "discarding", lambda: True)
    assert ("being removed" in said()) == (source == "MANAGED")
    assert "interrupted" not in said()
    monkeypatch.setattr(preferences, "discarding", lambda: False)
    system = bpy.context.preferences.system
    for allowed in (False, True):
        system.use_online_access = allowed
        offered = "use_online_access" in said(props=True)
        assert offered == ("Online access is off" in said()) == (source == "MANAGED" and not bpy.app.online_access)
    bpy.ops.mgf.check_engine()
    assert "torch\n2.13.0" in said() and "Everything a job needs is here." in said()
    assert said().index("Everything a job needs") < said().index("2.13.0")  # the verdict comes first
    with monkeypatch.context() as context:  # another engine was chosen while the check ran
        context.setattr(current_task, "chosen_engine", lambda: ("EXISTING", "/another"))
        assert "2.13.0" not in said()
    preferences._other_engine(None, bpy.context)
    assert "2.13.0" not in said()  # said of the engine before
    task = Task([Step("Creating the environment", ["false"])], current_task.log_path(), lambda s, t: "It failed.")
    current_task.begin("install", task)
    assert "Creating the environment" in said()
    task.run()
    assert "It failed." in said()
    task.status, task.text = "CANCELLED", "Cancelled; the engine from before is kept."
    assert "engine from before is kept" in " ".join(said().split())
