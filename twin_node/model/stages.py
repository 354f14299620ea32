"""Who wants to know how far an update has come, and who says whether there is time for more: hooks for the caller."""

from __future__ import annotations

from collections.abc import Callable

OnStage = Callable[[str], None]
"""Called with the name of each stage of an update when that stage has ended."""


Proceed = Callable[[], bool]
"""Asked between two slices of work, of a millisecond or two each, whether there is time for the next."""


def unwatched(_: str) -> None:
    """Nobody wants to know."""


def unhurried() -> bool:
    """There always is."""
    return True
