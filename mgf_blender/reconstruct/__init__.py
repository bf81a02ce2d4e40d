# SPDX-License-Identifier: GPL-3.0-or-later
"""Jobs of the engine: start, watch, cancel, resume."""
