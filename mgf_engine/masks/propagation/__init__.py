# SPDX-License-Identifier: GPL-3.0-or-later
"""Propagate clicks to all photos by a random walker on a graph of superpixels and sparse points.

``propagate`` runs it: ``superpixels`` and ``label_graph`` make the graph, ``appearance`` (colour and texture) and
``geometric_odds`` give evidence, ``random_walker`` solves it, ``prompt_cross_validation`` finds clicks that contradict
the others, ``draw_mask`` asks the segmenter, ``correct_masks`` calls the refinement.
"""
