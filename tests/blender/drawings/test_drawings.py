# SPDX-License-Identifier: GPL-3.0-or-later
"""From the Drawings panel to pictures in the Image Editor: options, section planes, the run, what came."""

from __future__ import annotations

import json
import os
import time
from pathlib import Path

import bpy
import numpy as np
import pytest
from layouts import draw

from mgf_blender import translations
from mgf_blender.common import runner
from mgf_blender.common import text as text_module
from mgf_blender.common.job import CANCELLED, DONE, FAILED
from mgf_blender.drawings import panel, previews
from mgf_blender.drawings.index import Drawing, read_index
from mgf_blender.drawings.operators import drawings_job, load_drawing
from mgf_blender.drawings.panel import MGF_PT_drawings
from mgf_blender.drawings.previews import preview_icon
from mgf_blender.drawings.sections import find_sections
from mgf_blender.jobs.engine_messages import in_panel_terms
from mgf_blender.reconstruct.panel import MGF_PT_reconstruct
from mgf_blender.scene_import.imported_scene import FIELD_KEY, ImportedScene


@pytest.fixture
def finished(addon, engine, house):
    """An imported finished job."""
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    bpy.ops.mgf.import_result(directory=str(house.job))
    return addon


def arguments(house) -> list[str]:
    return json.loads((house.job / "arguments.json").read_text())


def sections(house) -> dict[str, np.ndarray]:
    """Name -> point and normal, as the engine was given them."""
    line = arguments(house)
    texts = [line[k + 1] for k, word in enumerate(line) if word == "--section"]
    return {t.split("=")[0]: np.array(t.split("=")[1].split(","), float) for t in texts}


def test_no_job_no_panel(addon, engine, house):
    assert draw(MGF_PT_drawings).said == ""
    with pytest.raises(RuntimeError, match="The job folder holds no finished job"):
        bpy.ops.mgf.make_drawings()


@pytest.mark.parametrize(
    ("frame", "shown"),
    [("north", "Nord"), ("north-east-2", "Nordost-2"), ("plan", "von oben"), ("A", "A"), ("street-2", "street-2")],
)
def test_sides_are_named_in_the_users_language(monkeypatch, frame, shown):
    known = translations.dictionary()["de_DE"]
    monkeypatch.setattr(text_module, "look_up", lambda text: known.get(("*", text), text))
    assert Drawing(Path("a.png"), "orthophoto", frame).title == f"Orthofoto {shown}"


def test_button_to_pictures(finished, engine, house):
    said = draw(MGF_PT_drawings).said
    assert "Make Drawings" in said and "Three cuts through the middle" in said and "Orthophoto" not in said
    assert "0: chosen automatically" in said
    finished.drawings.resolution = 5.0
    assert "0: chosen automatically" in draw(MGF_PT_drawings).said  # the scale is 0
    finished.drawings.kinds = {"orthophotos"}
    assert "0: chosen automatically" not in draw(MGF_PT_drawings).said
    for name in ("resolution", "kinds"):
        finished.drawings.property_unset(name)
    assert bpy.ops.mgf.make_drawings() == {"FINISHED"}
    line = arguments(house)
    assert line[:2] == ["drawings", str(house.job)] and line.count("--draw") == 5 and "--cancel-on-eof" in line
    assert "--resolution" not in line and "--scale" not in line and "--section" not in line
    drawn = draw(MGF_PT_drawings)
    assert "Drawings finished in " in drawn.said and "Open Log" not in drawn.said
    assert "All Drawings\nOpen Folder\nOrthophoto A\nDeviation A" in drawn.said
    assert "Drawings finished" not in draw(MGF_PT_reconstruct).said
    (image,) = [load_drawing(house.job, name) for name, p, _ in [("orthophoto-A.png", 0, 0)]]
    assert tuple(image.size) == (8, 6) and image["mgf_image"] == "drawing"
    assert bpy.ops.mgf.show_drawing(name="orthophoto-A.png") == {"FINISHED"}
    with pytest.raises(RuntimeError, match=r"The job has no drawing '\.\./x\.png'"):
        bpy.ops.mgf.show_drawing(name="../x.png")


def test_a_picture_drawn_anew_is_read_anew(finished, engine, house):
    bpy.ops.mgf.make_drawings()
    assert tuple(load_drawing(house.job, "orthophoto-A.png").size) == (8, 6)
    engine("ok", FAKE_SIZE=12)
    bpy.ops.mgf.make_drawings()
    assert tuple(load_drawing(house.job, "orthophoto-A.png").size) == (12, 6)


