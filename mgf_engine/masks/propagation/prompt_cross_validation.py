# SPDX-License-Identifier: GPL-3.0-or-later
"""Cross-validation of clicks: find those that the others contradict.

The clicked photos are split into groups; the clicks of each group are predicted from those of the others. A click is
suspected only if the prediction is certain of the opposite: clicks on parts that no other photo explains are kept. A
suspected click on the building is an outlier only if there is evidence against it
(:mod:`mgf_engine.masks.propagation.prompt_evidence`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from mgf_engine.masks.geometry.ground_plane import GroundPlane
from mgf_engine.masks.prompts import Prompts
from mgf_engine.masks.propagation.prompt_evidence import EDGE_ARM, PromptEvidence, PromptEvidenceOptions
from mgf_engine.masks.propagation.prompt_outliers import OutlierPrompt, without_outliers
from mgf_engine.masks.propagation.random_walker import BuildingProbability, LabelPropagation
from mgf_engine.native.parallel import parallel_map
from mgf_engine.options.algorithms import parameter


@dataclass(frozen=True)
class PromptOutlierOptions:
    """Options of the cross-validation of clicks."""

    groups: int = parameter(5, "Number of groups that the clicked photos are split into", low=2)
    rounds: int = parameter(2, "Number of rounds of label propagation in each test", low=1)
    passes: int = parameter(
        3, "Maximum number of passes; each leaves out what the one before found and tests what it left uncertain", low=1
    )
    certain: float = parameter(
        0.12,
        "Probability of building below which a click on it is suspected; above 1 minus this, a click beside it",
        high=0.5,
    )


class Suspects(NamedTuple):
    """Clicks whose prediction is certain of the opposite.

    Attributes:
        outliers: clicks beside the building, and those on it that evidence denies.
        kept: clicks on the building that nothing denies.
    """

    outliers: list[OutlierPrompt]
    kept: list[OutlierPrompt]


class _Prediction(NamedTuple):
    """A click with the probability predicted for it, and the ground that was found on the way."""

    click: OutlierPrompt
    ground: GroundPlane | None


class PromptCrossValidation:
    """Cross-validation of the clicks of one scene.

    Args:
        walker: label propagation of the scene.
        prompts: clicks by view index.
        seed: of the propagation.
        options: of the tests.
        evidence: options of the evidence against clicks.
    """

    def __init__(
        self,
        walker: LabelPropagation,
        prompts: Prompts,
        seed: int = 0,
        options: PromptOutlierOptions = PromptOutlierOptions(),
        evidence: PromptEvidenceOptions = PromptEvidenceOptions(),
    ) -> None:
        self.walker, self.prompts, self.seed = walker, prompts, seed
        self.options, self.evidence = options, evidence
        self.clicked = [i for i in sorted(prompts) if len(prompts[i].positive) or len(prompts[i].negative)]

    def run(self, check: Callable[[], None] = lambda: None) -> Suspects:
        """Find the clicks that those in other photos contradict; none with fewer than three clicked photos.

        Outliers disturb the test of other clicks, so they are left out, and clicks whose prediction was not certain are
        tested again. The first pass, which is usually the only one, looks at the geometry of the clicked photos only.
        ``check`` is called between the predictions; it raises to stop.
        """
        result = Suspects([], [])
        if len(self.clicked) < 3:
            return result
        open_clicks = [
            OutlierPrompt(i, positive, row, 0.5)
            for i in self.clicked
            for positive, points in ((True, self.prompts[i].positive), (False, self.prompts[i].negative))
            for row in range(len(points))
        ]
        certain = self.options.certain
        for number in range(self.options.passes):
            predictions = self._predict(open_clicks, result.outliers, self.clicked if number == 0 else None, check)
            suspects = [p for p in predictions if _opposite(p.click) > 1 - certain]
            new = self._outliers_of(suspects, result.outliers)
            result.outliers.extend(new)
            result.kept.extend(p.click for p in suspects if p.click not in new)
            open_clicks = [p.click for p in predictions if certain <= p.click.probability <= 1 - certain]
            if not new or not open_clicks:
                break
        return result

    def _outliers_of(self, suspects: Sequence[_Prediction], outliers: Sequence[OutlierPrompt]) -> list[OutlierPrompt]:
        """Return the suspects that are outliers, beside those known: all beside the building, and denied ones on it."""
        if not suspects:
            return []
        evidence = PromptEvidence(self.walker, self.prompts, suspects[0].ground, self.evidence)
        denied = evidence.find_denied([*outliers, *(p.click for p in suspects)])
        return [p.click for p in suspects if not p.click.positive or p.click in denied]

    def _predict(
        self,
        clicks: Sequence[OutlierPrompt],
        outliers: Sequence[OutlierPrompt],
        views: Sequence[int] | None,
        check: Callable[[], None],
    ) -> list[_Prediction]:
        """Predict clicks from those in the other groups without outliers; the geometry is looked at in ``views``."""
        count = min(self.options.groups, len(self.clicked))
        used = without_outliers(self.prompts, outliers)

        def predict(group: int) -> list[_Prediction]:
            held = self.clicked[group::count]
            tested = [click for click in clicks if click.view in held]
            others = {i: c for i, c in used.items() if i not in held}
            if not tested or not any(len(c.positive) for c in others.values()):
                return []
            probability = self.walker.solve(others, self.seed, self.options.rounds, views)
            return [_Prediction(self._rate(click, probability), probability.ground) for click in tested]

        predictions: list[_Prediction] = []
        for found in parallel_map(predict, range(count), self.walker.graph.threads):
            check()
            predictions += found
        return predictions

    def _rate(self, click: OutlierPrompt, probability: BuildingProbability) -> OutlierPrompt:
        """Return a click with the probability at its place."""
        regions = self.walker.graph.regions[click.view]
        # A click a few pixels over the edge is no contradiction: take the kindest neighbour.
        here = probability.regions[click.view][regions.at_cross(click.at(self.prompts), EDGE_ARM)]
        return replace(click, probability=float(here.max() if click.positive else here.min()))


def _opposite(click: OutlierPrompt) -> float:
    """Return the probability of the opposite of what a click says, 0..1."""
    return 1 - click.probability if click.positive else click.probability
