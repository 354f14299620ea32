"""Depth that is no measurement: far beyond all that the cameras look over, as sensors send for "nothing measured" and
wrong units are, negative, or not finite."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from twin_node.model.sweep import LEAST_RADIUS, shell_around
from twin_node.scene import Camera, FrameSet, View

REACHES = 25.0
"""How many times as far as the farthest camera is from what all look at a depth may be: 25 m where that is 1 m, farther
than any wall that counts, and far less than millimetres that were taken for metres. No less than 12.5 m: a room stands
around the nearest of rigs, too."""
FARTHEST_M = 65.0
"""What a depth may be in any case: 16 bits of millimetres end at 65.535 m, which sensors send for nothing measured."""
MOST_OF = 0.5
"""Share of what a camera measures that must be so far for a wrong unit to be likelier than pixels that failed."""


class FarDepth:
    """Takes depth that is no measurement out of one rig's images: it would free all space before it."""

    def __init__(self, cameras: Sequence[Camera]) -> None:
        farthest_m = min(max(shell_around(cameras, REACHES).radius, REACHES * LEAST_RADIUS), FARTHEST_M)
        self._farthest = np.float32(farthest_m)
        self.warnings: tuple[str, ...] = ()
        """What a reader must know of the newest set: one line per camera most of whose depth is so far."""

    def without(self, frames: FrameSet) -> FrameSet:
        """`frames` with depth unknown wherever it is too far; as they are where it is nowhere."""
        far = {view.camera.name: self._share(view) for view in frames.views}
        self.warnings = tuple(
            f"camera {name}: {share:.0%} of its depth is beyond {self._farthest:.0f} m and was left out; send it in "
            "metres, or 16 bits of millimetres"
            for name, share in far.items()
            if share > MOST_OF
        )
        if not any(far.values()):
            return frames
        return replace(frames, views=tuple(map(self._nearer, frames.views)))

    def _share(self, view: View) -> float:
        """Of what a view measures, how much is too far."""
        if view.depth is None or view.depth.max(initial=0) <= self._farthest:
            return 0.0
        return float(np.mean(view.depth[view.depth > 0] > self._farthest))

    def _nearer(self, view: View) -> View:
        if view.depth is None:
            return view
        return replace(view, depth=np.where(view.depth > self._farthest, np.float32(0), view.depth))


def wild_depth(view: View) -> str | None:
    """Where a view's depth is negative or not finite, as a sentence for an error; None where it is nowhere."""
    depth = view.depth
    if depth is None or (depth.min(initial=0) >= 0 and depth.max(initial=0) < np.inf):
        return None
    row, column = np.argwhere(~((depth >= 0) & (depth < np.inf)))[0]
    return (
        f"camera {view.camera.name}: expected depth in metres, 0 where unknown, found {depth[row, column]} at row "
        f"{row}, column {column}; put 0 there"
    )
