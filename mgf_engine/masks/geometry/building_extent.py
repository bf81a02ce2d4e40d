# SPDX-License-Identifier: GPL-3.0-or-later
"""Extent of the building in each photo, by projecting its sparse points and the columns below them.

Columns extend each point down to the ground, since walls reach the ground even where bushes hide their foot. For each
photo this gives maps:

* *core*: pixels whose ray hits the building. Background there is an occluder, not empty space.
* *reach*: the core with a margin, into which the surface around the points extends as a plane.
* *away*: distance of a pixel from *reach*; a few point spacings away there is no building.
* *ground first*: pixels whose ray hits the ground before the building.
* *hidden*: pixels where points that this photo should observe are not observed.
* *behind*: pixels where points of something else are nearer to the camera than the building.
* *hull*: convex hull of the core; outside of it is no gap between points of the building.
* *near*: depth at which the ray hits the building, infinite if it does not.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.masks.geometry.ground_plan import GroundPlan, GroundPlanOptions
from mgf_engine.masks.geometry.ground_plane import GroundPlane
from mgf_engine.masks.geometry.overhangs import OverhangOptions, Overhangs
from mgf_engine.masks.geometry.point_features import PointFeatures
from mgf_engine.masks.geometry.point_surface import Columns, Map, SurfaceOptions, make_surface
from mgf_engine.masks.geometry.point_visibility import PointVisibility
from mgf_engine.masks.image_ops import disc, fill_mask_holes
from mgf_engine.model.pixels import pixel_at
from mgf_engine.model.scene import Scene, View
from mgf_engine.options.algorithms import parameter
from mgf_engine.scene.gravity import GravityOptions, looking_down

#: Maps are drawn on a photo of about this longest side.
MAP_SIDE = 250


@dataclass(frozen=True)
class ExtentOptions:
    """Options of the building's extent in the photos."""

    fine: float = parameter(1.25, "Minimum distance of samples on the maps of the nearest photos", "px", low=0.1)
    close_by: float = parameter(
        10.0, "Percentile of the photos' distances up to which photos are the nearest", high=100
    )
    core: float = parameter(1.5, "Size of the gaps between points that are closed", "point spacings")
    expected: float = parameter(8.0, "Number of expected points in the window in which they are counted", low=0.1)
    hull_piece: float = parameter(0.1, "Minimum share of the core of a piece that widens the convex hull", high=1)
    enough_expected: float = parameter(
        0.6, "Share of that number from which the observed points are compared with the expected ones", high=1
    )
    hidden_below: float = parameter(
        0.2,
        "Share of the expected points that are observed, over that of the whole photo, below which a pixel is hidden",
        high=1,
    )
    hidden_blur: tuple[float, float] = parameter(
        (5.0, 14.0), "Standard deviation of the smallest and the largest window, on the map", "px", low=0.1
    )
    plan: GroundPlanOptions = GroundPlanOptions()
    overhangs: OverhangOptions = OverhangOptions()
    surface: SurfaceOptions = SurfaceOptions()
    gravity: GravityOptions = GravityOptions()


@dataclass(frozen=True)
class ViewRegions:
    """Maps of one photo at reduced size, bool [h, w]; the module's docstring defines them."""

    core: Map
    reach: Map
    away: NDArray[np.float32]  # [h, w], in spacings of the points as they appear in this photo
    ground_first: Map
    hidden: Map
    behind: Map
    hull: Map
    near: NDArray[np.float32]  # [h, w], normalised units


