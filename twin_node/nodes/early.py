"""Images decoded while others of their set are still to come: when the last one is there, only that is left to do."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

from twin_node.nodes.depth_pairs import EncodedView
from twin_node.scene import View
from twin_node.side_thread import Task

KEPT = 4
"""Views of one camera: more images than that between its own and its set's last one are not worth their memory."""
GAPS = 8
"""How many of the last times between sets tell how soon the next may be whole."""
SOON = 0.75
"""No set is expected sooner after the last than this share of the shortest gap: what a faster camera sends before that
is in none."""


class EarlyViews:
    """Views of sets that are not whole, and what tells which set an image will be in."""

    def __init__(self, names: Iterable[str]) -> None:
        self._kept: dict[str, dict[int, tuple[EncodedView, Task[View]]]] = {name: {} for name in names}
        self._leads = dict.fromkeys(self._kept, 0)
        """By how much each camera's image was older than the last set that it was in, ns."""
        self._passed = dict.fromkeys(self._kept, -1)
        """Stamp of each camera's newest image that was in a set, ns."""
        self._gaps: deque[int] = deque(maxlen=GAPS)
        self._last: int | None = None

    def pass_set(self, stamp: int, members: Iterable[tuple[str, int]]) -> None:
        """A set of a stamp, ns, is whole, of images of the cameras named: what is older is in no other one."""
        for name, own in members:
            self._leads[name], self._passed[name] = stamp - own, own
            self._kept[name] = {at: kept for at, kept in self._kept[name].items() if at > own}
        if self._last is not None:
            self._gaps.append(max(stamp - self._last, 0))
        self._last = stamp

    def set_of(self, name: str, stamp: int) -> int | None:
        """Stamp, ns, of the set that an image will most likely be in; None where there will hardly be one."""
        expected = stamp + self._leads[name]
        if stamp <= self._passed[name] or expected < (self._last or 0) + SOON * min(self._gaps, default=0):
            return None
        return expected

    def keep(self, name: str, stamp: int, encoded: EncodedView, view: Task[View]) -> None:
        """Keeps a view, and what it is decoded from, until its set is whole, or some later ones have come."""
        kept = self._kept[name]
        kept[stamp] = encoded, view
        if len(kept) > KEPT:
            del kept[next(iter(kept))]

    def get(self, name: str, stamp: int, encoded: EncodedView) -> Task[View] | None:
        """The view of an image, if it has been begun; what is of another one with its stamp is not its view."""
        source, view = self._kept[name].get(stamp, (None, None))
        return view if source is encoded else None
