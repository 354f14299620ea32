"""Few of many, evenly picked."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Generic, TypeVar

import numpy as np

T = TypeVar("T")


def thinned(items: Sequence[T], most: int) -> list[T]:
    """At most `most` of the items in their order, evenly spread; the last of several is the last of all."""
    chosen = np.linspace(0, len(items) - 1, min(len(items), most)).round().astype(int)
    return [items[i] for i in chosen]


class Thinning(Generic[T]):
    """The same of what comes one after another: twice as many are held at most, and spread to half their distance."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._held: list[T] = []
        self._every = 1
        """Of so many that come one is held."""
        self._came = 0

    @property
    def held(self) -> int:
        """How many are held."""
        return len(self._held)

    def add(self, item: T) -> None:
        """Takes in the next one."""
        if self._most and self._came % self._every == 0:
            if len(self._held) == 2 * self._most:
                self._held, self._every = self._held[::2], 2 * self._every
            if self._came % self._every == 0:
                self._held.append(item)
        self._came += 1

    def picked(self) -> list[T]:
        """At most so many of all that came, in their order."""
        return thinned(self._held, self._most)
