"""What one camera alone sees move and does not measure: where it is nobody knows."""

from __future__ import annotations

from collections import deque

import cv2
import numpy as np
from numpy.typing import NDArray

from twin_node.forecast.bits import Bits
from twin_node.forecast.tables import RigTables
from twin_node.scene import Bool, TwinState

FRESH_NS = 400_000_000
"""What has begun to move in an image within this time, ns: remains of what moved on stay in masks for longer."""
SMALLEST_SHARE = 1.5e-3
"""Of an image: fewer such pixels are the rims of what several cameras see."""
_RIM = np.ones((3, 3), np.uint8)


class LoneSights:
    """Follows which pixels show something move, without depth of it, that is in no moving space."""

    def __init__(self, tables: RigTables) -> None:
        self._tables = tables
        self._past: dict[str, deque[tuple[int, Bool]]] = {}

    def update(self, state: TwinState, moving: NDArray[np.int64], unknown: Bits) -> bool:
        """Whether some camera shows so, as of a state; states come in rising order of stamps.

        `moving` [n]: flat indices where all cameras together see something move; `unknown`: what nothing frees or
        explains. Somebody who is neither in the one nor behind the other is not near.
        """
        is_so = False
        for view, moves in zip(state.frames.views, state.moving_masks, strict=True):
            mask = moves if view.depth is None else moves & (view.depth <= 0)  # dark clothes; edges are too narrow
            fresh = mask & ~self._before(view.camera.name, view.stamp, mask)
            if np.count_nonzero(fresh) < SMALLEST_SHARE * mask.size:
                continue
            table, blocks = self._tables.of(view.camera), self._tables.blocks
            lone = fresh & ~table.image_of(blocks.locate(moving))
            lone = cv2.morphologyEx(lone.astype(np.uint8), cv2.MORPH_OPEN, _RIM) > 0
            if np.count_nonzero(lone) >= SMALLEST_SHARE * mask.size:
                lone &= table.image_of(blocks.locate(unknown.indices()))
                is_so = is_so or bool(np.count_nonzero(lone) >= SMALLEST_SHARE * mask.size)
        return is_so

    def _before(self, camera: str, stamp: int, mask: Bool) -> Bool:
        """A camera's mask of `FRESH_NS` ago, or its first one; keeps the present one."""
        past = self._past.get(camera)
        if past is None or past[0][1].shape != mask.shape:
            past = self._past[camera] = deque()
        past.append((stamp, mask))
        while len(past) > 1 and stamp - past[1][0] >= FRESH_NS:
            past.popleft()
        return past[0][1]
