"""What the graph costs and survives: latency over processes, idle load, kills, recorders."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import psutil

from twin_node.bench.graph_run import GraphRun, running
from twin_node.messages import convert
from twin_node.nodes.launch.launch_file import LaunchPlan, in_one_process, read_launch_file
from twin_node.nodes.topics import SEPARATION

QUICK = ("synchronizer.width:=64", "synchronizer.max_rate_hz:=10.0")
"""A light model, so that the graph is measured and not the twin: what it computes is the same in both runs."""
SOURCES = ("cell",)


@dataclass(frozen=True)
class Percentiles:
    """Of a sample of latencies, ms; NaN without samples."""

    count: int
    p50: float
    p99: float
    smallest: float


@dataclass(frozen=True)
class LatencyFigures:
    """From a camera's stamp to the speed decision made of it, as another process hears it."""

    processes: Percentiles
    """A process per node: cell, twin, arm, viewer, recorder, and this listener as the sixth."""
    one_process: Percentiles
    p50_overhead_ms: float
    p99_overhead_ms: float


@dataclass(frozen=True)
class IdleFigures:
    """The graph without images."""

    core_share: float
    """Processor time of all its processes, share of one core."""
    by_process: tuple[tuple[str, float], ...]


@dataclass(frozen=True)
class KillFigures:
    """`kill -9` of each process in turn."""

    kills: int
    restart_s_max: float
    """Longest time from the kill until the process's nodes were active again, s."""
    restart_s_median: float
    by_process: tuple[tuple[str, float], ...]
    """Median per process, s."""
    orphans: int
    """Processes of the launch that were left when it had ended."""


def cell_plan(*arguments: str, output: str = "") -> LaunchPlan:
    """The simulated cell's launch with the scenario's arm."""
    given = ["arm:=scenario", *arguments, *([f"output:={output}"] if output else [])]
    return read_launch_file("launch/sim_cell.yaml", given, QUICK)


def latency(seconds: float, rounds: int, output: Callable[[int], str]) -> LatencyFigures:
    """Runs of both kinds in turn, `rounds` of each; `output(i)`: where run i records."""
    apart: list[float] = []
    together: list[float] = []
    for i in range(rounds):
        plan = cell_plan(output=output(i))
        apart += _latencies_ms(plan, seconds)
        together += _latencies_ms(in_one_process(cell_plan(output=output(rounds + i))), seconds)
    a, b = _percentiles(apart), _percentiles(together)
    return LatencyFigures(a, b, a.p50 - b.p50, a.p99 - b.p99)


def idle(seconds: float) -> IdleFigures:
    """The simulated cell's graph without the cell: nodes that wait for images."""
    plan = cell_plan()
    plan = replace(plan, processes=tuple(p for p in plan.processes if p.name not in SOURCES))
    with running(plan) as run:
        run.spin(2.0)
        names = run.launcher.children()
        before = {name: cpu_s(pid) for name, pid in names.items()}
        begun = time.monotonic()
        time.sleep(seconds)
        passed = time.monotonic() - begun
        shares = {name: (cpu_s(pid) - before[name]) / passed for name, pid in names.items()}
    return IdleFigures(sum(shares.values()), tuple(sorted(shares.items())))


def kills(each: int) -> KillFigures:
    """Every process of the simulated cell's graph, `each` times."""
    plan = cell_plan()
    times: dict[str, list[float]] = {process.name: [] for process in plan.processes}
    seen: set[int] = set()
    with running(plan) as run:
        for _ in range(each):
            for name, found in times.items():
                seen |= set(run.launcher.children().values())
                found.append(_killed(run, name))
        seen |= set(run.launcher.children().values())
    every = [t for found in times.values() for t in found]
    medians = tuple((name, float(np.median(found))) for name, found in times.items())
    left = sum(psutil.pid_exists(pid) for pid in seen)
    return KillFigures(len(every), max(every), float(np.median(every)), medians, left)


def _killed(run: GraphRun, name: str) -> float:
    """Kills a process; seconds until another one in its place is active."""
    run.wait_until(lambda: run.launcher.is_whole, "the graph was not whole")
    before = run.launcher.children()[name]
    begun = time.monotonic()
    os.kill(before, signal.SIGKILL)
    run.wait_until(lambda: run.launcher.active().get(name, before) != before, f"{name} was not started again")
    return time.monotonic() - begun


def _latencies_ms(plan: LaunchPlan, seconds: float) -> list[float]:
    """From the evidence's newest image to when the decision is heard here, ms; the first second is left out."""
    found: list[float] = []

    def hear(message: object) -> None:
        separation = convert.separation_from_message(message)
        key = separation.evidence_stamp
        if key and key != newest[0]:
            newest[0] = key
            found.append((time.time_ns() - key) / 1e6)

    newest = [0]
    with running(plan) as run:
        run.listen(SEPARATION, hear)
        run.spin(60.0, lambda: len(found) >= 10)
        found.clear()
        run.spin(seconds)
    return found


def _percentiles(samples: Sequence[float]) -> Percentiles:
    if not samples:
        return Percentiles(0, float("nan"), float("nan"), float("nan"))
    return Percentiles(
        len(samples), float(np.percentile(samples, 50)), float(np.percentile(samples, 99)), float(min(samples))
    )


def cpu_s(pid: int) -> float:
    """Processor time of a process, s."""
    times = psutil.Process(pid).cpu_times()
    return float(times.user + times.system)
