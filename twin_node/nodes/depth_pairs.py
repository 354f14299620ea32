"""One camera's colour images and the depth images of the same exposures, brought together."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

from twin_node.messages import header_stamp

DEPTHS_KEPT = 8
"""Depth images that wait for their colour image: a quarter of a second at 30 Hz."""
PATIENCE_NS = 60_000_000
"""A colour image whose depth has not come goes when one comes that is this much newer, or the next at lower rates:
depth that is aligned by another node is a period or two late, and other cameras are not held up for a deadline."""
IN_VAIN = 8
"""Colour images in a row that no depth came for, after which none is held back until some comes: a camera whose depth
has failed, or that measures none, would make every set a period older."""


@dataclass(frozen=True)
class EncodedView:
    """One camera's image messages as they came, before decoding."""

    colour: Any
    depth: Any | None


class DepthPairs:
    """Holds colour images back until their depth images have come, or newer ones say that they will not."""

    def __init__(self, tolerance_ns: int) -> None:
        """`tolerance_ns`: between the stamps of one exposure, at most."""
        self._tolerance_ns = tolerance_ns
        self._depths: deque[Any] = deque(maxlen=DEPTHS_KEPT)
        self._held: deque[Any] = deque()
        self._recent: deque[int] = deque(maxlen=DEPTHS_KEPT)
        """Stamps of the last colour images, ns."""
        self._in_vain = 0

    def add_colour(self, colour: Any) -> list[EncodedView]:
        """Takes a colour image; returns the views that are ready, in the order in which their colour came."""
        stamp = header_stamp(colour)
        ready = []
        while self._held and not -PATIENCE_NS < header_stamp(self._held[0]) - stamp <= 0:
            ready.append(self._given_up())
        self._held.append(colour)
        self._recent.append(stamp)
        return ready + self._ready()

    def add_depth(self, depth: Any) -> list[EncodedView]:
        """Takes a depth image; returns the views that are ready."""
        self._depths.append(depth)
        soon_enough = (stamp for stamp in self._recent if self._recent[-1] - stamp < PATIENCE_NS)
        if any(self._is_of(depth, stamp) for stamp in soon_enough):
            self._in_vain = 0
        return self._ready()

    def _ready(self) -> list[EncodedView]:
        ready = []
        while self._held:
            stamp = header_stamp(self._held[0])
            depth = self._depth_at(stamp)
            if depth is not None:
                ready.append(EncodedView(self._held.popleft(), depth))
            elif self._in_vain >= IN_VAIN:
                ready.append(EncodedView(self._held.popleft(), None))
            elif any(header_stamp(later) - stamp > self._tolerance_ns for later in self._depths):
                ready.append(self._given_up())
            else:
                break
        return ready

    def _given_up(self) -> EncodedView:
        """The oldest colour image that waits, without depth."""
        self._in_vain += 1
        return EncodedView(self._held.popleft(), None)

    def _depth_at(self, stamp: int) -> Any | None:
        near = [depth for depth in self._depths if self._is_of(depth, stamp)]
        return min(near, key=lambda depth: abs(header_stamp(depth) - stamp), default=None)

    def _is_of(self, depth: Any, stamp: int) -> bool:
        return abs(header_stamp(depth) - stamp) <= self._tolerance_ns
