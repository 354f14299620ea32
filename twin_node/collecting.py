"""How often a process of ours looks for garbage."""

from __future__ import annotations

import atexit
import gc

RARELY = 50_000
"""Objects that may come, more than go, between two looks for garbage among the youngest."""


def collect_rarely() -> None:
    """For a process of our own, before it loads anything: looks for garbage seldom, and no more when it ends.

    What commands load makes some hundred thousand objects, and all of them stay. To go through them again and again, as
    Python does for every 700 that come, took a quarter of the processor time until a command began and had ended.
    """
    gc.set_threshold(RARELY, 10, 10)
    atexit.unregister(gc.freeze)
    atexit.register(gc.freeze)
