# SPDX-License-Identifier: GPL-3.0-or-later
"""Bases of operators that start the engine."""

import time

import bpy

from ..common import runner
from ..common.job import DONE, Job
from ..common.operators import Operator
from ..job_folder import has_job_file
from ..scene_keys import key_of
from .engine_messages import in_panel_terms, translate_message


def submit(operator: bpy.types.Operator, job: Job) -> set[str]:
    """Queue a job; without a window there is no timer, so wait for its end and pass its error on."""
    runner.submit(job)
    if not bpy.app.background:
        return {"FINISHED"}
    while runner.pump():
        time.sleep(0.05)
    if job.status != DONE:
        operator.report({"ERROR"}, translate_message(in_panel_terms(job.text)))
        return {"CANCELLED"}
    return {"FINISHED"}


class _StartsEngine(Operator):
    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return cls.needs(
            not runner.live_job(key_of(context.scene)), "A job of this scene is running; wait for it or cancel it"
        )


class JobOperator(_StartsEngine):
    """Base of operators that start a job of the scene."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        source = context.scene.mgf.source
        return cls.needs(source, "Import photos or a COLMAP scene first") and super().poll(context)


class FinishedJobOperator(_StartsEngine):
    """Base of operators that start the engine on the scene's finished job."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        finished = has_job_file(context.scene, "deliver.json")
        return cls.needs(finished, "The job folder holds no finished job") and super().poll(context)
