"""`twin_node bench viewer --latency`: what two visitors of the page cost the twin, in its own p99 latency."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from twin_node.bench.errors import BenchError
from twin_node.bench.graph_run import cpu_s, running
from twin_node.bench.visitors import free_port, visiting
from twin_node.messages import Message, convert
from twin_node.nodes.launch.launch_file import read_launch_file
from twin_node.nodes.topics import STATUS

VISITORS = 2
LONGEST_S = 600.0
"""Longest wait for the end of a log, s."""


@dataclass(frozen=True)
class Run:
    """One replay in real time."""

    p50_ms: float
    p99_ms: float
    """From the evidence's newest image to the obstacles made of it, over the last 10 s (`nodes.latency.MEMORY_NS`)."""
    sets: int
    """That went through the twin."""
    twin_ms_per_set: float
    """Processor time of the twin's process per set: what others on the machine take from it does not count."""
    page_cores: float = 0.0
    """Processor time of the page's process, share of one core."""
    seen_mb: float = 0.0
    """What each visitor was sent, mean, megabytes."""


@dataclass(frozen=True)
class ViewerCost:
    """Replays without a page and with one that is watched, in turn."""

    without: tuple[Run, ...]
    watched: tuple[Run, ...]
    p99_cost_ms: float
    """Median of the watched runs less that of the others."""
    twin_cost_ms_per_set: float
    """The same of the twin's processor time."""

    def as_json(self) -> dict[str, object]:
        """The stable names that `--json` prints."""
        return asdict(self)


def cost(log: Path, rounds: int, settings: tuple[str, ...] = ()) -> ViewerCost:
    """Replays `log` `rounds` times each way; `settings`: NODE.KEY:=VALUE of the launch file.

    Raises `BenchError` where a replay says nothing of its latency.
    """
    without, watched = [], []
    for _ in range(rounds):
        without.append(_replayed(log, settings, None))
        port = free_port()
        with visiting(port, VISITORS, range(0)) as visitors:
            run = _replayed(log, settings, port)
            for visitor in visitors:
                visitor.wait()
            seen = [visitor.sent().data for visitor in visitors]
            watched.append(replace(run, seen_mb=float(np.mean(seen)) / 1e6))
    return ViewerCost(
        tuple(without), tuple(watched), _cost(without, watched, "p99_ms"), _cost(without, watched, "twin_ms_per_set")
    )


def _cost(without: Sequence[Run], watched: Sequence[Run], figure: str) -> float:
    return float(np.median([getattr(r, figure) for r in watched]) - np.median([getattr(r, figure) for r in without]))


def _replayed(log: Path, settings: tuple[str, ...], port: int | None) -> Run:
    """One run of the launch file of replays to the log's end; `port`: of the page, None without one."""
    given = [f"log:={log}", f"viewer:={port is not None}"]
    page = [] if port is None else [f"viewer.port:={port}"]
    spent: list[_Spent] = []
    with running(read_launch_file("launch/replay.yaml", given, [*settings, *page])) as run:
        run.listen(STATUS, lambda message: spent.append(_Spent.at(message, run.launcher.children())))
        run.spin(LONGEST_S, lambda: "player" not in run.launcher.children())
    if len(spent) < 2 or not math.isfinite(spent[-1].status.latency_p99_ms):
        raise BenchError(f"{log}: expected the twin to tell its latency, found it silent; is the log long enough?")
    first, last = spent[0], spent[-1]
    sets, seconds = last.status.sets - first.status.sets, last.at_s - first.at_s
    return Run(
        last.status.latency_p50_ms,
        last.status.latency_p99_ms,
        last.status.sets,
        1e3 * (last.twin_s - first.twin_s) / max(sets, 1),
        (last.page_s - first.page_s) / seconds,
    )


@dataclass(frozen=True)
class _Spent:
    """What the twin says of itself, and the processor time spent by then."""

    status: convert.Status
    at_s: float
    twin_s: float
    page_s: float

    @staticmethod
    def at(message: Message, processes: Mapping[str, int]) -> _Spent:
        status = convert.status_from_message(message)
        twin, page = (cpu_s(processes[name]) if name in processes else 0.0 for name in ("twin", "page"))
        return _Spent(status, time.monotonic(), twin, page)