def test_pictures_have_previews(finished, engine, house, monkeypatch):
    bpy.ops.mgf.make_drawings()
    path = house.job / "drawings" / "orthophoto-A.png"
    with monkeypatch.context() as patch:
        patch.setattr(panel, "preview_icon", lambda path: len(path.name))
        assert draw(MGF_PT_drawings).icons == [len("orthophoto-A.png"), len("deviation-A.png")]
    assert draw(MGF_PT_drawings).icons == []  # without a window Blender has no icons
    assert [name for name in previews._names if name.endswith("orthophoto-A.png")] == [str(path)]
    (collection,) = previews._kept
    first = set(collection)
    os.utime(path, ns=(0, 0))
    preview_icon(path)
    assert len(collection) == len(first) and set(collection) != first  # read anew, and the old one is gone
    assert preview_icon(path.with_name("none.png")) == 0


def test_planes_whose_names_differ_in_case_alone_have_files_of_their_own(finished, engine, house):
    """Windows and macOS take Cut and cut for one file."""
    for name in ("Cut", "cut"):
        bpy.ops.mgf.add_section()
        bpy.context.view_layer.objects.active.name = name
    bpy.ops.mgf.make_drawings()
    assert sorted(sections(house)) == ["Cut", "cut-2"]


def test_options_reach_the_engine(finished, house):
    wanted = finished.drawings
    wanted.kinds = {"sheets", "sections"}
    wanted.resolution, wanted.paper, wanted.scale, wanted.height = 2.5, "A1", 50, 1.2
    bpy.ops.mgf.make_drawings()
    line = " ".join(arguments(house))
    assert "--draw sections --draw sheets" in line and line.count("--draw") == 2
    assert "--resolution 2.5" in line and "--paper A1" in line and "--scale 50" in line and "--section z=1.2" in line
    wanted.kinds = set()
    with pytest.raises(RuntimeError, match="Nothing is chosen to be drawn"):
        bpy.ops.mgf.make_drawings()


def test_a_plane_says_where_to_cut_in_the_meshs_own_coordinates(finished, house):
    """The house leans with its whole scene, and Blender shows it upright: the plane comes back leaning."""
    imported = ImportedScene.find(bpy.context.scene)
    bpy.ops.mgf.add_section(axis="LEVEL")
    (plane,) = find_sections(bpy.context.scene)
    bpy.context.view_layer.update()
    plane.matrix_world.translation.z = 1.0
    bpy.ops.mgf.make_drawings()
    given = sections(house)["Section"]
    root = np.array(imported.root.matrix_world)
    point = root[:3, :3] @ (given[:3] - imported.offset) + root[:3, 3]
    assert point[2] == pytest.approx(1.0, abs=1e-5)
    assert root[:3, :3] @ given[3:] == pytest.approx([0, 0, 1], abs=1e-5)
    assert abs(given[5]) < 0.99  # it would be 1 in an upright scene


def test_a_plane_goes_through_the_mesh_and_not_through_the_gaussian_field(finished):
    imported = ImportedScene.find(bpy.context.scene)
    for kind in ("Mesh", "Points"):
        imported.clear(kind)
    data = bpy.data.meshes.new("Gaussian Field")
    data.from_pydata([(500, 0, 0), (900, 0, 0)], [], [])
    field = bpy.data.objects.new("Gaussian Field", data)
    imported.add("Points", field)
    field[FIELD_KEY] = True
    bpy.context.view_layer.update()
    bpy.ops.mgf.add_section(axis="SIDE")
    (plane,) = find_sections(bpy.context.scene)
    bpy.context.view_layer.update()
    origin = np.array(imported.root.matrix_world)[:3, 3]
    assert np.array(plane.matrix_world.translation) == pytest.approx(origin, abs=1e-4)


@pytest.mark.parametrize("scale", [(1, 1, 0), (2, 1, -3)])
def test_a_plane_that_was_scaled_flat_or_mirrored_still_cuts(finished, house, scale):
    bpy.ops.mesh.primitive_plane_add(location=(0, 0, 1), rotation=(0, np.pi / 2, 0))
    bpy.context.object.scale = scale
    bpy.ops.mgf.use_as_section()
    bpy.ops.mgf.make_drawings()
    root = np.array(ImportedScene.find(bpy.context.scene).root.matrix_world)
    normal = root[:3, :3] @ sections(house)["Plane"][3:]
    assert normal / np.linalg.norm(normal) == pytest.approx([np.sign(scale[2]) or 1, 0, 0], abs=1e-5)


