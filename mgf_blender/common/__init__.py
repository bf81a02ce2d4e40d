# SPDX-License-Identifier: GPL-3.0-or-later
"""What several rooms of the add-on share and that has no interface of its own."""
