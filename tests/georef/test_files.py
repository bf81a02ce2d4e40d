# SPDX-License-Identifier: GPL-3.0-or-later
"""Tables that other programs write, places in photos, and the mesh in true coordinates read back to a millimetre."""

import json
import struct

import numpy as np
import pytest
import trimesh
from support.survey_site import CRS, ORIGIN, write_photo

from mgf_engine.errors import BadInput
from mgf_engine.files.photo_tags import read_photo_tags
from mgf_engine.georef.control_points import CHECK, CONTROL, read_control, read_marks
from mgf_engine.georef.export import write_georeferenced
from mgf_engine.georef.gps import read_gps_position
from mgf_engine.georef.model import METRE, Georeference, read_georeference
from mgf_engine.model.mesh import Mesh

PHOTOS = ["DJI_0001.JPG", "DJI_0002.JPG"]


def test_the_list_of_opendronemap_holds_points_marks_and_system(tmp_path):
    path = tmp_path / "gcp_list.txt"
    path.write_text(
        "WGS84 UTM 32N\n691230.5 5334870.25 519.1 100.5 200.5 DJI_0001.JPG north\n"
        "691230.5 5334870.25 519.1 110 210 dji_0002.jpg north\n1 2 3 4 5 other.jpg\n"
    )
    control = read_control(path, None, PHOTOS)
    assert control.crs == "WGS84 UTM 32N" and control.unknown_photos == ("other.jpg",)
    assert control.points[0].name == "north" and control.points[0].position == (691230.5, 5334870.25, 519.1)
    assert [(m.view, m.pixel) for m in control.marks] == [(0, (100.5, 200.5)), (1, (110.0, 210.0))]


def test_points_of_metashape_are_read(tmp_path):
    points, marks = tmp_path / "points.csv", tmp_path / "marks.csv"
    points.write_text(
        "#CoordinateSystem: EPSG:25832\n#Label,X/Easting,Y/Northing,Z/Altitude,Accuracy_(m),Enabled\n"
        "P1,1.5,2.5,3.5,0.02,1\nP2,4,5,6,0.02,0\n"
    )
    marks.write_text("DJI_0001.JPG P1 10 20\nDJI_0002.JPG P1 11 21\n")
    control = read_control(points, marks, PHOTOS)
    assert control.crs == "EPSG:25832"
    assert [(p.name, p.role, p.sd[0]) for p in control.points] == [("P1", CONTROL, 0.02), ("P2", CHECK, 0.02)]
    assert [(m.point, m.view, m.pixel) for m in control.marks] == [("P1", 0, (10, 20)), ("P1", 1, (11, 21))]


ODM = """EPSG:25832
500000 5000000 100 10 20 DJI_0001.JPG P1
500000 5000000 100 11 21 DJI_0002.JPG P1
500010 5000003 101.5 12 22 DJI_0001.JPG P2
"""


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ("500010 5000003", "5000x0 5000003", "Line 4 of .* is not of the form"),
        ("12 22 DJI", "12 DJI", "Line 4 of .* is not of the form"),
        ("500000 5000000 100 11", "500000 5000000 99 11", "'P1' lies in two places"),
        ("DJI_", "IMG_", "No photo named in .*such as 'IMG_0001.JPG'"),
    ],
)
def test_a_damaged_list_of_opendronemap_is_no_table_of_points(tmp_path, before, after, said):
    path = tmp_path / "gcp_list.txt"
    path.write_text(ODM.replace(before, after))
    with pytest.raises(BadInput, match=said):
        read_control(path, None, PHOTOS)


def test_a_list_of_opendronemap_without_its_first_line_loses_no_row(tmp_path):
    path = tmp_path / "gcp_list.txt"
    path.write_text(ODM.partition("\n")[2])
    control = read_control(path, None, PHOTOS)
    assert control.crs == "" and [m.view for m in control.marks] == [0, 1, 0]


def test_points_whose_names_are_numbers_are_no_list_of_opendronemap(tmp_path):
    points, marks = tmp_path / "points.txt", tmp_path / "marks.csv"
    points.write_text("1 500000 5000000 100 0.02 check\n2 500010 5000003 101 0.03 control\n")
    marks.write_text("1 DJI_0001.JPG 10 20\n")
    control = read_control(points, marks, PHOTOS)
    assert [(p.name, p.role, p.position[0], p.sd[0]) for p in control.points] == [
        ("1", CHECK, 500000.0, 0.02), ("2", CONTROL, 500010.0, 0.03),
    ]  # fmt: skip


