# SPDX-License-Identifier: GPL-3.0-or-later
"""UserError, whose text users read, and one sentence for any other exception."""

import traceback

from .text import tr


class UserError(Exception):
    """Something the user gave cannot be used; the message is one sentence saying what is wrong and what to do.

    Args:
        text: the sentence in English, with ``{name}`` where a value goes.
        values: the values.
    """

    def __init__(self, text: str, **values: object) -> None:
        super().__init__(tr(text, **values))


def reason(error: Exception) -> str:
    """Return what a file's error says in words: without its number, and without the path, which the sentence names."""
    return str(error.strerror or error) if isinstance(error, OSError) else str(error)


def sentence(error: Exception) -> str:
    """Return what people read of an error: a ``UserError``'s own text, or what the system says of a file; of a fault of
    ours the console has the rest."""
    if isinstance(error, UserError):
        return str(error)
    if isinstance(error, OSError) and error.filename:
        return tr("Cannot use '{path}' ({error}); check that it is there and yours.", path=error.filename,
                  error=reason(error))  # fmt: skip
    traceback.print_exception(error)
    return tr("The add-on made a mistake ({error!r}); please report it with the text in the console.", error=error)
