# SPDX-License-Identifier: GPL-3.0-or-later
"""Photo names of models that come from elsewhere, for the tests of the engine and of the add-on, which read alike."""

#: Name in a model, whether it is read on Windows, and what is looked for below the photo folder. A whole path may name
#: a server, and Windows logs in at whichever it is asked for.
PLAIN = [
    ("wing/a.jpg", False, "wing/a.jpg"),
    ("wing\\a.jpg", False, "wing/a.jpg"),
    ("wing\\a.jpg", True, "wing/a.jpg"),
    ("/home/x/a.jpg", False, "home/x/a.jpg"),
    ("/home/x/a.jpg", True, "home/x/a.jpg"),
    ("//server/share/wing/a.jpg", False, "server/share/wing/a.jpg"),
    ("//server/share/wing/a.jpg", True, "wing/a.jpg"),
    ("\\\\server\\share\\wing\\a.jpg", True, "wing/a.jpg"),
    ("\\\\server\\share\\wing\\a.jpg", False, "server/share/wing/a.jpg"),
    ("C:\\photos\\a.jpg", True, "photos/a.jpg"),
    ("C:a.jpg", True, "a.jpg"),
    ("c:a.jpg", False, "c:a.jpg"),
]
#: The bytes that COLMAP on Windows writes for a name with an umlaut, and the name.
ANSI, ANSI_NAME = b"N\xfcrnberg\x85.png", "Nürnberg\x85.png"
