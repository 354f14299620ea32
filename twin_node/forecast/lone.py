"""What one camera alone sees move and does not measure: where it is nobody knows."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from twin_node.forecast.bits import Bits
from twin_node.forecast.tables import RigTables
from twin_node.scene import Bool, TwinState, View

FRESH_NS = 400_000_000
"""What has begun to move in an image within this time, ns: remains of what moved on stay in masks for longer."""
SMALLEST_SHARE = 1.5e-3
"""Of an image: fewer such pixels are the rims of what several cameras see."""
_RIM = np.ones((3, 3), np.uint8)


class LoneSights:
    """Follows which pixels show something move, without depth of it, that is in no moving space."""

    def __init__(self, tables: RigTables) -> None:
        self._tables = tables
        self._past: dict[str, deque[_Shown]] = {}
        self.within: NDArray[np.int64] = np.zeros(0, np.int64)
        """[n] unknown voxels behind such pixels, of what keeps still too, by the last state: somebody is in there."""

    def update(self, state: TwinState, moving: NDArray[np.int64], unknown: Bits) -> bool:
        """Whether some camera shows so, as of a state; states come in rising order of stamps.

        `moving` [n]: flat indices where all cameras together see something move; `unknown`: what nothing frees or
        explains. Somebody who is neither in the one nor behind the other is not near.
        """
        is_so, within = False, [np.zeros(0, np.int64)]
        for view, moves in zip(state.frames.views, state.moving_masks, strict=True):
            mask = moves if view.depth is None else moves & (view.depth <= 0)  # dark clothes; edges are too narrow
            fresh = mask & ~self._before(view, moves, mask)
            if np.count_nonzero(_without_rims(mask)) < SMALLEST_SHARE * mask.size:
                continue
            table, blocks = self._tables.of(view.camera), self._tables.blocks
            beside = ~table.image_of(blocks.locate(moving))
            shown = _without_rims(mask & beside)
            if np.count_nonzero(shown) < SMALLEST_SHARE * mask.size:
                continue
            nobody_sees = unknown.indices()
            behind = nobody_sees[np.append(shown, False)[table.voxels.pixels[blocks.locate(nobody_sees)]]]
            within.append(behind)
            lone = _without_rims(fresh & beside)
            if np.count_nonzero(lone) >= SMALLEST_SHARE * mask.size:
                is_so |= bool(
                    np.count_nonzero(lone & table.image_of(blocks.locate(behind))) >= SMALLEST_SHARE * mask.size
                )
        self.within = np.concatenate(within)
        return is_so

    def _before(self, view: View, moves: Bool, mask: Bool) -> Bool:
        """What a view's `mask` would have been `FRESH_NS` ago, or in its first image; keeps the present one.

        Without depth all that `moves` is: what was measured then, and is not now, is no newer for that.
        """
        past = self._past.get(view.camera.name)
        if past is None or past[0].mask.shape != mask.shape:
            past = self._past[view.camera.name] = deque()
        past.append(_Shown(view.stamp, moves, mask))
        while len(past) > 1 and view.stamp - past[1].stamp >= FRESH_NS:
            past.popleft()
        return past[0].moves if view.depth is None else past[0].mask


class _Shown(NamedTuple):
    """What one image showed."""

    stamp: int
    """ns."""
    moves: Bool
    """[H, W]."""
    mask: Bool
    """[H, W] of this what was not measured."""


def _without_rims(mask: Bool) -> Bool:
    """What of a mask [H, W] is three pixels wide."""
    return cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, _RIM) > 0
