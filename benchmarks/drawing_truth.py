# SPDX-License-Identifier: GPL-3.0-or-later
"""How true sections and facade orthophotos are: ``python -m benchmarks.drawing_truth JOB...``.

Each job is of a generated scene and has its mesh. Sections cut 1.2 m above the ground, at 0.4 of the height, and across
the first facade; their areas are compared with what the true mesh encloses there. For orthophotos, corners of openings
(where they meet the wall) are projected by the true cameras into the photo that shows each best; the ray of the job's
camera through that pixel meets the job's mesh where the orthophoto shows the corner.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
import trimesh
from numpy.typing import NDArray
from shapely import LineString, Polygon, box, unary_union

from benchmarks.buildings import BUILDINGS
from benchmarks.job_table import print_job_table
from benchmarks.openings import DEEP, FACING, true_openings
from mgf_engine.drawings.facades import FacadeOptions, find_facades
from mgf_engine.drawings.ground import find_ground_level
from mgf_engine.drawings.load import UpOptions, read_survey
from mgf_engine.drawings.model import DrawingFrame, Facade, Survey
from mgf_engine.drawings.orthophoto import Visibility
from mgf_engine.drawings.section import SectionOptions, cut
from mgf_engine.drawings.section_planes import section_frames
from mgf_engine.evaluation.surfaces import Surface, read_surface
from mgf_engine.jobs.job_folder import with_algorithms_of_job
from mgf_engine.model.scene import View
from mgf_engine.texture.painting import Painting
from mgf_engine.texture.texture_pipeline import TextureOptions, choose_painting

Array = NDArray[np.float64]
_GAP = 0.3  # metres bridged in upright sections of the true mesh: its walls end below the roof
_BESIDE = 0.12  # metres from a corner to the wall beside it
_REVEAL = 0.6  # metres, deepest reveal of an opening


def enclosed_area(at: Array, faces: NDArray[np.int64], low: float | None = None) -> float:
    """Return the area that a mesh encloses in the plane z = 0.

    Args:
        at: vertices in drawing coordinates and before the plane, [V, 3].
        faces: of the mesh, [F, 3].
        low: height at which an upright section ends and is closed; None for a level one.
    """
    mesh = trimesh.Trimesh(at, faces, process=True)
    segments = trimesh.intersections.mesh_plane(mesh, [0, 0, 1], [0, 0, 0])[:, :, :2]
    half = 0.001 if low is None else 0.5 * _GAP
    body = unary_union([LineString(s).buffer(half) for s in segments if np.hypot(*(s[1] - s[0])) > 1e-9])
    if low is not None:
        left, _, right, top = body.bounds
        above = body.intersection(box(left, low, right, top))
        left, _, right, _ = above.intersection(box(left, low, right, low + 0.5)).bounds
        body = unary_union([above, LineString([(left + half, low), (right - half, low)]).buffer(half)])
    return float(sum(Polygon(part.exterior).buffer(-half).area for part in getattr(body, "geoms", [body])))


def section_errors(
    survey: Survey, truth: Surface, facades: list[Facade], options: SectionOptions = SectionOptions()
) -> list[tuple[str, float]]:
    """Return for each section its name and by which share its area is too large.

    Args:
        survey: of the job.
        truth: the true mesh.
        facades: of the job.
        options: of the sections.
    """
    ground = find_ground_level(survey, facades)
    height = float(survey.mesh.vertices[:, 2].max()) - ground.height
    wanted = ["z=1.2", f"z={0.4 * height:.2f}", f"{facades[0].name}={0.45 * facades[0].frame.size[0]:.2f}"]
    found = []
    for frame in section_frames(survey, facades, wanted, ground.height, options):
        made = cut(survey, frame, options)
        upright = abs(float(frame.normal[2])) < 0.5
        low = min((area.bounds[1] for area in made.drawing.areas), default=float(frame.low[1])) if upright else None
        true = enclosed_area(frame.to_drawing(survey.local(truth.vertices)), truth.faces, low)
        found.append((frame.name, made.area / true - 1))
    return found


def wall_corners(openings: Sequence[Array], toward: Array, truth: Surface) -> list[Array]:
    """Return the corners [3] of the openings that face a direction [3] and are not hidden, on the wall around them."""
    found = []
    for corners in openings:
        normal, middle = np.cross(corners[1] - corners[0], corners[2] - corners[0]), corners.mean(0)
        if normal @ toward < FACING * np.linalg.norm(normal) or _depth(truth, middle, toward) > DEEP:
            continue
        for corner in corners:
            out = (corner - middle) / np.linalg.norm(corner - middle)
            before = _depth(truth, corner + _BESIDE * out, toward)
            if 0 <= before < _REVEAL:
                found.append(corner + before * toward)
    return found


def _depth(truth: Surface, point: Array, toward: Array) -> float:
    """Return how far the first surface seen against a direction stands before a point; -1 where there is none."""
    begin = point + 50.0 * toward
    face, share = truth.first_hits(begin, (-51.0 * toward)[None])
    return 50.0 - 51.0 * float(share[0]) if face[0] >= 0 else -1.0


def orthophoto_offsets(
    survey: Survey,
    facades: Sequence[Facade],
    painting: Painting,
    scene: Path,
    openings: Sequence[Array],
    truth: Surface,
) -> Array:
    """Return by how much orthophotos show corners of openings to the right and above their place, ground pixels [n, 2].

    Args:
        survey: of the job.
        facades: of the job.
        painting: the photos that paint its orthophotos.
        scene: folder with the true cameras.
        openings: corners of each, [4 or more, 3].
        truth: the true mesh.
    """
    visibility, mesh = Visibility(survey, painting), Surface(survey.mesh.vertices, survey.mesh.faces.astype(np.int64))
    true = {Path(i.name).stem: i for i in pycolmap.Reconstruction(str(scene / "sparse_truth")).images.values()}
    turn = survey.turn @ survey.georeference.rotation
    offsets = []
    for frame in (facade.frame for facade in facades):
        normal = (frame.normal @ (turn @ survey.scene.to_normalised.rotation.T))[None]
        for corner in wall_corners(openings, frame.normal @ turn, truth):
            at = survey.normalise(survey.local(corner[None]))
            sizes = [
                float(visibility(k, at, normal)[0][0]) * _sees(true[Path(view.name).stem], corner, truth)
                for k, view in enumerate(painting.views)
            ]
            best = int(np.argmax(sizes))
            view = painting.views[best]
            shown = _shown_at(survey, view, true[Path(view.name).stem], corner, mesh) if sizes[best] > 0 else None
            if shown is not None:
                offsets.append(_off(frame, survey.local(corner[None])[0], shown) / survey.working_pixel)
    return np.array(offsets).reshape(-1, 2)


def _sees(image: pycolmap.Image, corner: Array, truth: Surface) -> bool:
    """Tell whether nothing stands between a true camera and a corner."""
    begin = image.projection_center()
    face, share = truth.first_hits(begin, (corner - begin)[None])
    return bool(face[0] < 0 or share[0] > 0.995)


def _shown_at(survey: Survey, view: View, image: pycolmap.Image, corner: Array, mesh: Surface) -> Array | None:
    """Return the point of the job's mesh [3] that has the colours of a true corner; None beside the mesh."""
    camera = image.camera
    assert camera is not None
    pixel = np.array(camera.img_from_cam(image.cam_from_world() * corner))
    x, y = pixel * (view.width / camera.width, view.height / camera.height)
    ray = view.rotation.T @ np.array([(x - view.cx) / view.fx, (y - view.cy) / view.fy, 1.0])
    begin, end = survey.local(survey.scene.to_normalised.invert(np.stack([view.centre, view.centre + 50.0 * ray])))
    face, share = mesh.first_hits(begin, (end - begin)[None])
    return begin + float(share[0]) * (end - begin) if face[0] >= 0 else None


