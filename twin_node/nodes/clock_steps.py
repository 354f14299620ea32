"""Clocks that were set within a recording: from then on their stamps lie otherwise by the log's time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from twin_node.bag import LogReader
from twin_node.messages import header_stamp
from twin_node.nodes.player import Span
from twin_node.scene import Float64

WINDOW = 15
"""Messages before and after a step that it is told from: half a second at 30 Hz."""
BLOCK = 1 << 14
"""Windows that are looked at together: each is a copy, and a recording of an hour has millions."""
LEAST_STEP_NS = 50_000_000
"""Less may be a computer that has got more to do."""
STEADINESS = 0.25
"""Share of a step that delays on either side may differ by: where they grow and shrink, a disk or a link is slow."""
ALIKE = 0.9
"""What comes to so much of the largest step is taken to be that one, seen from a message or two beside it."""


@dataclass(frozen=True)
class ClockStep:
    """Where a clock was set anew."""

    recorded: int
    """When the last message before it was recorded, ns: stamps may be by a clock of their own."""
    step_ns: int
    """How far stamps went ahead, ns; below 0: back."""

    def told(self, start: int) -> str:
        """In words; `start`: of the log, ns."""
        return (
            f"stamps jump by {self.step_ns / 1e6:+.0f} ms against the time of recording, "
            f"{(self.recorded - start) / 1e9:.1f} s after the start, and stay so: its clock was set, or its way has "
            "changed; use what lies before or after it"
        )


def clock_step(stamps: Sequence[int], delays: Sequence[int]) -> ClockStep | None:
    """The largest step of a stream's clock; None where it has none, or too few messages.

    `stamps`: of its messages, ns; `delays`: from each stamp until the message was recorded, ns.
    """
    if len(delays) < 2 * WINDOW:
        return None
    told = np.array(delays, dtype=np.float64)
    middles, spreads = _levels(told)
    steps, spread = middles[:-WINDOW] - middles[WINDOW:], np.maximum(spreads[:-WINDOW], spreads[WINDOW:])
    sizes = np.abs(steps)
    is_step = (sizes >= LEAST_STEP_NS) & (spread <= STEADINESS * sizes)
    if not is_step.any():
        return None
    is_largest = is_step & (sizes >= ALIKE * sizes[is_step].max())
    row = int(np.argmin(np.where(is_largest, spread, np.inf)))
    last = row + _last_before(told[row : row + 2 * WINDOW], middles[row], middles[row + WINDOW])
    return ClockStep(int(stamps[last]) + int(delays[last]), round(steps[row]))


def _levels(told: Float64) -> tuple[Float64, Float64]:
    """Median and spread [N - WINDOW + 1] of every window of delays [N], ns."""
    windows = np.lib.stride_tricks.sliding_window_view(told, WINDOW)
    middles, spreads = np.empty(len(windows)), np.empty(len(windows))
    for first in range(0, len(windows), BLOCK):
        block = slice(first, first + BLOCK)
        middles[block] = np.median(windows[block], axis=1)
        lower, upper = np.quantile(windows[block], (0.1, 0.9), axis=1)
        spreads[block] = upper - lower
    return middles, spreads


def _last_before(delays: Float64, before: float, after: float) -> int:
    """Number of the last of `delays` (ns) before a step between two: on either side the fewest are of the other one."""
    is_after = np.abs(delays - after) < np.abs(delays - before)
    return int(np.argmin(np.cumsum(is_after) - np.cumsum(~is_after)))


def camera_clock_steps(log: LogReader, images: Mapping[str, str], span: Span) -> dict[str, ClockStep]:
    """Steps of cameras' clocks by camera; `images`: topic -> camera."""
    stamps: dict[str, list[int]] = {camera: [] for camera in images.values()}
    delays: dict[str, list[int]] = {camera: [] for camera in images.values()}
    for entry in log.messages(list(images), span.start_ns, span.stop_ns):
        stamp = header_stamp(entry.message)
        stamps[images[entry.topic]].append(stamp)
        delays[images[entry.topic]].append(entry.stamp - stamp)
    found = {camera: clock_step(stamps[camera], delays[camera]) for camera in stamps}
    return {camera: step for camera, step in found.items() if step is not None}
