# SPDX-License-Identifier: GPL-3.0-or-later
"""The one exception whose text people read."""

from .text import tr


class UserError(Exception):
    """Something the user gave cannot be used; the message is one sentence saying what is wrong and what to do.

    Args:
        text: the sentence in English, with ``{name}`` where a value goes.
        values: the values.
    """

    def __init__(self, text: str, **values: object) -> None:
        super().__init__(tr(text, **values))
