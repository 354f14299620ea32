"""The errors of the last seconds, and their quantile over what is now expected of them."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np

from twin_node.forecast.kernels import kernels
from twin_node.forecast.part_requests import QuantileRequest
from twin_node.native_library import addresses_of
from twin_node.scene import Float64


class PastErrors:
    """Errors that came due in the last seconds, newer ones counting more.

    They stand one after the other in arrays with room at the end, so that a quantile is a few passes over all of them.
    """

    def __init__(self, cues: int, memory_s: float) -> None:
        """`cues`: of each error's scale; `memory_s`: time constant in which errors lose their say, s."""
        self._memory_s = memory_s
        self._cues = np.zeros((_ROOM, cues))
        self._logs = np.zeros(_ROOM)
        self._weights = np.zeros(_ROOM)
        """As of `_origin`: all lose their say alike."""
        self._origin = 0.0
        self._entries: deque[_Entry] = deque()
        self._end = 0

    def enter(self, time: float, cues: Float64, logs: Float64, elapsed_s: float) -> None:
        """Takes in the logarithms [n] of errors at `time` (s) of nodes with `cues` [n, C].

        `elapsed_s`: time since the last ones, that all of them together count for.
        """
        while self._entries and self._entries[0].time < time - _KEPT * self._memory_s:
            self._entries.popleft()
        if not self._entries:
            self._origin, self._end = time, 0
        if self._end + len(logs) > len(self._logs) or time - self._origin > _LONGEST * self._memory_s:
            self._move_up(time, len(logs))
        here = slice(self._end, self._end + len(logs))
        self._cues[here], self._logs[here] = cues, logs
        self._weights[here] = elapsed_s / len(logs) * np.exp((time - self._origin) / self._memory_s)
        self._entries.append(_Entry(time, self._end))
        self._end = here.stop

    def log_quantile(self, now: float, slopes: Float64, share: float) -> float:
        """Logarithm of the quantile that holds a `share` of the errors over what is expected of them.

        `slopes` [C]: of the logarithm of the expected error, by its cues.
        """
        first, fresh = self._entries[0].first, float(np.exp((self._origin - now) / self._memory_s))
        kept = slice(first, self._end)
        past = Past(self._cues[kept], self._logs[kept], self._weights[kept], fresh)
        return _LOG_RANGE[0] + _BIN * (bin_of(past, slopes, share) + 1)

    def _move_up(self, time: float, more: int) -> None:
        """Makes room at the end for so many more, and weights as of `time` (s)."""
        first = self._entries[0].first if self._entries else 0
        count = self._end - first
        room = max(2 * (count + more), _ROOM)
        self._cues, self._logs, self._weights = (
            np.concatenate([rows[first : self._end], np.zeros((room - count, *rows.shape[1:]))])
            for rows in (self._cues, self._logs, self._weights)
        )
        self._weights *= np.exp((self._origin - time) / self._memory_s)
        self._entries = deque(_Entry(entry.time, entry.first - first) for entry in self._entries)
        self._origin, self._end = time, count


class Past(NamedTuple):
    """n past errors."""

    cues: Float64
    """[n, C] of each one's scale."""
    logs: Float64
    """[n] their logarithms."""
    weights: Float64
    """[n]."""
    fresh: float
    """What all weights are multiplied by, for the time since."""


def bin_of(past: Past, slopes: Float64, share: float) -> int:
    """Number of the bin at whose end a `share` of the errors is held; `slopes` [C] tell what is expected of them.

    Compiled; `bin_of_reference` where that cannot be.
    """
    compiled = kernels()
    if compiled is None:
        return bin_of_reference(past, slopes, share)
    sizes, limits = (len(past.logs), _BINS, len(slopes)), (_LOG_RANGE[0], _BIN, past.fresh, share, _SLACK)
    given = (past.cues, past.logs, past.weights, np.ascontiguousarray(slopes))  # alive until the call is over
    found = compiled.call(QuantileRequest(*sizes, *limits, *addresses_of(*given)))
    if found < 0:
        raise MemoryError("forecast: no memory to find a quantile of errors in")
    return found


def bin_of_reference(past: Past, slopes: Float64, share: float) -> int:
    """What `bin_of` does."""
    logs = past.logs - past.cues @ slopes
    bins = np.clip(((logs - _LOG_RANGE[0]) / _BIN).astype(np.int64), 0, _BINS - 1)
    held = np.cumsum(np.bincount(bins, past.weights, _BINS)) * past.fresh
    return min(int(np.searchsorted(held, share * held[-1] - _SLACK)), _BINS - 1)


class _Entry(NamedTuple):
    """Errors that came due at one time."""

    time: float
    """s."""
    first: int
    """Their first row."""


_ROOM = 1024
"""Errors that there is room for at first."""
_KEPT = 4.0
"""Errors are kept for so many time constants."""
_LONGEST = 50.0
"""Time constants after which weights are told as of a later time: their exponentials must stay finite."""
_LOG_RANGE = (-12.0, 4.0)
_BIN = 0.01
_BINS = round((_LOG_RANGE[1] - _LOG_RANGE[0]) / _BIN)
_SLACK = 1e-12
"""A quantile may hold so much less than its share: what rounding takes."""