def test_own_objects_are_sections_and_stay_when_they_are_none_any_more(finished, house):
    bpy.ops.mesh.primitive_plane_add(location=(0.5, 0, 1), rotation=(np.pi / 2, 0, 0))
    bpy.ops.object.empty_add(location=(0, 0.25, 0), rotation=(0, np.pi / 2, 0))
    for obj in bpy.context.scene.objects:
        obj.select_set(obj.name in {"Plane", "Empty"})
    bpy.ops.mgf.use_as_section()
    assert [o.name for o in find_sections(bpy.context.scene)] == ["Empty", "Plane"]
    bpy.data.objects["Plane"].name = "Cut: wall & door"
    bpy.ops.mgf.make_drawings()
    given, root = sections(house), np.array(ImportedScene.find(bpy.context.scene).root.matrix_world)
    assert set(given) == {"Empty", "Cut-wall-door"}
    assert np.abs(root[:3, :3] @ given["Cut-wall-door"][3:]) == pytest.approx([0, 1, 0], abs=1e-5)
    assert np.abs(root[:3, :3] @ given["Empty"][3:]) == pytest.approx([1, 0, 0], abs=1e-5)
    said = draw(MGF_PT_drawings).said
    assert "Cut: wall & door" in said and "Three cuts" not in said
    bpy.ops.mgf.remove_section(name="Cut: wall & door")
    assert "Cut: wall & door" in bpy.data.objects and len(find_sections(bpy.context.scene)) == 1
    bpy.ops.mgf.add_section(axis="FRONT")
    bpy.ops.mgf.remove_section(name="Section")
    assert "Section" not in bpy.data.objects and "Section" not in bpy.data.meshes
    with pytest.raises(RuntimeError, match="There is no section plane 'Section' any more"):
        bpy.ops.mgf.select_section(name="Section")


def test_failures_and_cancelling(finished, engine, house):
    engine("bad")
    with pytest.raises(RuntimeError, match="The scene has no photos"):
        bpy.ops.mgf.make_drawings()
    engine("silent")
    with pytest.raises(RuntimeError, match=r"code 77 \(Segmentation fault in kernel\); try again"):
        bpy.ops.mgf.make_drawings()
    assert runner.jobs()[-1].status == FAILED
    engine("slow")
    job = drawings_job(bpy.context.scene)
    runner.submit(job)
    end = time.monotonic() + 20
    while not job.stage and time.monotonic() < end:
        runner.pump()
        time.sleep(0.01)
    assert "Drawings, " in draw(MGF_PT_drawings).said
    with pytest.raises(RuntimeError, match="A job of this scene is running"):
        bpy.ops.mgf.make_drawings()
    bpy.ops.mgf.cancel_job()
    while runner.pump():
        time.sleep(0.01)
    assert job.status == CANCELLED


def test_a_failed_drawing_is_no_job_to_resume(finished, engine, house):
    (house.job / "job.json").write_text(json.dumps({"given": {}, "stages": {"deliver": {}}}))
    engine("bad")
    with pytest.raises(RuntimeError):
        bpy.ops.mgf.make_drawings()
    assert "mgf.resume" not in [name for name, *_ in draw(MGF_PT_reconstruct).operators]


@pytest.mark.parametrize(
    "text", ["{", "[]", '{"files": 3}', '{"files": {"../x.png": {"kind": "orthophoto"}}, "unit": 1}']
)
def test_a_damaged_index_shows_nothing(finished, house, text):
    path = Path(house.job, "drawings", "drawings.json")
    path.parent.mkdir()
    path.write_text(text)
    index = read_index(house.job)
    assert index is None or index.pictures == ()
    draw(MGF_PT_drawings)


def test_missing_packages_are_said_with_the_tick_that_brings_them():
    text = "Drawings need ezdxf; install with: pip install 'mgf-engine[survey]', in the engine's environment."
    assert "tick Drawings and Map Coordinates in the preferences and press Install Engine" in in_panel_terms(text)


def test_done_runs_are_told_apart(finished, house):
    bpy.ops.mgf.make_drawings()
    assert [(j.kind, j.status) for j in runner.jobs()] == [("drawings", DONE)]
