# SPDX-License-Identifier: GPL-3.0-or-later
"""The two ways a job ends early on purpose, and the exit codes people's scripts rely on."""

EXIT_DONE = 0
EXIT_FAULT = 1
EXIT_BAD_INPUT = 2
EXIT_CANCELLED = 3


class BadInput(Exception):
    """Something the user gave cannot be used.

    The message is one clear sentence that says what is wrong and what to do; it is shown as it is,
    without a traceback, and the process ends with :data:`EXIT_BAD_INPUT`.
    """


class Cancelled(Exception):
    """The user asked the job to stop; what was done so far stays resumable."""
