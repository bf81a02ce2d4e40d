# SPDX-License-Identifier: GPL-3.0-or-later
"""Many buildings of one scene: found in a map of footprints, clicked by themselves, run side by side, put together.

``plan`` chooses photos (``view_selection``) and clicks (``clicks``) of each footprint (``footprints``, or ``find``
without a map); ``run`` is ``mgf town``: it starts a ``worker`` for each building under Snakemake (``workflow``), and
``result`` gathers what comes back.
"""
