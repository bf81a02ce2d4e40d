# SPDX-License-Identifier: GPL-3.0-or-later
"""Options of georeferencing; px is a pixel of a photo as it was taken."""

from __future__ import annotations

from dataclasses import dataclass

from mgf_engine.options.algorithms import parameter
from mgf_engine.options.config import job_option
from mgf_engine.scene.gravity import GravityOptions


@dataclass(frozen=True)
class ControlPointOptions:
    """Accuracy of control points and marks whose file gives none, and the fit of the scene to them."""

    accuracy: float = parameter(0.01, "Standard deviation of a control point whose file gives none", "m", low=1e-6)
    mark_accuracy: float = parameter(0.5, "Standard deviation of a mark in a photo", "px", low=1e-3)
    outlier: float = parameter(
        5.0, "Residual from which a control point is left out, in standard deviations of its coordinates"
    )
    tolerated: float = parameter(
        0.01, "Residual that is always tolerated, as a share of the extent of the control points"
    )
    tolerated_bent: float = parameter(
        0.05, "Residual that is tolerated before the cameras are adjusted, as a share of that extent"
    )


@dataclass(frozen=True)
class MarkOptions:
    """Triangulation of marked points: clicks are off by a pixel or two, cameras by another, a wrong photo by 100."""

    outlier: float = parameter(
        12.0, "Reprojection error from which a mark is left out, per 1000 px of the photo's longest side", "px", low=0.1
    )
    least_angle: float = parameter(
        1.0, "Minimum angle between two rays that place a point", "degrees", low=1e-3, high=90
    )


@dataclass(frozen=True)
class GpsFitOptions:
    """Fit of the cameras to the GPS of their photos."""

    accuracy: tuple[float, float] = parameter(
        (3.0, 6.0), "Horizontal and vertical standard deviation of a position whose photo gives none", "m", low=1e-3
    )
    outlier: float = parameter(4.0, "Residual from which a position is left out, in standard deviations")
    widening: tuple[float, float, float] = parameter(
        (1.0, 2.0, 4.0), "Factors on that limit, tried in turn, since photos often state too good an accuracy"
    )
    agreeing: float = parameter(0.6, "Minimum share of the positions that fit", high=1)
    least_spread: float = parameter(
        2.0, "Minimum extent of the positions across their longest direction, in their errors"
    )


@dataclass(frozen=True)
class ScaleBarOptions:
    """Scale from known distances."""

    accuracy: float = parameter(0.002, "Standard deviation of a distance whose file gives none", "m", low=1e-6)
    outlier: float = parameter(
        3.0, "Deviation from the median scale from which a bar is left out, in median deviations"
    )


@dataclass(frozen=True)
class ControlAdjustmentOptions:
    """Bundle adjustment with control points; its errors are counted in working pixels."""

    least_sigma: float = parameter(0.1, "Minimum standard deviation of an observation", "px", low=1e-3)
    loss: float = parameter(2.0, "Scale of Cauchy's loss of observations, in standard deviations", low=1e-3)
    least_loss: float = parameter(0.5, "Minimum scale of that loss", "px", low=1e-3)
    control_loss: float = parameter(
        3.0, "Minimum scale of Cauchy's loss of coordinates in the first round, in standard deviations", low=1e-3
    )
    outlier: float = parameter(4.0, "Reprojection error from which an observation is left out", "px", low=0.1)


@dataclass(frozen=True)
class GeoreferenceOptions:
    """All options of georeferencing: those of the job (files, CRS), and of the algorithms."""

    crs: str = job_option("crs")
    control: str = job_option("control")
    marks: str = job_option("marks")
    scale_bars: str = job_option("scale_bars")
    gps: str = job_option("gps")
    point: ControlPointOptions = ControlPointOptions()
    mark: MarkOptions = MarkOptions()
    position: GpsFitOptions = GpsFitOptions()
    bar: ScaleBarOptions = ScaleBarOptions()
    adjustment: ControlAdjustmentOptions = ControlAdjustmentOptions()
    gravity: GravityOptions = GravityOptions()
