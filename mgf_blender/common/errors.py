# SPDX-License-Identifier: GPL-3.0-or-later
"""The one exception whose text people read."""


class UserError(Exception):
    """Something the user gave cannot be used; the message is one sentence saying what is wrong and what to do."""
