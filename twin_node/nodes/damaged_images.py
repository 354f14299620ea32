"""Images of a log that sets go without: one that a camera or its cable damaged is no reason to play nothing."""

from __future__ import annotations

from collections import Counter

from twin_node.errors import several
from twin_node.messages import DamagedError

PATIENCE = 10
"""Images that a camera may begin with and that are all damaged: if more are, its format may not be known."""


class DamageCount:
    """Counts damaged images and whole ones, by the name of a camera or a topic."""

    def __init__(self) -> None:
        self.whole: Counter[str] = Counter()
        self.damaged: Counter[str] = Counter()
        self._last: dict[str, DamagedError] = {}

    def add(self, name: str, error: DamagedError | None) -> None:
        """Takes note of an image, with what is wrong with it; None: nothing is."""
        if error is None:
            self.whole[name] += 1
            return
        self.damaged[name] += 1
        self._last[name] = error

    def told(self, name: str) -> str:
        """How many were damaged of how many, of a name that has any, and what was wrong with the last."""
        count = self.damaged[name]
        return f"{several(count, 'damaged image')} of {count + self.whole[name]}; the last: {self._last[name]}"


class DamagedImages:
    """Those that the sets of a run go without, camera by camera."""

    def __init__(self) -> None:
        self._count = DamageCount()

    def add_whole(self, camera: str) -> None:
        """Takes note of an image that could be used."""
        self._count.add(camera, None)

    def add(self, camera: str, error: DamagedError) -> None:
        """Takes note of one that its set goes without. Raises `error` where none of the camera's can be used."""
        self._count.add(camera, error)
        if self._count.damaged[camera] > PATIENCE and not self._count.whole[camera]:
            raise error

    @property
    def counts(self) -> dict[str, int]:
        """How many of each camera's were, of those that had any."""
        return dict(self._count.damaged)

    @property
    def lines(self) -> tuple[str, ...]:
        """What there is to say, a line for each camera."""
        return tuple(f"camera {name}: left out {self._count.told(name)}" for name in self._count.damaged)
