"""Images of a log that sets go without: one that a camera or its cable damaged is no reason to play nothing."""

from __future__ import annotations

from collections import Counter

from twin_node.errors import several
from twin_node.messages import DamagedError

PATIENCE = 10
"""Images that a camera may begin with and that are all damaged: if more are, its format may not be known."""


class DamagedImages:
    """Counts them, camera by camera."""

    def __init__(self) -> None:
        self._whole: Counter[str] = Counter()
        self._damaged: Counter[str] = Counter()
        self._last: dict[str, DamagedError] = {}

    def add_whole(self, camera: str) -> None:
        """Takes note of an image that could be used."""
        self._whole[camera] += 1

    def add(self, camera: str, error: DamagedError) -> None:
        """Takes note of one that its set goes without. Raises `error` where none of the camera's can be used."""
        self._damaged[camera] += 1
        self._last[camera] = error
        if self._damaged[camera] > PATIENCE and not self._whole[camera]:
            raise error

    @property
    def lines(self) -> tuple[str, ...]:
        """What there is to say, a line for each camera."""
        return tuple(
            f"camera {name}: left out {several(count, 'damaged image')} of {count + self._whole[name]}; the last: "
            f"{self._last[name]}"
            for name, count in self._damaged.items()
        )
