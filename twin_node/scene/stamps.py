"""Stamps of records: whole nanoseconds, as Python counts."""

from __future__ import annotations

import numpy as np


def count_as_python(record: object) -> None:
    """Turns a frozen record's `stamp` that NumPy counts into Python's: differences of unsigned ones wrap around."""
    stamp = vars(record)["stamp"]
    if isinstance(stamp, np.integer):
        object.__setattr__(record, "stamp", int(stamp))