class BuildingExtent:
    """Extent of the building in the photos of a scene.

    Args:
        scene: photos, cameras and sparse points.
        features: spacing, flatness and height of the points.
        keep: points of the building, bool [P].
        ground: the plane below it; None takes the level of the lowest points.
        visibility: the points that each photo observed and should observe.
        others: points of other objects that stand on the ground, bool [P]; None for none.
        options: of the maps.
    """

    def __init__(
        self,
        scene: Scene,
        features: PointFeatures,
        keep: Map,
        ground: GroundPlane | None,
        visibility: PointVisibility,
        others: Map | None = None,
        options: ExtentOptions = ExtentOptions(),
    ) -> None:
        self.options = options
        keep = features.supported(keep)
        self.scene, self.keep, self.ground = scene, keep, ground
        self.visibility = visibility
        fine = self.options.fine * _map_pixel(scene, keep, self.options)
        columns, self.plan = None, None
        if keep.any():
            self.plan = GroundPlan.of(scene.points[keep], features.up, options.plan)
            spacing = float(np.median(features.spacing[keep]))
            walls_seen = looking_down(scene.views, options.gravity) is None
            over = Overhangs(scene.points[keep], features.up, spacing, walls_seen, options.overhangs)
            columns = Columns(over, ground)
        self.columns = make_surface(scene, features, keep, False, columns, fine, options.surface)
        self.body = make_surface(scene, features, keep, True, columns, fine, options.surface)
        others = np.zeros(len(keep), bool) if others is None else features.supported(others)
        self.others = make_surface(scene, features, others, True, None, fine, options.surface)
        self.floor = ground or _lowest(scene, features, keep)

    def view_regions(self, index: int) -> ViewRegions:
        """Compute all maps of view ``index``."""
        view = self.scene.views[index]
        h, w = map_size(view)
        if not len(self.columns.samples):
            empty, nowhere = np.zeros((h, w), bool), np.full((h, w), np.inf, np.float32)
            return ViewRegions(empty, empty, empty.astype(np.float32), empty, empty, empty, empty, nowhere)
        near = self.body.depth(view, h, w)
        places, _, radius = self.columns.project(view, h, w)
        first, through = self._ground_first(view, near, h, w)
        core = _close(places, self.options.core * radius, h, w) | through
        unit = max(0.02 * MAP_SIDE, float(np.median(radius))) if len(radius) else 1.0
        reach = core | np.isfinite(near)
        outside = (~fill_mask_holes(reach)).astype(np.uint8)
        away = np.asarray(cv2.distanceTransform(outside, cv2.DIST_L2, 3) / unit, np.float32)
        behind = self.others.depth(view, h, w) + self.body.tolerance < near
        hidden, hull = self._hidden(index, h, w), _convex_hull(core, self.options.hull_piece)
        return ViewRegions(core, reach, away, first, hidden, behind, hull, near)

    def within(self, index: int, place: ViewRegions) -> NDArray[np.bool_]:
        """Find the observations of view ``index`` that lie on the building's surface or behind it, bool [N].

        A point behind the surface that the building's points span is in a recess or a window, not in front of it.
        """
        view, (h, w) = self.scene.views[index], place.core.shape
        here = self.scene.observations(index)
        y, x = pixel_at((h, w), self.scene.track_uv[here] * (w / view.width, h / view.height))
        depth = view.project(self.scene.points[self.visibility.owner[here]])[1]
        return (place.core & ~place.ground_first)[y, x] & (depth > place.near[y, x] - self.body.tolerance)

    def _ground_first(self, view: View, near: NDArray[np.float32], h: int, w: int) -> tuple[Map, Map]:
        """Find the pixels whose rays meet the ground before the building's points, [h, w] each.

        Returns:
            Those that meet it beside the ground plan, and those within it: they have passed through a wall without
            points.
        """
        if self.floor is None:
            return np.zeros((h, w), bool), np.zeros((h, w), bool)
        depth = self.floor.depth(view, h, w)
        # The plane may be off by its thickness: along the ray that is more the flatter the ray.
        above = float(self.floor.height(view.centre[None])[0])
        margin = depth * min(0.5, 1.5 * self.floor.thickness / max(above, 1e-9))
        first = np.isfinite(depth) & (depth + margin < near)
        through = np.zeros((h, w), bool)
        if self.plan is not None and not self.plan.holds(view.centre[None])[0]:
            # If the plane lay a little higher, a flat ray would meet it well before the wall.
            pixels = (np.argwhere(first)[:, ::-1] + 0.5) * (view.width / w, view.height / h)
            hits = (view.unproject(pixels, away) for away in (depth[first], depth[first] - margin[first]))
            through[first] = np.all([self.plan.holds(points) for points in hits], axis=0)
        return first & ~through, through

    def _hidden(self, index: int, h: int, w: int) -> Map:
        """Find the map pixels where cameras close by observed many accepted points and this photo hardly any."""
        view, points = self.scene.views[index], self.scene.points
        observed = self.visibility.observed(index)
        rows = self.visibility.expected(index)
        rows = rows[self.keep[rows]]
        uv, depth = view.project(points[rows])
        uv = uv * (w / view.width, h / view.height)
        here = (depth > 0) & (uv >= 0).all(1) & (uv[:, 0] < w) & (uv[:, 1] < h)
        if not here.any():
            return np.zeros((h, w), bool)
        x, y = np.floor(uv[here]).astype(np.int64).T
        seen = observed[rows[here]]
        counts = np.stack([np.bincount(y * w + x, weight, h * w).reshape(h, w) for weight in (None, seen)])
        counts = counts.astype(np.float32)
        # As wide a window as it takes to expect enough points; 4 pi sigma^2 is the area it weighs like a disc.
        covered = float((cv2.dilate(counts[0], np.ones((15, 15), np.uint8)) > 0).sum())
        sigma = float(
            np.clip(np.sqrt(self.options.expected * covered / (4 * np.pi * len(x))), *self.options.hidden_blur)
        )
        local = [cv2.GaussianBlur(c, (0, 0), sigma) * (4 * np.pi * sigma**2) for c in counts]
        usual = float(seen.mean())
        enough = local[0] > self.options.enough_expected * self.options.expected
        return enough & (local[1] < self.options.hidden_below * usual * local[0])


