# SPDX-License-Identifier: GPL-3.0-or-later
"""Last stage: novel views, report and textured files of a finished mesh."""
