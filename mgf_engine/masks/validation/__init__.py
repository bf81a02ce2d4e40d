# SPDX-License-Identifier: GPL-3.0-or-later
"""Check given masks: coverage of the building, consistency between photos, areas of low texture."""
