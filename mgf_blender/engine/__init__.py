# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine as an environment of its own: where it is, how it is installed, how it is checked."""
