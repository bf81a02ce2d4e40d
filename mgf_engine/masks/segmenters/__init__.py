# SPDX-License-Identifier: GPL-3.0-or-later
"""What turns clicks and projected points into a mask of one photo."""
