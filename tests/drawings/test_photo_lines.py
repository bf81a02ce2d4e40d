# SPDX-License-Identifier: GPL-3.0-or-later
"""Lines come to where the photos have the edges of planes, and the corners between them with them."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from support.finished_job import FinishedJob

from benchmarks.synthetic.house import OFFSET
from mgf_engine.drawings.elevation import draw_elevation
from mgf_engine.drawings.facades import find_facades
from mgf_engine.drawings.load import read_survey
from mgf_engine.drawings.model import CREASE, OUTLINE, DrawingFrame, Survey
from mgf_engine.drawings.openings import ElevationPhotos, elevation_photos
from mgf_engine.drawings.orthophoto import Visibility
from mgf_engine.drawings.photo_lines import Move, PhotoLineOptions, find_moves, line_photos, move_lines
from mgf_engine.drawings.project import Grid
from mgf_engine.drawings.regions import RegionMap, survey_planes
from mgf_engine.drawings.straighten import FittedSegment, Stroke
from mgf_engine.drawings.trace import Chain
from mgf_engine.model.mesh import Mesh
from mgf_engine.openings.photo_edges import EdgePhotos
from mgf_engine.texture.texture_pipeline import choose_painting
from tests.support.analytic import camera as analytic_camera
from tests.support.wall_photos import cameras

PULLED = 1.5  # ground pixels
HEIGHT_OF_EAVES = OFFSET[2] + 2.0  # scene frame
X, Y = np.array([1.0, 0.0]), np.array([0.0, 1.0])


@pytest.fixture(scope="module")
def short(finished: FinishedJob) -> Survey:
    """The house, of which the mesh lacks some pixels at the right end of its facade A."""
    survey = read_survey(finished.folder)
    frame = find_facades(survey)[0].frame
    vertices = survey.mesh.vertices.copy()
    at = frame.to_drawing(vertices)
    vertices[at[:, 0] > 3.9] -= PULLED * survey.working_pixel * frame.x
    return replace(
        survey,
        mesh=replace(survey.mesh, vertices=vertices),
        normalised=replace(survey.normalised, vertices=survey.normalise(vertices)),
    )


@pytest.fixture(scope="module")
def photos(short: Survey) -> ElevationPhotos:
    painting = choose_painting(short.normalised, short.scene, short.masks)
    return elevation_photos(short, painting, Visibility(short, painting))


def right_end(survey: Survey, photos: ElevationPhotos | None) -> float:
    """Ground pixels from the right end of the outline of facade A to that of the house, 4 m long."""
    frame = find_facades(survey)[0].frame
    lines = draw_elevation(survey, survey_planes(survey), frame, photos=photos).lines
    ends = [line.points[:, 0] for line in lines if line.layer == OUTLINE and np.ptp(line.points[:, 0]) < 0.01]
    return (4.0 - max(float(x[0]) for x in ends)) / survey.working_pixel


def test_an_outline_that_the_mesh_has_too_short_comes_to_where_the_photos_have_it(
    short: Survey, photos: ElevationPhotos
) -> None:
    assert right_end(short, None) == pytest.approx(PULLED, abs=0.3)
    assert right_end(short, photos) == pytest.approx(0.0, abs=0.6)  # samples lie a quarter of a pixel apart


def test_an_outline_that_no_photo_shows_stays(short: Survey, photos: ElevationPhotos) -> None:
    nothing = EdgePhotos(photos.lines.views, photos.lines.photo, lambda k, points, _: np.zeros(len(points), bool))
    assert right_end(short, replace(photos, lines=nothing)) == pytest.approx(right_end(short, None), abs=1e-6)


@pytest.mark.parametrize("mesh", [0.0, 6.0], ids=["the eaves", "no overhang"])
def test_eaves_lie_where_the_photos_have_the_roof_end(finished: FinishedJob, mesh: float) -> None:
    """The wall of a mesh may stand behind the eaves and meet the roof above them; by so many ground pixels here."""
    survey = read_survey(finished.folder)
    frame = find_facades(survey)[0].frame
    at = frame.to_drawing(survey.mesh.vertices)
    front = at[:, 2] > at[:, 2].max() - 0.01
    inward = mesh * survey.working_pixel
    vertices = survey.mesh.vertices - front[:, None] * inward * frame.normal
    vertices[front & (at[:, 1] > at[front, 1].max() - 0.01), 2] += 1.2 / 1.5 * inward  # along the roof
    survey = replace(
        survey,
        mesh=replace(survey.mesh, vertices=vertices),
        normalised=replace(survey.normalised, vertices=survey.normalise(vertices)),
    )
    painting = choose_painting(survey.normalised, survey.scene, survey.masks)
    photos = elevation_photos(survey, painting, Visibility(survey, painting))
    for shown, above in ((None, 0.8 * mesh), (photos, 0.0)):
        lines = draw_elevation(survey, survey_planes(survey), frame, photos=shown).lines
        heights = [line.points[:, 1] for line in lines if line.layer == CREASE and np.ptp(line.points[:, 0]) > 3.5]
        off = (np.concatenate(heights) + float(frame.origin[2]) - HEIGHT_OF_EAVES) / survey.working_pixel
        np.testing.assert_allclose(off, above, atol=0.6)


def stroke_through(points: list[tuple[float, float]], ends: tuple[int, int]) -> Stroke:
    at = np.array(points, np.float64)
    spans = np.diff(at, axis=0)
    lengths = np.hypot(*spans.T)
    segments = [
        FittedSegment(0.5 * (a + b), span / length, float(length))
        for a, b, span, length in zip(at[:-1], at[1:], spans, lengths, strict=True)
    ]
    return Stroke(segments, at, ends)


def test_corners_lie_where_the_moved_lines_cross() -> None:
    square = stroke_through([(0, 0), (10, 0), (10, 8), (0, 8), (0, 0)], (0, 0))
    move_lines([square], [{0: Move(-Y, 0.5, X), 1: Move(X, 0.7, Y)}], {}, 0.1)
    np.testing.assert_allclose(square.points, [(0, -0.5), (10.7, -0.5), (10.7, 8), (0, 8), (0, -0.5)], atol=1e-6)


def test_the_place_where_strokes_end_moves_with_them() -> None:
    level, upright = stroke_through([(0, 0), (10, 0)], (1, 2)), stroke_through([(10, 0), (10, 8)], (2, 3))
    places = {1: np.zeros(2), 2: np.array([10.0, 0]), 3: np.array([10.0, 8])}
    move_lines([level, upright], [{0: Move(-Y, 0.5, X)}, {0: Move(X, 0.7, Y)}], places, 0.1)
    np.testing.assert_allclose(places[2], (10.7, -0.5), atol=0.1)  # it need only be near where they cross
    np.testing.assert_allclose(places[3], (10.7, 8), atol=0.1)
    np.testing.assert_allclose(level.points, [(0, -0.5), (10, -0.5)], atol=1e-6)


def test_two_nearly_parallel_lines_do_not_carry_their_place_away() -> None:
    one, other = stroke_through([(0, 0), (10, 0)], (1, 2)), stroke_through([(10, 0), (20, 0.2)], (2, 3))
    across, turned = np.array([[-0.02, 1.0], [-1.0, -0.02]]) / np.hypot(0.02, 1.0)
    places = {k: np.array([10.0 * (k - 1), 0]) for k in (1, 2, 3)}
    move_lines([one, other], [{0: Move(Y, 0.5, X)}, {0: Move(across, -0.5, -turned)}], places, 0.1)
    assert np.abs(places[2] - (10, 0)).max() < 0.6


PLATE = np.array([40.0, 110.0, 120.0, 40.0])  # left, top, right, bottom of a plate in z = 0, as the mesh has it
MAP = RegionMap(
    Grid(DrawingFrame("A", np.zeros(3), *np.eye(3)[:2], np.zeros(2), np.full(2, 150.0)), 1.0, 0.0, 150.0, 150, 150),
    np.zeros((150, 150), np.int32),
    np.zeros((1, 3)),
)
MAP.label[40:110, 40:120] = 1
SURVEY = SimpleNamespace(working_pixel=1.0, normalise=lambda points: points)


def photos_of(box: np.ndarray, shows=lambda points: np.ones(len(points), bool), fall: float = 0.0) -> EdgePhotos:
    """Photos of a bright plate with these sides, which moves before nothing; it falls to the right from x = 120 on."""
    views = cameras()

    def photo(number: int) -> np.ndarray:
        view = views[number]
        grid = np.stack(np.meshgrid(np.arange(view.width) + 0.5, np.arange(view.height) + 0.5), -1).reshape(-1, 2)
        ray = view.unproject(grid, np.ones(len(grid))) - view.centre
        height = view.centre[2] + fall * (view.centre[0] - 120)  # over the plate
        at = view.centre - ray * (height / (ray[:, 2] + fall * ray[:, 0]))[:, None]
        left, top, right, bottom = box
        inside = (at[:, 0] > left) & (at[:, 0] < right) & (at[:, 1] > bottom) & (at[:, 1] < top)
        return np.repeat(np.where(inside, 200, 40).astype(np.uint8).reshape(view.height, view.width, 1), 3, 2)

    return EdgePhotos(views, photo, lambda k, points, _: shows(points))


def side(points: list[tuple[float, float]], low: int = 0, high: int = 1) -> tuple[Stroke, Chain]:
    return stroke_through(points, (1, 2)), Chain(np.array(points, np.float64), low, high, (1, 2))


LEFT, RIGHT = side([(40, 50), (40, 100)]), side([(120, 50), (120, 100)])


def test_lines_move_to_the_edges_of_their_plane_whichever_side_it_is_on() -> None:
    moves = find_moves([LEFT, RIGHT], MAP, SURVEY, photos_of(PLATE + np.array([-2.0, 0, 3.0, 0])))
    np.testing.assert_allclose([moves[0][0].vector, moves[1][0].vector], [(-2, 0), (3, 0)], atol=0.3)
    np.testing.assert_allclose([moves[0][0].across, moves[1][0].across], [(1, 0), (-1, 0)], atol=1e-9)


def test_the_edge_is_found_between_the_samples() -> None:
    places = np.linspace(2, 3, 9)
    moves = [find_moves([RIGHT], MAP, SURVEY, photos_of(PLATE + np.array([0, 0, d, 0])))[0][0] for d in places]
    assert (np.array([move.vector[0] for move in moves]) - places).std() < 0.09  # of samples 0.25 apart


def test_lines_in_one_row_move_to_one_line() -> None:
    lower, upper = side([(120.3, 42), (120.3, 70)]), side([(120, 80), (120, 108)])
    moves = find_moves([lower, upper], MAP, SURVEY, photos_of(PLATE + np.array([0, 0, 2.0, 0])))
    ends = [120.3 + moves[0][0].vector[0], 120 + moves[1][0].vector[0]]
    assert ends[0] == pytest.approx(ends[1], abs=1e-9) and ends[0] == pytest.approx(122, abs=0.4)


def test_a_line_whose_plane_lies_on_both_sides_stays() -> None:
    across = side([(80, 50), (80, 100)], 1, 1)
    assert find_moves([across], MAP, SURVEY, photos_of(np.array([40.0, 110, 82, 40]))) == [{}]


@pytest.mark.parametrize(("height", "moved"), [(62.0, False), (90.0, True)])
def test_half_of_a_line_has_to_be_shown(height: float, moved: bool) -> None:
    photos = photos_of(PLATE + np.array([0, 0, 2.0, 0]), lambda points: points[:, 1] < height)
    assert (find_moves([RIGHT], MAP, SURVEY, photos) != [{}]) == moved


@pytest.mark.parametrize("change", [{"least": 60.0}, {"contrast": 1.0}, {"farthest": 1.0}])
def test_short_lines_faint_edges_and_far_ones_stay(change: dict[str, float]) -> None:
    photos = photos_of(PLATE + np.array([0, 0, 2.0, 0]))
    assert find_moves([RIGHT], MAP, SURVEY, photos, replace(PhotoLineOptions(), **change)) == [{}]


@pytest.mark.parametrize(("distance", "moved"), [(7.7, True), (-7.7, True), (8.3, False), (-8.3, False)])
def test_edges_are_looked_for_as_far_as_they_may_lie(distance: float, moved: bool) -> None:
    moves = find_moves([RIGHT], MAP, SURVEY, photos_of(PLATE + np.array([0, 0, distance, 0])))
    assert moves == (
        [{0: Move(pytest.approx(-X), pytest.approx(-distance, abs=0.2), pytest.approx(Y))}] if moved else [{}]
    )


@pytest.mark.parametrize(("overhang", "moved"), [(13.7, True), (2.0, True), (14.4, False)])
def test_eaves_are_looked_for_farther_out(overhang: float, moved: bool) -> None:
    roof = replace(MAP, slope=np.array([[-0.5, 0.0, 60.0]]))  # it falls to the right
    photos = photos_of(PLATE + np.array([0, 0, overhang, 0]), fall=0.5)
    (found,) = find_moves([RIGHT], roof, SURVEY, photos)
    assert bool(found) == moved
    if moved:
        assert found[0].vector == pytest.approx([overhang, 0.0], abs=0.3)


def test_on_the_mesh_a_photo_shows_what_its_mask_calls_building_and_beyond_the_mesh_all() -> None:
    """A square of 2 x 2 that fills the right half of the mask, seen from 8 before it."""
    camera = analytic_camera((0.0, -8.0, 0.0))
    corners = np.array([[-1.0, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]])
    mesh = Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32), np.zeros((4, 3), np.uint8))
    label = np.zeros((camera.height, camera.width), np.uint8)
    label[:, camera.width // 2 :] = 1
    survey = SimpleNamespace(normalised=mesh, masks=SimpleNamespace(labels=[label]))
    photos = line_photos(survey, SimpleNamespace(views=[camera], chosen=[0]))  # type: ignore[arg-type]
    on_mesh, behind, beside = np.array([[0.5, 0, 0], [-0.5, 0, 0]]), np.array([[0.5, 1, 0]]), np.array([[-2.0, 0, 0]])
    front = np.array([0.0, -1, 0])
    shown = photos.shows(0, np.concatenate([on_mesh, behind, beside, [[90.0, 0, 0]]]), front)
    assert shown.tolist() == [True, False, False, True, False]
    assert not photos.shows(0, on_mesh, -front).any()
    assert not photos.shows(0, on_mesh, np.array([1.0, -0.05, 0])).any()
