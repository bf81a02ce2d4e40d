# SPDX-License-Identifier: GPL-3.0-or-later
"""Lists of tiles held against what each tile should list."""

from __future__ import annotations

import torch
from torch import Tensor

from mgf_engine.raster.cpu import TileLists

#: Column of the records that holds the depth of the centre: ``REC_B0`` of csrc/raster/records.h.
DEPTH = 10


def check_lists(lists: TileLists, touched: Tensor, mask: Tensor) -> Tensor:
    """Structure of the lists; returns bool [N, tiles]: which Gaussian is listed where."""
    tiles = lists.tiles_x * lists.tiles_y
    ranges = lists.ranges.tolist()
    assert ranges[0] == 0 and ranges[-1] == lists.entries == int(lists.slot_starts[-1])
    listed = torch.zeros(len(lists.tile_counts), tiles, dtype=torch.bool)
    for tile in range(tiles):
        gid = lists.gid[ranges[tile] : ranges[tile + 1]].long()
        assert len(gid.unique()) == len(gid)
        depths = lists.records[gid, DEPTH]
        assert (depths.diff() >= 0).all(), "a list is not front to back"
        listed[gid, tile] = True
    assert torch.equal(listed.sum(1).int(), lists.tile_counts)
    slots = lists.slots.long()
    assert torch.equal(slots.sort().values, torch.arange(lists.entries))
    starts = lists.slot_starts[lists.gid.long()]
    assert ((slots >= starts) & (slots < starts + lists.tile_counts[lists.gid.long()])).all()
    wanted = touched.flatten(1) & mask.flatten().bool()
    assert not (wanted & ~listed).any(), "a tile misses a Gaussian that shows in it"
    assert not listed[:, ~mask.flatten().bool()].any(), "a tile outside the mask is listed"
    return listed
