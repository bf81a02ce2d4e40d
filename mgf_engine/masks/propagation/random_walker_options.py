# SPDX-License-Identifier: GPL-3.0-or-later
"""Options of the label propagation: weights of the graph's edges and of the evidence at its nodes."""

from __future__ import annotations

from dataclasses import dataclass

from mgf_engine.masks.geometry.floaters import FloaterOptions
from mgf_engine.masks.geometry.ground_plane import GroundPlaneOptions
from mgf_engine.masks.geometry.point_features import PointFeatureOptions
from mgf_engine.masks.geometry.point_visibility import PointVisibilityOptions
from mgf_engine.masks.geometry.silhouette_consistency import SilhouetteConsistencyOptions
from mgf_engine.masks.geometry.superstructures import SuperstructureOptions
from mgf_engine.masks.propagation.appearance import AppearanceOptions
from mgf_engine.options.algorithms import parameter


@dataclass(frozen=True)
class RandomWalkerOptions:
    """Options of the label propagation; odds are natural logarithms of the odds of "building"."""

    track_weight: float = parameter(1.0, "Edge weight between a point and a region that it was observed in")
    space_weight: float = parameter(0.3, "Edge weight between two neighbouring points")
    click_weight: float = parameter(2.0, "Weight of a click; it counts five times, at its pixel and 5 px to four sides")
    evidence_weight: float = parameter(1.5, "Weight of certain evidence (all the odds below) at a region")
    point_evidence_weight: float = parameter(
        2.0, "Weight of certain evidence at a point, which has an edge to each photo that observed it"
    )
    appearance_limit: float = parameter(3.0, "Maximum odds by colour, texture and shape, of either sign")
    plant_odds: float = parameter(-2.0, "Odds of leaves and grass", low=None)
    core_odds: float = parameter(2.2, "Odds where the ray meets the building", low=None)
    rim_odds: float = parameter(0.4, "Odds in the rim around the outermost points of the building", low=None)
    far_odds: float = parameter(-2.0, "Odds per point spacing away from the building, beyond far_from", low=None)
    far_from: float = parameter(1.2, "Distance from the building at which far_odds begins", "point spacings")
    far_limit: float = parameter(5.0, "Maximum distance that far_odds counts", "point spacings")
    apart_odds: float = parameter(-4.0, "Odds of points that are apart from every click on the building", low=None)
    hidden_odds: float = parameter(-2.0, "Odds where points that the photo should observe are not observed", low=None)
    ground_first_odds: float = parameter(-6.0, "Odds where the ray meets the ground first", low=None)
    sky_odds: float = parameter(-5.0, "Odds of sky", low=None)
    occluded_odds: float = parameter(-2.0, "Odds where points of something else are nearer to the camera", low=None)
    other_gap: float = parameter(
        4.0, "Distance from the building beyond which a point is something else", "point spacings"
    )
    building_above: float = parameter(0.6, "Probability above which a point belongs to the building", high=1)
    other_below: float = parameter(0.2, "Probability below which a point belongs to something else", high=1)
    ground_odds: float = parameter(-4.0, "Odds of points on the ground plane", low=None)
    within_odds: float = parameter(
        2.5, "Odds of points that photos see on the surface of the building or behind it", low=None
    )
    over_odds: float = parameter(4.0, "Odds of points that stand on the building", low=None)
    over_weight: float = parameter(
        0.5, "Weight of over_odds per photo that observed the point: the regions around a spire are mostly sky"
    )
    ground_training_weight: float = parameter(
        0.2, "Weight of ground in the colour models: walls may be of the same stone", high=1
    )
    click_radius: float = parameter(
        0.06, "Radius around a click in which its nearest point is sought, as a share of the photo's width", high=1
    )
    tie_appearance_weight: float = parameter(
        0.3, "Weight of certain appearance of regions tied to the building although no point of it is near"
    )
    tied: tuple[float, float] = parameter(
        (0.4, 0.7),
        "Probabilities of being connected to the building between which far_odds and ground_first_odds fade",
        high=1,
    )
    termination: float = parameter(
        0.02, "Probability per step that the first random walk ends, which limits the reach of a click"
    )
    rounds: int = parameter(4, "Number of rounds of appearance, geometry and propagation", low=1, high=100)
    silhouette_rounds: int = parameter(
        1, "Number of further rounds with the silhouettes of the other photos as evidence", high=100
    )
    silhouettes: SilhouetteConsistencyOptions = SilhouetteConsistencyOptions()
    floaters: FloaterOptions = FloaterOptions()
    ground: GroundPlaneOptions = GroundPlaneOptions()
    visibility: PointVisibilityOptions = PointVisibilityOptions()
    superstructures: SuperstructureOptions = SuperstructureOptions()
    features: PointFeatureOptions = PointFeatureOptions()
    appearance: AppearanceOptions = AppearanceOptions()
