# SPDX-License-Identifier: GPL-3.0-or-later
"""Many buildings of one scene: found in a map of footprints, clicked by themselves, run side by side, put together."""
