# SPDX-License-Identifier: GPL-3.0-or-later
"""Recognise background clicks on what stands in one photo only, such as people and cars.

Other photos show the building at the place of such a click, but they do not contradict it: what was clicked is gone
there, so the colours differ. Of a mistaken click on the building most photos show the same colour.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mgf_engine.masks.prompts import Prompts
from mgf_engine.masks.propagation.label_graph import LabelGraph
from mgf_engine.masks.propagation.prompt_agreement import PromptAgreementOptions, depth_range
from mgf_engine.masks.propagation.prompt_outliers import OutlierPrompt
from mgf_engine.options.algorithms import parameter


@dataclass(frozen=True)
class TransientPromptOptions:
    """Options of background clicks on what stands in one photo only."""

    color: float = parameter(15.0, "Colour difference (CIELAB) up to which two photos show the same thing")
    share: float = parameter(
        0.25, "Maximum share of the other photos that may show the same thing at the place of the click", high=1
    )
    photos: int = parameter(3, "Minimum number of other photos that show the place", low=1)
    depths: int = parameter(5, "Number of depths that are tried, between those of the sparse points around", low=1)
    around: PromptAgreementOptions = PromptAgreementOptions()


def is_transient(
    click: OutlierPrompt,
    graph: LabelGraph,
    prompts: Prompts,
    options: TransientPromptOptions = TransientPromptOptions(),
) -> bool:
    """Tell whether hardly any other photo shows at the place of a click what was clicked.

    Args:
        click: in one photo.
        graph: colours of the regions of all photos, and the sparse points.
        prompts: all clicks, by view index.
        options: what is the same colour, and how many photos must show another.
    """
    scene, uv = graph.scene, click.at(prompts)
    found = depth_range(scene, click.view, uv, options.around)
    if found is None:
        return False
    depths = np.linspace(found.nearest, found.farthest, options.depths)
    places = scene.views[click.view].unproject(np.tile(uv, (options.depths, 1)), depths)
    color = _colors(graph, click.view, uv[None])[0]
    differences = []
    for view in np.setdiff1d(scene.track_view[np.isin(scene.track_point, found.points)], [click.view]).tolist():
        at, _, inside = scene.views[view].project_into_frame(places)
        if inside.any():
            differences.append(np.linalg.norm(_colors(graph, view, at[inside]) - color, axis=1).min())
    return len(differences) >= options.photos and bool(np.mean(np.array(differences) <= options.color) <= options.share)


def _colors(graph: LabelGraph, view: int, uv: np.ndarray) -> np.ndarray:
    """Return the mean colours of the regions under working pixels [N, 2] of a view, CIELAB [N, 3]."""
    return graph.features[graph.start[view] + graph.regions[view].at(uv), :3]
