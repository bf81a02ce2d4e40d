# SPDX-License-Identifier: GPL-3.0-or-later
"""Jobs of a scene: what starts them, how panels show them, and the engine's messages in the panel's words."""
