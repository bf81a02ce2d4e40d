# SPDX-License-Identifier: GPL-3.0-or-later
"""Refine masks pixel by pixel: sky and ground seen through the building, background, trees, thin structures."""
