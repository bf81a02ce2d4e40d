# SPDX-License-Identifier: GPL-3.0-or-later
"""Keys of stages: a hash of everything that a stage's result depends on.

That is its inputs, the options of its section and the key of the previous stage: changing an option redoes that stage
and the later ones. Files are identified by their content, not by their path.
"""

from __future__ import annotations

import hashlib
import json
from typing import Any

from mgf_engine.jobs.inputs import Inputs
from mgf_engine.jobs.job_folder import FORMAT
from mgf_engine.masks.prompts import clicked_names
from mgf_engine.options.config import Config, option_fields
from mgf_engine.stages import STAGES, Stage

#: Options that name a table of the survey.
TABLES = ("control", "marks", "scale_bars")
#: Those that the cameras are adjusted to; scale bars only measure.
_MOVING_CAMERAS = ("control", "marks")
#: Options that name files; keys depend on the content of these, not on their path.
_BY_CONTENT = ("weights", *TABLES)


def stage_keys(config: Config, inputs: Inputs) -> dict[str, str]:
    """Compute the key of each stage, stage name -> key."""
    keys: dict[str, str] = {}
    before = f"format {FORMAT}"
    for stage in STAGES:
        before = keys[stage.name] = _hash(
            [before, _options_of(stage, config, inputs), _inputs_of(stage, config, inputs)]
        )
    return keys


def adjusts_to_control(config: Config) -> bool:
    """Tell whether control points move the cameras, so that the scene depends on them."""
    return bool(config.control) and config.control_adjust


def _options_of(stage: Stage, config: Config, inputs: Inputs) -> dict[str, Any]:
    """Return the options that the stage's result depends on, and no others."""
    names = [f.name for f in option_fields() if f.metadata["section"] in stage.sections]
    options = {n: getattr(config, n) for n in (*names, *stage.options) if n not in _BY_CONTENT}
    for section in stage.sections:
        options.update(config.algorithms_of(section))
    if stage.inputs == "photos" and adjusts_to_control(config):
        options.update(config.algorithms_of("georef"))
    if stage.inputs == "photos" and not _leaves_photos_out(config, inputs):
        options["max_photos"] = 0
    return options


def _inputs_of(stage: Stage, config: Config, inputs: Inputs) -> Any:
    """Return the identity of the user's files that the stage reads, as plain data."""
    if stage.inputs == "photos":
        return _photos(config, inputs)
    if stage.inputs == "prompts":
        return _prompts_or_masks(config, inputs)
    if stage.inputs == "survey":
        return inputs.tables or None
    return None


def _leaves_photos_out(config: Config, inputs: Inputs) -> bool:
    return 0 < config.max_photos < len(inputs.names)


def _photos(config: Config, inputs: Inputs) -> list[Any]:
    # max_photos leaves photos out, but never those with clicks: then the names of these matter, too.
    found = [inputs.scene, clicked_names(inputs.clicks) if _leaves_photos_out(config, inputs) else None]
    if not adjusts_to_control(config):
        return found
    return [*found, {name: digest for name, digest in inputs.tables.items() if name in _MOVING_CAMERAS}]


def _prompts_or_masks(config: Config, inputs: Inputs) -> Any:
    """Return the identity of the user's masks, or else of the clicks; None with ``use_masks`` off."""
    if not config.use_masks:
        return None
    if inputs.masks is not None:  # masks take precedence over clicks
        return inputs.masks
    return inputs.clicks and inputs.clicks.digest()


def _hash(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True, default=str).encode()).hexdigest()[:20]
