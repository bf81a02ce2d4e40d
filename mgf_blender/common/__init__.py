# SPDX-License-Identifier: GPL-3.0-or-later
"""Code that several packages of the add-on share, without an interface of its own."""