def _off(frame: DrawingFrame, corner: Array, shown: Array) -> Array:
    one, other = frame.to_drawing(np.stack([corner, shown]))[:, :2]
    return np.asarray(other - one)


def row(job: Path, scene: Path, spec: dict[str, Any]) -> list[str]:
    """Return the errors of a job's sections, and how many corners its orthophotos show how far off.

    Raises:
        BadInput: the job has no mesh.
    """
    truth, config = read_surface(scene / "truth.ply"), with_algorithms_of_job(job, {})
    survey = read_survey(job, options=config.algorithm(UpOptions))
    facades = find_facades(survey, config.algorithm(FacadeOptions))
    errors = section_errors(survey, truth, facades, config.algorithm(SectionOptions))
    areas = ", ".join(f"{name} {100 * error:+.2f} %" for name, error in errors)
    if any(spec["lens"]):  # a job's photos are undistorted, the true cameras are not
        return [areas, *["–"] * 4]
    options = config.algorithm(TextureOptions)
    painting = choose_painting(survey.normalised, survey.scene, survey.masks, options=options)
    openings = true_openings(BUILDINGS[spec["building"]](spec["wall"]))
    off = orthophoto_offsets(survey, facades, painting, scene, openings, truth)
    away = np.hypot(*off.T)
    shares = [f"{100 * (away <= most).mean():.0f} %" for most in (1, 2)]
    return [areas, str(len(away)), *shares, f"{np.median(away):.2f}"]


def main(argv: Sequence[str] | None = None) -> int:
    """Print a table, a row for each job."""
    header = ("areas of sections", "corners", "within one pixel", "within two", "median, pixels")
    return print_job_table("python -m benchmarks.drawing_truth", __doc__, header, row, argv)


if __name__ == "__main__":
    raise SystemExit(main())
