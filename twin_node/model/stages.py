"""Who wants to know how far an update has come, and who says whether there is time for more: hooks for the caller."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

OnStage = Callable[[str], None]
"""Called with the name of each stage of an update when that stage has ended."""


Proceed = Callable[[], bool]
"""Asked between two slices of work, of a millisecond or two each, whether there is time for the next."""


LeftS = Callable[[], float]
"""Asked how many seconds are left until the state of a set should be out; negative once it is late."""


def unwatched(_: str) -> None:
    """Nobody wants to know."""


def unhurried() -> bool:
    """There always is."""
    return True


def exhausted() -> bool:
    """There never is."""
    return False


def endless() -> float:
    """Nobody waits for it."""
    return math.inf


def granted(slices: int, then: Proceed = exhausted) -> Proceed:
    """There is time for so many, and from then on where `then` says so."""
    left = iter(range(slices))
    return lambda: next(left, None) is not None or then()


class Sliced:
    """Work that can be let be after any of its slices, and gone on with later."""

    def __init__(self, slices: Iterator[None]) -> None:
        """`slices` does one more whenever it is asked for the next."""
        self._slices = slices
        self.has_begun = False
        self.is_done = False

    def go_on(self, proceed: Proceed) -> bool:
        """Goes on for as long as `proceed` says so before every slice; whether all is done."""
        while not self.is_done and proceed():
            self.has_begun = True
            self.is_done = next(self._slices, self) is self
        return self.is_done
