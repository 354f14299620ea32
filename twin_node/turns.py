"""Whose turn it is, of those that are there."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


class Turns:
    """Gives everybody a turn, also those that are not there each time: a camera that is in every second set only."""

    def __init__(self) -> None:
        self._taken = 0
        self._last: dict[str, int] = {}
        """Which turn everybody had last, by name."""

    def whose(self, names: Sequence[str]) -> int:
        """The place in `names`, one or more, of who has waited longest; of several the next one in the row."""
        row = max(self._taken, 1)  # as if the first one in the row had had the first turn, or the last of one of all
        waiting = [(self._last.get(name, 0), (at - row) % len(names)) for at, name in enumerate(names)]
        return waiting.index(min(waiting))

    def take(self, names: Iterable[str]) -> None:
        """They have had a turn."""
        self._taken += 1
        self._last.update(dict.fromkeys(names, self._taken))
