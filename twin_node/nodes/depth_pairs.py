"""One camera's colour images and the depth images of the same exposures, brought together."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

from twin_node.messages import header_stamp

DEPTHS_KEPT = 8
"""Depth images that wait for their colour image: a quarter of a second at 30 Hz."""
IN_VAIN = 8
"""Colour images in a row that no depth came for, after which none is held back until some comes: a camera whose depth
has failed, or that measures none, would make every set a period older."""


@dataclass(frozen=True)
class EncodedView:
    """One camera's image messages as they came, before decoding."""

    colour: Any
    depth: Any | None


class DepthPairs:
    """Holds a colour image back until its depth image has come, or the next colour image."""

    def __init__(self, tolerance_ns: int) -> None:
        """`tolerance_ns`: between the stamps of one exposure, at most."""
        self._tolerance_ns = tolerance_ns
        self._depths: deque[Any] = deque(maxlen=DEPTHS_KEPT)
        self._held: Any | None = None
        self._newest: int | None = None
        """Stamp of the last colour image, ns."""
        self._in_vain = 0

    def add_colour(self, colour: Any) -> list[EncodedView]:
        """Takes a colour image; returns the views that are ready."""
        ready = []
        if self._held is not None:
            ready.append(EncodedView(self._held, None))
            self._held = None
            self._in_vain += 1
        self._newest = header_stamp(colour)
        depth = self._depth_at(self._newest)
        if depth is None and self._in_vain < IN_VAIN:
            self._held = colour
            return ready
        return [*ready, EncodedView(colour, depth)]

    def add_depth(self, depth: Any) -> list[EncodedView]:
        """Takes a depth image; returns the view that it was waited for, if any."""
        self._depths.append(depth)
        if self._newest is not None and self._is_of(depth, self._newest):
            self._in_vain = 0
        found = None if self._held is None else self._depth_at(header_stamp(self._held))
        if found is None:
            return []
        ready, self._held = EncodedView(self._held, found), None
        return [ready]

    def _depth_at(self, stamp: int) -> Any | None:
        near = [depth for depth in self._depths if self._is_of(depth, stamp)]
        return min(near, key=lambda depth: abs(header_stamp(depth) - stamp), default=None)

    def _is_of(self, depth: Any, stamp: int) -> bool:
        return abs(header_stamp(depth) - stamp) <= self._tolerance_ns
