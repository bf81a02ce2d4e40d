# SPDX-License-Identifier: GPL-3.0-or-later
"""The Python interface: one function for a whole job, and one for each of its steps.

Import these from :mod:`mgf_engine`. Options are keyword arguments with the names that ``mgf options`` lists; a step
accepts the options of all steps and uses its own. Paths may be strings. Every function raises
:class:`~mgf_engine.errors.BadInput` with a message of one sentence if its input cannot be used.

The steps share a work folder with the layout of a job folder: ``scene/``, ``masks/``, ``checkpoints/``.
"""

from mgf_engine.api.evaluation import evaluate
from mgf_engine.api.jobs import Reconstruction, reconstruct
from mgf_engine.api.steps import extract_mesh, make_masks, read_scene, render, train

__all__ = [
    "Reconstruction",
    "evaluate",
    "extract_mesh",
    "make_masks",
    "read_scene",
    "reconstruct",
    "render",
    "train",
]
