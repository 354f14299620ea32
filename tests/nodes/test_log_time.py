"""The log's time as a player has it: read from one thread while another pauses it."""

from __future__ import annotations

import time

import pytest

from twin_node.nodes.live import player


def test_time_does_not_leap_as_it_is_paused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever played asked for it between two halves of it, and sent all that was due in as much time again."""
    now, left = [0], list[float]()
    monkeypatch.setattr(time, "monotonic_ns", lambda: now[0])

    class Asked(player._LogTime):
        """Is asked in whatever state it is."""

        def __setattr__(self, name: str, value: object) -> None:
            super().__setattr__(name, value)
            if hasattr(self, "is_paused") and not self.is_paused:
                left.append(self.seconds_until(100_000_000_000))

    log_time = Asked(1.0, is_paused=False)
    for now[0], paused in ((10_000_000_000, True), (30_000_000_000, False), (35_000_000_000, True)):
        log_time.pause(paused)
    assert left == [100.0, 90.0, 90.0, 85.0]
