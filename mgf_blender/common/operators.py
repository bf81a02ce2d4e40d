# SPDX-License-Identifier: GPL-3.0-or-later
"""Base classes of the operators: an operator that fails reports one sentence and leaves nothing half done."""

from __future__ import annotations

from pathlib import Path

import bpy

from .errors import UserError, sentence
from .text import CONTEXT, in_our_words


class Operator(bpy.types.Operator):
    """Base of our operators; subclasses write :meth:`run` and may raise ``UserError``."""

    bl_translation_context = CONTEXT

    def __init_subclass__(cls, **keywords: object) -> None:
        super().__init_subclass__(**keywords)
        in_our_words(cls)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Run, and report what the user did wrong, or a fault of ours, as the operator's error in one sentence."""
        try:
            return self.run(context) or {"FINISHED"}
        except Exception as error:
            self.report({"ERROR"}, sentence(error))
            return {"CANCELLED"}

    @classmethod
    def needs(cls, condition: object, otherwise: str) -> bool:
        """Return, for ``poll``, whether a condition holds; ``otherwise`` is shown at the grey button when it does
        not."""
        if not condition:
            cls.poll_message_set(otherwise)
        return bool(condition)

    def run(self, context: bpy.types.Context) -> set[str] | None:
        """Return the operator's work; None means finished."""
        raise NotImplementedError


class FileOperator(Operator):
    """Base of operators that ask for a file or folder before they run."""

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Open the file browser; confirming there runs the operator."""
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def chosen_file(self) -> Path:
        """Return the file that was chosen.

        Raises:
            UserError: a script gave none.
        """
        if not self.filepath:
            raise UserError("No file was chosen; choose one.")
        return Path(bpy.path.abspath(self.filepath))