def test_a_photo_that_may_be_one_of_two_is_named(tmp_path):
    marks = tmp_path / "marks.csv"
    marks.write_text("name,photo,x,y\nP1,1.jpg,10,20\nP1,west/2.jpg,10,20\n")
    with pytest.raises(BadInput, match=r"'1.jpg' in .* could be any of east/1.jpg, west/1.jpg"):
        read_marks(marks, ["east/1.jpg", "west/1.jpg", "west/2.jpg"])


@pytest.mark.parametrize("fields", ["P2 4 5 6 check", "P2 4 5 6 0.02 check", "P2,4,5,6,check"])
def test_a_role_is_read_without_a_heading_and_without_an_accuracy(tmp_path, fields):
    points, marks = tmp_path / "points.csv", tmp_path / "marks.csv"
    points.write_text(f"{'P1 1.5 2.5 3.5'.replace(' ', ',' if ',' in fields else ' ')}\n{fields}\n")
    marks.write_text("P1 DJI_0001.JPG 10 20\n")
    control = read_control(points, marks, PHOTOS, 0.03)
    assert [(p.name, p.role) for p in control.points] == [("P1", CONTROL), ("P2", CHECK)]
    assert control.points[1].sd[0] == (0.02 if "0.02" in fields else 0.03)


@pytest.mark.parametrize(
    ("text", "match"),
    [("", "no rows"), ("P1,1,2\n", "where a number belongs"), ("P1,1,2,3\nP1,1,2,3\n", "twice"), ("a\0b", "no text")],
)
def test_damaged_tables_are_refused(tmp_path, text, match):
    path = tmp_path / "points.csv"
    path.write_text(text)
    with pytest.raises(BadInput, match=match):
        read_control(path, None, PHOTOS)


def test_a_drone_tells_its_place_and_accuracy(tmp_path):
    names = {
        "RtkFlag": 50, "RtkStdLat": 0.012, "RtkStdLon": 0.014, "RtkStdHgt": 0.03, "AbsoluteAltitude": "+567.25",
        "GimbalPitchDegree": -90, "GimbalRollDegree": 0,
    }  # fmt: skip
    inside = " ".join(f'drone-dji:{name}="{value}"' for name, value in names.items())
    xmp = (
        '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
        f'<rdf:Description xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/" {inside}/></rdf:RDF></x:xmpmeta>'
    )
    write_photo(tmp_path / "a.jpg", -33.85, -70.5, 12.0, xmp)
    place = read_gps_position(tmp_path / "a.jpg")
    assert (place.latitude, place.longitude) == pytest.approx((-33.85, -70.5), abs=1e-7)
    assert place.rtk and place.ellipsoidal and place.height == 567.25 and place.sd == (0.014, 0.03)
    assert np.allclose(read_photo_tags(tmp_path / "a.jpg").up, (0, 0, -1))
    assert read_gps_position(tmp_path / "none.jpg") is None


def test_every_file_leads_back_to_utm_within_a_millimetre(tmp_path):
    shape = trimesh.creation.box((8.0, 6.0, 5.0)).subdivide()
    mesh = Mesh(np.asarray(shape.vertices, float), np.asarray(shape.faces, np.int32), np.full((len(shape.vertices), 3), 99, np.uint8))  # noqa: E501  # fmt: skip
    turn = trimesh.transformations.euler_matrix(1.2, 0.4, 0.7)
    turn[:3, :3] *= 1.7
    turn[:3, 3] = 3.0, -5.0, 519.0
    offset = (ORIGIN[0], ORIGIN[1], 0.0)
    placed = Georeference(turn, offset, CRS, METRE, True, True, "control")
    folder = write_georeferenced(mesh, placed, tmp_path, None, obj=True, glb=True)
    true = placed.world(mesh.vertices)
    read = read_georeference(folder)
    for name in ("mesh.ply", "mesh.obj", "mesh.glb"):
        found = trimesh.load(folder / name, process=False, force="mesh").vertices
        local = np.c_[found[:, 0], -found[:, 2], found[:, 1]] if name.endswith("glb") else found
        assert np.abs(local + np.array(read.offset) - true).max() < 1e-3, name
    assert "UTM" in (folder / "mesh.prj").read_text()
    data = (folder / "mesh.glb").read_bytes()
    head = json.loads(data[20 : 20 + struct.unpack("<I", data[12:16])[0]])
    assert head["asset"]["extras"]["crs"] == CRS and head["asset"]["extras"]["offset"] == list(offset)
