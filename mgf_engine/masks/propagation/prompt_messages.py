# SPDX-License-Identifier: GPL-3.0-or-later
"""Sentences about clicks that contradict the other photos, and about clicks that a mask misses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mgf_engine.masks.prompts import Prompts
from mgf_engine.masks.propagation.label_graph import LabelGraph
from mgf_engine.masks.propagation.prompt_outliers import (
    OutlierPrompt,
    clicked_elsewhere,
    ignored_outliers,
    on_points,
)
from mgf_engine.masks.propagation.transient_prompts import TransientPromptOptions, is_transient
from mgf_engine.model.masks import BACKGROUND
from mgf_engine.model.pixels import pixel_at
from mgf_engine.scene.cameras import to_original

#: How sentences end that ask whoever clicked to look at single clicks again.
_ASKING = "delete them if they are mistakes.", "click the same spot in a second photo."


def asks_for_other_clicks(text: str) -> bool:
    """Tell whether a sentence is about single clicks, which nobody made where clicks are automatic."""
    return text.endswith(_ASKING)


@dataclass(frozen=True)
class PromptMessages:
    """What users should read about their clicks.

    Attributes:
        graph: of the scene.
        prompts: all clicks, outliers included.
        labels: label map of each view, uint8 [H, W].
        transient: what tells a click on people or cars from a mistake.
    """

    graph: LabelGraph
    prompts: Prompts
    labels: Sequence[NDArray[np.uint8]]
    transient: TransientPromptOptions = TransientPromptOptions()

    def sentences(self, outliers: list[OutlierPrompt], doubted: list[OutlierPrompt], ignored: bool) -> list[str]:
        """Make a sentence for each photo with outliers, or one for all where none could be left out.

        Args:
            outliers: clicks that the other photos contradict.
            doubted: clicks that are used although others do not explain them.
            ignored: whether outliers were left out.
        """
        out = ignored_outliers(outliers, self.prompts)
        if out and not ignored:
            names = ", ".join(self._name(i) for i in sorted({d.view for d in outliers}))
            return [f"The clicks in {names} contradict each other; look at the contact sheet and click them again."]
        used = [d for d in outliers if d not in out and not is_transient(d, self.graph, self.prompts, self.transient)]
        missed = [d for d in doubted if self._misses(d)]
        lost = [d for d in out if not d.positive or self._misses(d)]
        texts = (lost, self._ignored_text), (used, self._used_text), (missed, self._missed_text)
        return [
            sentence(index, [d for d in chosen if d.view == index])
            for chosen, sentence in texts
            for index in sorted({d.view for d in chosen})
        ]

    def _ignored_text(self, index: int, outliers: list[OutlierPrompt]) -> str:
        """Describe the outliers that are left out."""
        name, spots = self._name(index), self._spots(index, outliers)
        evidence = on_points(self.graph, index, self.prompts[index])
        if evidence and clicked_elsewhere(index, outliers, self.prompts):
            return f"'{name}' seems to be clicked on another building; its clicks {spots} are ignored."
        return (
            f"The clicks {spots} in '{name}' contradict the other photos and are ignored; if they are right, "
            "click the same spot in a second photo."
        )

    def _used_text(self, index: int, outliers: list[OutlierPrompt]) -> str:
        """Describe the outliers beside the building, which are used all the same."""
        return (
            f"The background clicks {self._spots(index, outliers)} in '{self._name(index)}' contradict the other "
            "photos. They are still used; delete them if they are mistakes."
        )

    def _missed_text(self, index: int, outliers: list[OutlierPrompt]) -> str:
        """Describe the doubted clicks that lie outside of the mask."""
        return (
            f"The mask of '{self._name(index)}' misses the clicks {self._spots(index, outliers)}; add clicks around "
            "them, in this and in other photos."
        )

    def _misses(self, click: OutlierPrompt) -> bool:
        """Tell whether a click on the building lies outside of its photo's mask."""
        labels, uv = self.labels[click.view], self.prompts[click.view].positive[click.row]
        return bool((labels[pixel_at(labels.shape, uv[None])] == BACKGROUND).all())

    def _name(self, index: int) -> str:
        return self.graph.scene.views[index].name

    def _spots(self, index: int, outliers: list[OutlierPrompt]) -> str:
        """List the clicks' pixels in the user's photo, as text."""
        clicks, view = self.prompts[index], self.graph.scene.views[index]
        chosen = [(clicks.positive if d.positive else clicks.negative)[d.row] for d in outliers]
        return ", ".join(f"({u:.0f}, {v:.0f})" for u, v in to_original(view, np.stack(chosen)))
