"""`twin_node bench viewer --latency`: what two visitors of the page cost the twin, in its own p99 latency."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from twin_node.bench.errors import BenchError
from twin_node.bench.graph_run import running
from twin_node.bench.visitors import free_port, visiting
from twin_node.messages import convert
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
    """From the evidence's newest image to the obstacles made of it, over the last 300 sets."""
    sets: int
    """That went through the twin."""
    seen_mb: float
    """What each visitor was sent, mean, megabytes."""


@dataclass(frozen=True)
class ViewerCost:
    """Replays without a page and with one that is watched, in turn."""

    without: tuple[Run, ...]
    watched: tuple[Run, ...]
    p99_cost_ms: float
    """Median of the watched runs less that of the others."""

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
    p99_cost = float(np.median([r.p99_ms for r in watched]) - np.median([r.p99_ms for r in without]))
    return ViewerCost(tuple(without), tuple(watched), p99_cost)


def _replayed(log: Path, settings: tuple[str, ...], port: int | None) -> Run:
    """One run of the launch file of replays to the log's end; `port`: of the page, None without one."""
    given = [f"log:={log}", f"viewer:={port is not None}"]
    page = [] if port is None else [f"viewer.port:={port}"]
    said: list[convert.Status] = []
    with running(read_launch_file("launch/replay.yaml", given, [*settings, *page])) as run:
        run.listen(STATUS, lambda message: said.append(convert.status_from_message(message)))
        run.spin(LONGEST_S, lambda: "player" not in run.launcher.children())
    if not said or not math.isfinite(said[-1].latency_p99_ms):
        raise BenchError(f"{log}: expected the twin to tell its latency, found it silent; is the log long enough?")
    last = said[-1]
    return Run(last.latency_p50_ms, last.latency_p99_ms, last.sets, 0.0)
