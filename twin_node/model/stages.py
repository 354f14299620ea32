"""Who wants to know how far an update has come: a hook for measurements, which the model itself never reads."""

from __future__ import annotations

from collections.abc import Callable

OnStage = Callable[[str], None]
"""Called with the name of each stage of an update when that stage has ended."""


def unwatched(_: str) -> None:
    """Nobody wants to know."""
