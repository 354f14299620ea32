"""The numbers that users set, their ranges, and the one error for what lies outside."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from twin_node.errors import TwinError


@dataclass(frozen=True)
class Range:
    """Finite numbers from `least` to `most`."""

    least: float = 0
    most: float = math.inf
    """Infinity: no bound; infinity itself is in no range, nor is NaN."""
    above: bool = False
    """Whether `least` itself is left out."""

    def holds(self, value: float) -> bool:
        """Whether a number lies in the range."""
        is_above = value > self.least if self.above else value >= self.least
        return is_above and value <= self.most and value < math.inf

    def __str__(self) -> str:
        least = f"{self.least:.15g}"
        if self.most == math.inf:
            return f"a number above {least}" if self.above else f"a number of {least} or more"
        most = f"{self.most:.15g}"
        return f"more than {least} and at most {most}" if self.above else f"{least} to {most}"


POSITIVE = Range(above=True)
NOT_NEGATIVE = Range()
SHARE = Range(0, 1)
PORTS = Range(1, 65535)
"""Of TCP and UDP, where one is meant."""
WIDTHS_PX = Range(16, 16_384)
"""Of working images, px: below nothing is seen, and no camera has more."""


def is_number(word: str | bytes) -> bool:
    """Whether a word of a file is a number as `float` reads it, be it finite or not."""
    try:
        float(word)
    except ValueError:
        return False
    return True


def within_s(length_s: float) -> str:
    """The times within a length, s, in whole ms: none that lies beyond its end, however that would be rounded."""
    return f"0 to {math.floor(round(length_s * 1e9) / 1e6) / 1e3:.3f} s"


def check_ranges(parameters: object, error: type[TwinError], where: str, **ranges: Range) -> None:
    """Raises `error`, naming `where` and the field, for the first field of `parameters` outside of its range."""
    for name, allowed in ranges.items():
        found = getattr(parameters, name)
        if not allowed.holds(found):
            told = str(found) if isinstance(found, int) else f"{found:.15g}"  # no float holds every integer
            raise error(f"{where}{name}: expected {allowed}, found {told}; leave it out for what ships")
