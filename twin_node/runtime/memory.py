"""What this process holds of memory."""

from __future__ import annotations

import resource
from pathlib import Path


def resident_bytes() -> int:
    """Memory that this process has now; the largest it has had where the system does not tell."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def peak_mb() -> float:
    """The most that this process has held.

    `getrusage` would tell no less than what the process that started it held: a peak goes over to a program's children.
    """
    try:
        lines = Path("/proc/self/status").read_text().splitlines()
        return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM:")) / 1024
    except (OSError, StopIteration):
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
