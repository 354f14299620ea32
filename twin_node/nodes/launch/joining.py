"""Tells whether the routers of other machines answer that a launch's own router is to be joined to."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

PATIENCE_S = 3.0
"""A router that is there is joined by then, s; one that is begun at the same time may take longer, and is told of."""
SETTLES_S = 10.0
"""By then what there is on the other machines is known here, even by a slow link, s."""


class Joining:
    """Looks after the way to other machines: where it is missing nothing else fails, and nobody says anything."""

    def __init__(self, routers: Sequence[str]) -> None:
        """`routers`: addresses that the launch's router was told; empty ones are none."""
        self._addresses = ", ".join(router for router in routers if router)
        self._since: float | None = None
        """When the router was first looked at, s."""
        self._was_joined: bool | None = None
        """What is known; None: nothing yet."""
        self._joined: float | None = None
        """When it was first joined, s."""

    def is_fresh(self, now: float) -> bool:
        """Whether the other machines have been there for so short a time that not all of theirs may be known."""
        return self._joined is not None and now - self._joined <= SETTLES_S

    def news(self, router: Any, now: float) -> str | None:
        """What has changed, in words; `router`: the launch's own, `now`: s of a clock that never goes back."""
        if not self._addresses:
            return None
        self._since = now if self._since is None else self._since
        is_joined = bool(router.info.routers_zid())
        self._joined = now if is_joined and self._joined is None else self._joined
        is_early = self._was_joined is None and now - self._since <= PATIENCE_S
        if is_joined is self._was_joined or (is_early and not is_joined):
            return None
        before, self._was_joined = self._was_joined, is_joined
        if is_joined:
            return None if before is None else f"{self._addresses}: joined"
        if before:
            return (
                f"{self._addresses}: no router answers there any more, so nothing comes from that machine; it is tried "
                "again and again: look at its launch, and at the link"
            )
        return (
            f"{self._addresses}: no router answers there, so nothing comes from that machine; it is tried again and "
            "again: begin the launch that listens there, or correct the address (launch: zenoh: {routers}); a firewall "
            "must let its port through"
        )
