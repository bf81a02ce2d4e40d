# SPDX-License-Identifier: GPL-3.0-or-later
"""The named synthetic scenes as data: every control of the generator, one table."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

from benchmarks.camera_path import Ring
from mgf_engine.errors import BadInput


@dataclass(frozen=True)
class SceneSpec:
    """Everything that decides how a synthetic scene looks; two equal specs give the same pictures.

    Attributes:
        building, wall: key of :data:`benchmarks.buildings.BUILDINGS` and its wall material.
        roof: material of everything that is an element ``roof.*``, instead of the building's own.
        photos, width, aspect, field_of_view: count, pixels, width over height, horizontal degrees.
        rings, arc, nadir: the flight, see :mod:`benchmarks.camera_path`; of each ring only the arc is flown, degrees
            from east over north.
        texture_strength: 1 as designed, 0 plain colours.
        trees, trees_in_front, neighbours, cars: surroundings; trees in front hide parts of the building.
        sun_elevation, sun_azimuth: degrees; sun_strength, sky_strength: light in Blender's units.
        exposure, exposure_spread: mean and standard deviation of the photos' exposure in stops.
        exposure_drift: stops that the exposure swings up and down by over the flight, in development, so that it clips.
        highlights: stops by which photos are overexposed in development; what is brighter than white clips.
        white_balance: stops that red and blue swing by over the flight.
        lens: k1, k2, p1, p2 of COLMAP's camera model OPENCV; all 0 is a pinhole.
        vignetting: stops that the corners lose.
        motion_blur: mean length of the blur in pixels; jpeg: quality of the files.
        noise: standard deviation of the sensor noise in grey values of 255.
        pose_error: standard deviation of the error put on true camera centres in ``sparse_truth``, metres.
        pixel_filter: width of the renderer's filter in pixels; below 1 fine patterns turn into moire.
        samples, denoiser: Cycles samples per pixel; what follows, ``accurate``, ``fast`` (half the time) or ``none``,
            for patterns as fine as a pixel are noise to a denoiser.
        held_out: for reporting only; nothing may be tuned on it.
    """

    building: str = "town_hall"
    wall: str = "brick"
    roof: str = ""
    photos: int = 30
    width: int = 480
    aspect: float = 1.5
    field_of_view: float = 58.0
    rings: tuple[Ring, ...] = (Ring(0.55, 9.0, 24.0), Ring(0.45, 23.0, 21.0))
    arc: tuple[float, float] = (0.0, 360.0)
    nadir: tuple[float, float, float] | None = None  # height, half extent x, half extent y
    texture_strength: float = 1.0
    trees: int = 8
    trees_in_front: int = 0
    neighbours: int = 3
    cars: int = 3
    sun_elevation: float = 42.0
    sun_azimuth: float = -62.0
    sun_strength: float = 3.8
    sky_strength: float = 0.12
    exposure: float = 1.0
    exposure_spread: float = 0.0
    exposure_drift: float = 0.0
    highlights: float = 0.0
    white_balance: float = 0.0
    lens: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    vignetting: float = 0.0
    motion_blur: float = 0.0
    jpeg: int = 95
    noise: float = 1.0
    pose_error: float = 0.0
    samples: int = 12
    denoiser: str = "accurate"
    pixel_filter: float = 1.5
    seed: int = 0
    held_out: bool = False

    @property
    def height(self) -> int:
        """Pixels."""
        return round(self.width / self.aspect)


_TWO_ORBITS = (Ring(0.5, 10.0, 30.0), Ring(0.5, 26.0, 25.0))
_LARGE = SceneSpec(photos=40, width=750, rings=_TWO_ORBITS)

SCENES: dict[str, SceneSpec] = {
    # Small and quick: the demonstration, and what continuous integration can afford.
    "demo": SceneSpec(),
    "smoke": SceneSpec(photos=24, width=320, rings=(Ring(1.0, 13.0, 22.0),), trees=3, neighbours=1, cars=1, samples=8),
    # A brick town hall, 40 photos on two orbits, ground pixel about 6 cm.
    "townhall40": _LARGE,
    # Low flight around a detailed building with a hollow steel frame.
    "steel_frame_hall": SceneSpec(
        building="steel_frame", photos=146, width=750,
        rings=(Ring(0.4, 7.0, 22.0, 9.0), Ring(0.35, 17.0, 20.0, 9.0), Ring(0.25, 30.0, 16.0, 8.0)),
        trees=10, trees_in_front=2, neighbours=4, cars=4, exposure_spread=0.1, noise=1.5, seed=11,
    ),
    # High flight over a brick ensemble: the building is small in the pictures.
    "brick_ensemble": SceneSpec(
        building="town_hall", photos=147, width=750, field_of_view=50.0,
        rings=(Ring(0.35, 40.0, 34.0), Ring(0.3, 32.0, 44.0)), nadir=(58.0, 26.0, 20.0),
        trees=14, neighbours=6, cars=6, sun_azimuth=-110.0, exposure_spread=0.08, noise=1.5, seed=12,
    ),
    # Hard on the losses: large plain walls.
    "white_block": replace(_LARGE, building="flat_block", wall="white", seed=13),
    # Hard on the masks: trees between the camera and the walls, neighbours of the same brick.
    "trees_in_front": replace(_LARGE, trees_in_front=7, neighbours=5, exposure_spread=0.15, seed=14),
    "tower": replace(
        _LARGE, building="tower", seed=15,
        rings=(Ring(0.4, 10.0, 34.0, 14.0), Ring(0.3, 24.0, 32.0, 17.0), Ring(0.3, 42.0, 28.0, 18.0)),
    ),
    "curved_hall": replace(
        _LARGE, building="curved_hall", rings=(Ring(0.5, 9.0, 26.0), Ring(0.5, 26.0, 20.0)), seed=16,
    ),
}  # fmt: skip
# What `mgf bench surfaces` is measured on: materials and shapes that are hard on photogrammetry, each half of them with
# the faults of a real camera. Those that are held out are for reporting only: nothing may be tuned on them.
_SMALL = SceneSpec(
    photos=36, width=500, samples=6, denoiser="fast", rings=(Ring(0.5, 9.0, 24.0), Ring(0.5, 22.0, 20.0))
)
_FAULTY: dict[str, Any] = {
    "lens": (-0.11, 0.025, 0.0008, -0.0006), "vignetting": 0.5, "motion_blur": 0.5, "noise": 2.0, "jpeg": 90,
    "exposure_drift": 0.25, "highlights": 0.3, "white_balance": 0.1,
}  # fmt: skip
#: Straight down at about 7 cm a pixel from 6 x 5 places, which overlap by 75 % along and 70 % across.
_NADIR: dict[str, Any] = {
    "photos": 30, "width": 530, "field_of_view": 66.0, "rings": (), "nadir": (38.0, 27.0, 18.0), "samples": 6,
    "denoiser": "fast", "cars": 4, "trees": 10,
}  # fmt: skip
SURFACES: dict[str, SceneSpec] = {
    # Clean walls and a roof of one colour, ten metres wide: nothing but edges to go by.
    "white_house": replace(
        _LARGE, building="plain_house", wall="clean_white", exposure=1.2, highlights=0.4, neighbours=2, seed=31,
        samples=5, denoiser="fast", rings=(Ring(0.5, 9.0, 25.0, 5.0), Ring(0.5, 23.0, 21.0, 4.0)),
    ),
    "ochre_house": replace(
        _SMALL, building="plain_house", wall="clean_ochre", roof="clean_grey", sun_azimuth=-120.0, trees_in_front=2,
        seed=32, held_out=True, **_FAULTY,
    ),
    "warehouse": replace(_SMALL, building="warehouse", seed=33, **_FAULTY),
    "half_timber": replace(
        _SMALL, building="half_timber", wall="clay", rings=(Ring(0.6, 7.0, 17.0, 5.0), Ring(0.4, 18.0, 15.0, 5.0)),
        seed=34, held_out=True, **_FAULTY,
    ),
    "slate_villa": replace(_SMALL, building="slate_villa", wall="slate", seed=35),
    "sheet_hall": replace(_SMALL, building="sheet_hall", wall="shiny_sheet", neighbours=2, seed=36, **_FAULTY),
    "sheet_hall_low_sun": replace(
        _SMALL, building="sheet_hall", wall="shiny_sheet", sun_elevation=24.0, sun_azimuth=70.0, seed=37, held_out=True,
    ),
    "glass_office": replace(
        _SMALL, building="glass_office", wall="mirror_glass", seed=38, held_out=True,
        rings=(Ring(0.5, 12.0, 28.0, 9.0), Ring(0.5, 27.0, 24.0, 8.0)), **_FAULTY,
    ),
    "balcony_tower": replace(
        _SMALL, building="balcony_tower", wall="raw_concrete", aspect=2 / 3, width=400,
        rings=(Ring(0.5, 12.0, 28.0, 12.0), Ring(0.5, 28.0, 25.0, 14.0)), seed=39,
    ),
    "chapel": replace(_SMALL, building="chapel", wall="sandstone", trees_in_front=2, seed=40, held_out=True, **_FAULTY),
    # Low among trees, seen from the street and both sides only.
    "bungalow": replace(
        _SMALL, building="bungalow", wall="cladding", trees=18, trees_in_front=6, rings=(Ring(1.0, 1.9, 15.0, 2.6),),
        arc=(-200.0, 20.0), seed=41, **_FAULTY,
    ),
    "nadir_tiles": SceneSpec(building="town_hall", seed=42, **_NADIR),
    # Shingles half as fine as a pixel can show, sampled at its middle: moire, another in each photo.
    "nadir_shingles": SceneSpec(
        building="slate_villa", wall="clean_white", roof="shingles", pixel_filter=0.3, seed=43, held_out=True,
        **{**_NADIR, "denoiser": "none", "samples": 8},
    ),
}  # fmt: skip
SCENES |= SURFACES
# What masks are measured on (`mgf bench masks`): small pictures; trees, cars and houses of the same colour around. The
# flights with 20 photos are thinner than anybody should fly: few points, and 36 degrees from photo to photo.
_MASKS = replace(_LARGE, width=480, samples=8)
SCENES |= {
    "masks_trees": replace(_MASKS, photos=24, trees_in_front=7, neighbours=5, exposure_spread=0.15, seed=14),
    "masks_block": replace(_MASKS, photos=36, building="flat_block", wall="white", trees_in_front=4, seed=13),
    "masks_hall": replace(SCENES["curved_hall"], photos=36, width=480, samples=8, trees_in_front=3, cars=6),
}
# As `nadir_shingles`, for tuning: hardly any sparse point lies on the roof, and the masks must do without.
SCENES["nadir_slate"] = replace(SURFACES["nadir_shingles"], building="plain_house", seed=44, held_out=False)
# A court between two wings, and walls that few photos see.
SCENES["nadir_wings"] = SceneSpec(building="brick_wings", wall="brick", seed=48, **_NADIR)
# As `glass_office`, for tuning: panes of two by four metres that mirror sky, trees and cars.
SCENES["glass_showroom"] = replace(
    _SMALL, building="glass_showroom", wall="mirror_glass", seed=45, sun_azimuth=-20.0,
    rings=(Ring(0.55, 6.0, 24.0, 4.0), Ring(0.45, 18.0, 21.0, 4.0)), **_FAULTY,
)  # fmt: skip
# Curtain wall around a yard, in whose panes sky and the other wing are mirrored.
SCENES["glass_block"] = replace(
    _SMALL, building="glass_block", wall="mirror_glass", seed=46, sun_azimuth=130.0, sun_elevation=38.0,
    rings=(Ring(0.5, 5.0, 27.0, 5.0), Ring(0.5, 19.0, 24.0, 5.0)), **_FAULTY,
)  # fmt: skip
# Tall and narrow: most of what is seen are panes, and sky is in most of these.
SCENES["glass_tower"] = replace(
    _SMALL, building="glass_tower", wall="mirror_glass", aspect=2 / 3, width=400, seed=47, sun_azimuth=60.0,
    rings=(Ring(0.5, 9.0, 34.0, 14.0), Ring(0.5, 27.0, 31.0, 15.0)), **_FAULTY,
)  # fmt: skip
# From within, as a person stands there: what lies behind walls and roofs is never seen, and sky is between the wings.
SCENES["plaster_court"] = replace(
    _SMALL, building="plaster_court", wall="plaster", photos=32, width=560, field_of_view=66.0, cars=0, trees=6,
    rings=(Ring(0.5, 1.8, -7.5, 4.6), Ring(0.5, 2.6, -5.0, 5.2)), seed=49, **_FAULTY,
)  # fmt: skip
# Windows and doors with round, segmental and level heads; the ground pixel is about 4 cm.
SCENES["orangery"] = replace(
    _SMALL, building="orangery", wall="brick", photos=30, trees=5, neighbours=1, cars=1, sun_azimuth=-100.0, seed=50,
    rings=(Ring(0.6, 6.0, 17.0, 4.5), Ring(0.4, 15.0, 14.0, 4.0)),
)  # fmt: skip
# Mixed materials and shapes that no other scene has: sawtooth roof, dome and columns, cantilever, solar panels.
SCENES["factory"] = replace(
    _SMALL, building="factory", wall="shiny_sheet", seed=51, sun_azimuth=-140.0,
    rings=(Ring(0.5, 8.0, 27.0, 5.0), Ring(0.5, 22.0, 22.0, 5.0)), **_FAULTY,
)  # fmt: skip
SCENES["rotunda"] = replace(
    _SMALL, building="rotunda", wall="plaster", seed=52, trees_in_front=2, sun_azimuth=-40.0,
    rings=(Ring(0.5, 7.0, 25.0, 6.0), Ring(0.5, 22.0, 21.0, 6.0)), **_FAULTY,
)  # fmt: skip
SCENES["modern_house"] = replace(
    _SMALL, building="modern_house", wall="clean_white", seed=53, sun_azimuth=-80.0,
    rings=(Ring(0.6, 3.0, 18.0, 3.5), Ring(0.4, 14.0, 15.0, 3.0)), **_FAULTY,
)  # fmt: skip
SCENES["farm"] = replace(
    _SMALL, building="farm", wall="ashlar", seed=54, trees=12, trees_in_front=2, sun_azimuth=-110.0,
    rings=(Ring(0.5, 6.0, 24.0, 4.0), Ring(0.5, 18.0, 20.0, 4.0)), **_FAULTY,
)  # fmt: skip
for _name in ("masks_block", "masks_hall"):
    SCENES[f"{_name}20"] = replace(SCENES[_name], photos=20)
for _name in ("steel_frame_hall", "brick_ensemble"):
    SCENES[f"{_name}40"] = replace(SCENES[_name], photos=40, width=480)


def scene_spec(name: str, **changes: Any) -> SceneSpec:
    """Return the spec of a named scene with some controls changed (None leaves a control as it is).

    Raises:
        BadInput: the name is not in the table, or nothing can be rendered with such numbers.
    """
    if name not in SCENES:
        raise BadInput(f"There is no scene '{name}'; take one of {', '.join(SCENES)}.")
    spec = replace(SCENES[name], **{key: value for key, value in changes.items() if value is not None})
    if spec.photos < 3 or spec.width < 64 or spec.samples < 1 or spec.seed < 0:
        raise BadInput("A scene needs at least 3 photos of 64 pixels or more, 1 sample per pixel and a seed from 0.")
    return spec


def spec_dict(spec: SceneSpec) -> dict[str, Any]:
    """Return the spec as plain data for ``scene.json``."""
    return asdict(spec)