def _map_pixel(scene: Scene, keep: Map, options: ExtentOptions) -> float:
    """Return the side of a map pixel at the kept points, in the photos taken from closest by; normalised units."""
    if not keep.any():
        return 0.0
    middle = np.median(scene.points[keep], axis=0)
    sides = [np.linalg.norm(v.centre - middle) * v.width / (v.fx * map_size(v)[1]) for v in scene.views]
    return float(np.percentile(sides, options.close_by))


def map_size(view: View) -> tuple[int, int]:
    """Return the height and width of the reduced maps of a view."""
    factor = min(1.0, MAP_SIDE / max(view.width, view.height))
    return max(1, round(view.height * factor)), max(1, round(view.width * factor))


def _lowest(scene: Scene, features: PointFeatures, keep: NDArray[np.bool_]) -> GroundPlane | None:
    """Return the level plane through the lowest kept points: no part of the building is seen below it."""
    if keep.sum() < 10:
        return None
    level = float(np.percentile(scene.points[keep] @ features.up, 0.5))
    return GroundPlane(features.up, level, float(np.median(features.spacing[keep])))


def _convex_hull(mask: Map, share: float) -> Map:
    """Return the convex hull of the larger pieces of a mask [h, w], [h, w]; small ones may be of another building."""
    result = np.zeros(mask.shape, np.uint8)
    _, piece, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    large = stats[:, cv2.CC_STAT_AREA] >= share * mask.sum()
    large[0] = False
    pixels = cv2.findNonZero(large[piece].astype(np.uint8))
    if pixels is not None:
        cv2.fillConvexPoly(result, cv2.convexHull(pixels), 1)
    return result > 0


def _close(places: NDArray[np.int32], radius: NDArray, h: int, w: int) -> Map:
    """Fill the samples' pixels (y * w + x) and the gaps between them, without reaching beyond the outermost ones."""
    spots = np.zeros((h, w), np.uint8)
    spots.reshape(-1)[places] = 1
    if not len(radius):
        return spots.astype(bool)
    kernel = disc(round(max(1.0, float(np.percentile(radius, 80)))))
    size = len(kernel)  # of a border: at the frame, too, nothing is filled beyond the samples
    padded = cv2.copyMakeBorder(spots, size, size, size, size, cv2.BORDER_REPLICATE)
    return cv2.morphologyEx(padded, cv2.MORPH_CLOSE, kernel)[size : size + h, size : size + w].astype(bool)
