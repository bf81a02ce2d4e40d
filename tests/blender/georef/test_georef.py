# SPDX-License-Identifier: GPL-3.0-or-later
"""Control points from their file to the scene in true coordinates."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path

import bpy
import numpy as np
import pytest
from finished_work import OFFSET, write_georef
from layouts import draw

from mgf_blender.georef import files, magnifier, place
from mgf_blender.georef.operators import step_from
from mgf_blender.georef.panel import MGF_PT_control_points, MGF_PT_georef
from mgf_blender.georef.properties import mark_of, set_mark
from mgf_blender.georef.tool import dragged
from mgf_blender.jobs.engine_messages import in_panel_terms
from mgf_blender.prompts.panel import MGF_PT_masks, MGF_PT_prompts
from mgf_blender.prompts.tool import MGF_PointTool
from mgf_blender.reconstruct.panel import MGF_PT_reconstruct
from mgf_blender.scene_import.cameras import PHOTO_KEY
from mgf_blender.scene_import.imported_scene import ImportedScene


@pytest.fixture
def georef_json(tmp_path) -> Path:
    """A georeference that turns the house by 40 degrees, doubles it, and lies in UTM."""
    a, path = np.radians(40.0), tmp_path / "georef.json"
    turned = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    write_georef(path, turned, "control")
    return path


@pytest.fixture
def finished(addon, engine, house, georef_json):
    """An imported finished job with a file of two control points, which the engine finds in four photos."""
    photos = sorted(house.poses)[1:9:2]
    engine("ok", FAKE_GEOREF=georef_json, FAKE_PHOTOS="|".join(photos))
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    bpy.ops.mgf.import_result(directory=str(house.job))
    addon.georef.control_file = str(house.folder / "points.csv")
    return addon


def arguments(house) -> list[str]:
    return json.loads((house.job / "arguments.json").read_text())


def option(house, name: str) -> str:
    line = arguments(house)
    return line[line.index(name) + 1]


@pytest.mark.parametrize(
    ("name", "step", "to"),
    [("b", 1, "d"), ("b", -1, "f"), ("f", 1, "b"), ("c", 1, "d"), ("c", -1, "b"), ("g", 1, "b"), ("", 1, "b")],
)
def test_steps_lead_to_the_next_photo_and_round(name, step, to):
    assert step_from(name, ["b", "d", "f"], step) == to


def test_rmse_is_of_the_points_that_count():
    nowhere = (math.nan,) * 3
    residuals = [
        files.PointResiduals("P1", "control", (0.03, 0.0, 0.04), 1.0, ""),
        files.PointResiduals("P2", "control", (0.0, 0.0, 0.0), 1.0, ""),
        files.PointResiduals("P3", "control", (1.0, 1.0, 1.0), 9.0, "wrong"),
        files.PointResiduals("P4", "check", nowhere, math.nan, ""),
    ]
    assert (
        files.rmse(residuals, "control") == pytest.approx(0.05 / math.sqrt(2))
        and files.rmse(residuals, "check") is None
    )


def test_points_are_read_by_the_engine_and_listed(finished, house):
    said = draw(MGF_PT_georef).said
    assert "Read Points" in said and "Georeference Job" in said and "GPS" not in said
    given = {name: getattr(finished.georef, name) for name in ("crs", "control_file", "scale_bars")}
    for name in given:
        setattr(finished.georef, name, "")
    assert "Photos with GPS need nothing" in " ".join(draw(MGF_PT_georef).said.split())
    for name, value in given.items():
        setattr(finished.georef, name, value)
    assert draw(MGF_PT_control_points).said == ""
    with pytest.raises(RuntimeError, match="Read the control points first"):
        bpy.ops.mgf.mark_control_points()
    assert bpy.ops.mgf.predict_places() == {"FINISHED"}
    assert [(p.name, p.role) for p in finished.georef.points] == [("P1", "control"), ("C1", "check")]
    assert arguments(house)[:2] == ["georef", str(house.job)] and "--marks" not in arguments(house)
    assert option(house, "--control") == str(house.folder / "points.csv") and finished.georef.marking
    said = draw(MGF_PT_control_points).said
    assert "Known by its own marks, 0.4 px" in said and "Predict Places" in said
    assert "2 points, 0 marks" in draw(MGF_PT_georef).said
    assert "Control points read" not in draw(MGF_PT_reconstruct).said


def test_the_next_photo_is_one_that_shows_the_point_and_comes_into_the_list(finished, house):
    bpy.ops.mgf.predict_places()
    wanted, seen = sorted(house.poses)[1:9:2], []
    for _ in range(5):
        bpy.ops.mgf.next_marked_photo(step=1)
        seen.append(finished.photos[finished.photo_index].name)
    assert sorted(set(seen)) == wanted and seen[0] == seen[4]
    bpy.ops.mgf.next_marked_photo(step=-1)
    assert finished.photos[finished.photo_index].name == seen[3]
    assert len({p.name for p in finished.photos}) == len(finished.photos)


def test_a_point_has_one_mark_in_a_photo_and_the_run_gets_them_as_csv(finished, house):
    bpy.ops.mgf.predict_places()
    with pytest.raises(RuntimeError, match="No point is marked yet"):
        bpy.ops.mgf.georeference()
    scene, photo = bpy.context.scene, finished.photos[0].name
    set_mark(scene, "P1", photo, (10.25, 20.5))
    set_mark(scene, "P1", photo, (11.25, 21.5))
    set_mark(scene, "C1", photo, (1, 2))
    assert mark_of(scene, "P1", photo) == 0 and len(finished.georef.marks) == 2
    finished.georef.crs = " EPSG:25832 "
    assert bpy.ops.mgf.georeference() == {"FINISHED"}
    assert option(house, "--crs") == "EPSG:25832" and "--cancel-on-eof" in arguments(house)
    with open(option(house, "--marks"), encoding="utf-8", newline="") as file:
        rows = list(csv.reader(file))
    assert rows == [["name", "photo", "x", "y"], ["P1", photo, "11.25", "21.50"], ["C1", photo, "1.00", "2.00"]]


def test_after_the_run_the_scene_lies_where_it_truly_is(finished, house):
    bpy.ops.mgf.predict_places()
    set_mark(bpy.context.scene, "P1", finished.photos[0].name, (1, 2))
    bpy.ops.mgf.georeference()
    scene, imported = bpy.context.scene, ImportedScene.find(bpy.context.scene)
    found = files.read_placement(house.job)
    (mesh,) = imported.objects("Mesh")
    bpy.context.view_layer.update()
    own = np.array(mesh.data.vertices[3].co)
    world = np.array(mesh.matrix_world) @ np.append(own, 1.0)
    in_scene = np.array(mesh.matrix_basis) @ np.append(own, 1.0) + np.append(imported.offset, 0.0)
    assert world[:3] == pytest.approx((found.to_local @ in_scene)[:3], abs=1e-4)
    assert [scene[k] for k in ("SRID", "crs x", "crs y", "crs z")] == ["EPSG:25832", *OFFSET]
    assert scene["north"] == 0.0 and scene["latitude"] == 48.1 and scene["longitude"] == 11.6
    assert scene.unit_settings.system == "METRIC"
    said = draw(MGF_PT_georef).said
    assert "In true coordinates: EPSG:25832" in said and "Origin at 691234, 5334876, 500" in said
    assert "P1\n+3\n-4\n+0\n0.5" in said and "P9\n–\n–\n–\n–" in said
    assert "Control: RMSE 5.0 mm" in said and "Check: RMSE 12.0 mm" in said
    imported.root.location.x += 1.0
    bpy.context.view_layer.update()
    assert "Place in True Coordinates" in draw(MGF_PT_georef).said
    view = next(a.spaces.active for a in bpy.context.screen.areas if a.type == "VIEW_3D").region_3d
    view.view_location = (9.0, 9.0, 9.0)
    bpy.ops.mgf.place_scene()
    bpy.context.view_layer.update()
    assert place.is_placed(scene, imported, found)
    middle = np.mean([o.matrix_world.translation for o in imported.cameras()], axis=0)
    assert np.linalg.norm(np.array(view.view_location) - middle) < 10  # it stands 19 m higher than it did
    view.view_location = (9.0, 9.0, 9.0)
    bpy.ops.mgf.place_scene()
    assert tuple(view.view_location) == (9.0, 9.0, 9.0)  # nothing moved


def test_a_run_that_found_neither_scale_nor_place_says_so(finished, house, georef_json):
    """Photos without GPS, and nothing else given: the engine only finds what is up."""
    content = json.loads(georef_json.read_text())
    georef_json.write_text(json.dumps({**content, "unit": "scene units", "crs": None, "method": "up", "origin": None}))
    finished.georef.control_file = ""
    bpy.ops.mgf.georeference()
    said = " ".join(draw(MGF_PT_georef).said.split())
    assert "Scale and place are still unknown; give control points or scale bars" in said
    assert "Place in True Coordinates" not in said and "Georeferenced" not in said


def test_a_scene_far_from_its_origin_keeps_its_offset(addon, engine, tmp_path, georef_json):
    """Coordinates of the model are those of a map: the empty takes back what was taken off for float32."""
    import synthetic

    house = synthetic.write_house(tmp_path / "far", shift=(4.5e6, 5.4e6, 0.0))
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    addon.job_folder = str(house.job)
    data = json.loads(georef_json.read_text())
    data["to_local"] = np.eye(4).tolist()
    data["to_local"][0][3], data["to_local"][1][3] = -4.5e6, -5.4e6
    (house.job / "georef.json").write_text(json.dumps(data))
    bpy.ops.mgf.place_scene()
    imported = ImportedScene.find(bpy.context.scene)
    assert np.abs(imported.offset[:2] - (4.5e6, 5.4e6)).max() < 20
    assert np.array(imported.root.matrix_world)[:2, 3] == pytest.approx(imported.offset[:2] - (4.5e6, 5.4e6), abs=1e-5)


def test_without_true_coordinates_nothing_moves(finished, house):
    before = ImportedScene.find(bpy.context.scene).root.matrix_world.copy()
    with pytest.raises(RuntimeError, match="Press Georeference Job first"):
        bpy.ops.mgf.place_scene()
    (house.job / "georef.json").write_text("{")
    with pytest.raises(RuntimeError, match="The job has no true coordinates yet"):
        bpy.ops.mgf.place_scene()
    assert "Place in True" not in draw(MGF_PT_georef).said
    assert ImportedScene.find(bpy.context.scene).root.matrix_world == before


def test_marks_go_to_a_file_and_back(finished, tmp_path):
    scene = bpy.context.scene
    with pytest.raises(RuntimeError, match="There are no marks yet"):
        bpy.ops.mgf.export_marks(filepath=str(tmp_path / "marks.csv"))
    set_mark(scene, "Ecke, links", "a/b.jpg", (10.25, 20.5))
    bpy.ops.mgf.export_marks(filepath=str(tmp_path / "marks"))
    finished.georef.marks.clear()
    bpy.ops.mgf.import_marks(filepath=str(tmp_path / "marks.csv"))
    (mark,) = finished.georef.marks
    assert (mark.point, mark.photo, tuple(mark.uv)) == ("Ecke, links", "a/b.jpg", (10.25, 20.5))
    for text in ("name,photo\nP1,a", "name,photo,x,y\nP1,a,b,c", "name,photo,x,y\nP1,a,nan,1", "\0"):
        (tmp_path / "bad.csv").write_text(text)
        with pytest.raises(RuntimeError, match="is no file of marks"):
            bpy.ops.mgf.import_marks(filepath=str(tmp_path / "bad.csv"))
    with pytest.raises(RuntimeError, match="Cannot read"):
        bpy.ops.mgf.import_marks(filepath=str(tmp_path / "none.csv"))
    assert len(finished.georef.marks) == 1


def test_what_the_user_gave_wrong_is_said(finished, engine, house):
    bpy.ops.mgf.predict_places()
    set_mark(bpy.context.scene, "P1", finished.photos[0].name, (1, 2))
    engine("bad")
    with pytest.raises(RuntimeError, match="lie on a line"):
        bpy.ops.mgf.georeference()
    assert "lie on a line" in " ".join(draw(MGF_PT_georef).said.split())
    finished.georef.control_file = ""
    with pytest.raises(RuntimeError, match="No file of control points is chosen"):
        bpy.ops.mgf.predict_places()


def test_the_next_reconstruction_gets_points_and_marks(finished, house):
    with pytest.raises(RuntimeError, match="There are no marks yet"):
        bpy.ops.mgf.use_in_reconstruction()
    set_mark(bpy.context.scene, "P1", finished.photos[0].name, (1, 2))
    finished.georef.crs = "EPSG:25832"
    finished.options.control_adjust = False  # as 'mgf georef' leaves it in a job whose cameras it keeps
    assert "Use in Reconstruction" in draw(MGF_PT_georef).said
    bpy.ops.mgf.use_in_reconstruction()
    assert finished.options.control_adjust
    finished.photos[0].clicks.add().uv = (100.5, 80.25)
    bpy.ops.mgf.reconstruct()
    line = arguments(house)
    assert f"control={house.folder / 'points.csv'}" in line and "crs=EPSG:25832" in line
    marks = next(text for text in line if text.startswith("marks=")).removeprefix("marks=")
    assert Path(marks).read_text().splitlines()[1].startswith("P1,")


def test_gps_alone_needs_no_marks(finished, house):
    finished.georef.control_file, finished.georef.crs = "", "auto"
    bpy.ops.mgf.georeference()
    assert option(house, "--control") == "" and option(house, "--marks") == "" and option(house, "--crs") == "auto"


def test_control_points_have_room_below_the_photos_while_they_are_marked(finished):
    """Prompts and All Photos stand above them: what is of no use meanwhile pushed them out of a window of 900 px."""
    bpy.ops.mgf.predict_places()  # which takes in the points
    assert finished.georef.marking and not MGF_PT_masks.poll(bpy.context)
    drawn = draw(MGF_PT_prompts)
    assert "mgf.next_photo" in [name for name, *_ in drawn.operators] and "Clicks mark control points" in drawn.said
    assert not {"mgf.preview_mask", "mgf.suggest_clicks"} & {name for name, *_ in drawn.operators}
    finished.georef.points.clear()  # without points their panel is not there
    assert MGF_PT_masks.poll(bpy.context)
    assert "mgf.preview_mask" in [name for name, *_ in draw(MGF_PT_prompts).operators]


def test_the_tool_marks_points_or_the_building_but_never_both(finished):
    names = [entry[0] for entry in MGF_PointTool.bl_keymap]
    assert names.index("mgf.click") < names.index("mgf.mark")
    bpy.ops.mgf.predict_places()  # which takes in the points
    assert finished.georef.marking
    with pytest.raises(RuntimeError, match="Control points are being marked"):
        bpy.ops.mgf.click("EXEC_DEFAULT", photo=0, uv=(1, 1))
    finished.georef.points.clear()  # their panel, where marking is switched off, is gone with them
    with pytest.raises(RuntimeError, match="Show one of the listed photos"):  # in -b no editor does
        bpy.ops.mgf.click("EXEC_DEFAULT", photo=0, uv=(1, 1))
    finished.georef.marking = False
    with pytest.raises(RuntimeError, match="Choose a control point to mark first"):
        bpy.ops.mgf.mark("EXEC_DEFAULT", photo=0, uv=(1, 1))


def test_cameras_without_photo_names_are_passed_over(finished):
    bpy.ops.mgf.predict_places()
    for camera in ImportedScene.find(bpy.context.scene).objects("Cameras")[:3]:
        del camera[PHOTO_KEY]
    assert bpy.ops.mgf.next_marked_photo(step=1) == {"FINISHED"}


@pytest.mark.parametrize("text", ["{", "[]", '{"points": 3}', '{"points": [{"name": "P1"}]}'])
def test_damaged_files_of_the_engine_show_nothing(finished, house, text):
    files.places_path(house.job).write_text(text)
    (house.job / "report.json").write_text(text)
    assert files.read_known_points(house.job) == {} and files.read_residuals(house.job) == []
    draw(MGF_PT_georef)


def test_sentences_of_the_engine_speak_of_the_panel():
    assert in_panel_terms("The georeference cannot be used; run 'mgf georef' again.") == (
        "The georeference cannot be used; press Georeference Job."
    )


@pytest.mark.parametrize(
    ("pointer", "area", "where"),
    [
        ((100, 100), (1000, 700), (128, 128)),  # above and to the right
        ((900, 100), (1000, 700), (900 - 28 - 176, 128)),  # left of it near the right edge
        ((100, 650), (1000, 700), (128, 650 - 28 - 176)),  # below it near the upper edge
        ((990, 690), (1000, 700), (990 - 28 - 176, 690 - 28 - 176)),
    ],
)
def test_the_magnifier_stands_beside_the_pointer_and_within_the_editor(pointer, area, where):
    x, y, side = magnifier.place_magnifier(pointer, area, 1.0)
    assert (x, y) == where and side == magnifier.SIDE
    assert not (x <= pointer[0] <= x + side and y <= pointer[1] <= y + side)
    doubled = magnifier.place_magnifier(tuple(2 * v for v in pointer), tuple(2 * v for v in area), 2.0)
    assert doubled == (2 * x, 2 * y, 2 * side)


def test_a_small_editor_keeps_the_magnifier_inside():
    x, y, _ = magnifier.place_magnifier((60, 60), (150, 120), 1.0)
    assert x > 0 and y > 0


@pytest.mark.parametrize("zoom", [0.1, 1.0, 7.0])
def test_the_magnifier_shows_half_a_pixel_around_the_exact_place(zoom):
    more = magnifier.magnification(zoom, 1.0)
    assert more >= 8.0 and more >= 4 * zoom  # half a pixel of the photo is four of the screen
    left, top, right, bottom = magnifier.visible_part((20.25, 30.75), magnifier.SIDE, more)
    assert ((left + right) / 2, (top + bottom) / 2) == (20.25, 30.75)
    assert (right - left, bottom - top) == pytest.approx((magnifier.SIDE / more,) * 2)


def test_shift_moves_a_mark_a_tenth_of_the_pointers_way_and_never_out_of_the_photo():
    size = (100, 80)
    assert dragged((50.0, 40.0), (50.0, 40.0), (54.0, 38.0), False, size) == (54.0, 38.0)
    assert dragged((50.0, 40.0), (50.0, 40.0), (54.0, 38.0), True, size) == pytest.approx((50.4, 39.8))
    at, pointer = (50.0, 40.0), (50.0, 40.0)
    for step in range(1, 5):  # one screen pixel each in an editor where it is four of the photo's
        at, pointer = dragged(at, pointer, (50.0 + 4 * step, 40.0), True, size), (50.0 + 4 * step, 40.0)
    assert at == pytest.approx((51.6, 40.0))
    assert dragged((99.0, 1.0), (50.0, 40.0), (60.0, 30.0), False, size) == (100.0, 0.0)


def test_the_magnifier_is_there_where_a_click_marks_and_nowhere_else(finished):
    from types import SimpleNamespace

    bpy.ops.mgf.predict_places()
    image = bpy.data.images.load(bpy.path.abspath(finished.photos[0].file), check_existing=True)
    space = SimpleNamespace(type="IMAGE_EDITOR", image=image, ui_mode="VIEW")

    def wanted(tool: str) -> bool:
        tools = SimpleNamespace(from_space_image_mode=lambda mode: SimpleNamespace(idname=tool))
        workspace = SimpleNamespace(tools=tools)
        return magnifier.marks_on_click(SimpleNamespace(space_data=space, scene=bpy.context.scene, workspace=workspace))

    assert wanted("mgf.point_tool") and not wanted("builtin.annotate")
    finished.georef.marking = False
    assert not wanted("mgf.point_tool")
    finished.georef.marking = True
    space.image = bpy.data.images.new("of their own", 4, 4)
    assert not wanted("mgf.point_tool")
    space.image = None
    assert not wanted("mgf.point_tool")
