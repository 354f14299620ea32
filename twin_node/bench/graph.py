"""What the graph costs and survives: latency over processes, idle load, kills, recorders."""

from __future__ import annotations

import os
import signal
import time
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import psutil
import yaml

from twin_node import resources
from twin_node.arm import LimiterParameters
from twin_node.bench.graph_run import GraphRun, Percentiles, cpu_s, percentiles, running
from twin_node.messages import convert
from twin_node.nodes.launch.launch_file import LaunchPlan, in_one_process, read_launch_file
from twin_node.nodes.topics import FRUSTA, JOINT_STATES, OBSTACLES, SEPARATION

QUICK = ("synchronizer.width:=64", "synchronizer.max_rate_hz:=10.0", "size.name:=given")
"""A light model, so that the graph is measured and not the twin: what it computes is the same in both runs."""
_LIGHT = {"width": 160, "height": 120, "rate_hz": 10.0, "jitter_ms": 1.0}
"""Cameras that two cores render with time to spare: else latency is the wait for a core, in any number of processes."""
EVIDENCE = ("cell", "twin")
"""Processes without which no forecast comes: the arm must not be fast while they are down."""
SPEAKS_ON = {"cell": JOINT_STATES, "twin": OBSTACLES, "arm": SEPARATION, "viewer": FRUSTA}
"""A topic of each process by which it is known to work."""


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
    works_s_max: float
    """Longest time from the kill until the process published again, s: the twin has learned its scene anew by then."""
    works_s_median: float
    fast_decisions: int
    """Decisions above the arm's slow speed between two deadlines after a kill and the new process's first message."""
    orphans: int
    """Processes of the launch that were left when it had ended."""


@dataclass(frozen=True)
class _Kill:
    """What followed one kill."""

    restart_s: float
    works_s: float
    fast_decisions: int


def cell_plan(*arguments: str, output: str = "") -> LaunchPlan:
    """The simulated cell's launch with the scenario's arm."""
    given = ["arm:=scenario", *arguments, *([f"output:={output}"] if output else [])]
    return read_launch_file("launch/sim_cell.yaml", given, QUICK)


def blind_plan() -> LaunchPlan:
    """The same without the cell, so that no image comes."""
    plan = cell_plan()
    return replace(plan, processes=tuple(p for p in plan.processes if p.name != "cell"))


def latency(seconds: float, rounds: int, folder: Path) -> LatencyFigures:
    """Runs of both kinds in turn, `rounds` of each; scenario and recordings go into `folder`."""
    apart: list[float] = []
    together: list[float] = []
    scenario = folder / "light.yaml"
    whole = [yaml.safe_load(resources.find(f"sim/{name}.yaml").read_text("utf-8")) for name in ("cell", "demo")]
    light = {key: value for part in whole for key, value in part.items() if key != "extends"} | {"sensing": _LIGHT}
    scenario.write_text(yaml.safe_dump(light), "utf-8")
    for i in range(rounds):
        plans = [cell_plan(f"scenario:={scenario}", output=str(folder / f"latency_{i}_{n}")) for n in range(2)]
        apart += _latencies_ms(plans[0], seconds)
        together += _latencies_ms(in_one_process(plans[1]), seconds)
    a, b = percentiles(apart), percentiles(together)
    return LatencyFigures(a, b, a.p50 - b.p50, a.p99 - b.p99)


def idle(seconds: float) -> IdleFigures:
    """The simulated cell's graph without the cell: nodes that wait for images."""
    with running(blind_plan()) as run:
        run.wait_until(lambda: run.spin(0.1) or run.launcher.is_whole, "the graph was not whole")
        run.spin(2.0)
        names = run.launcher.children() | {f"{name}, spare": pid for name, pid in run.launcher.spares().items()}
        before = {name: cpu_s(pid) for name, pid in names.items()}
        begun = time.monotonic()
        time.sleep(seconds)
        passed = time.monotonic() - begun
        shares = {name: (cpu_s(pid) - before[name]) / passed for name, pid in names.items()}
    return IdleFigures(sum(shares.values()), tuple(sorted(shares.items())))


def kills(each: int) -> KillFigures:
    """Every process of the simulated cell's graph, `each` times."""
    plan = cell_plan()
    found: dict[str, list[_Kill]] = {process.name: [] for process in plan.processes}
    seen: set[int] = set()
    with running(plan) as run:
        ear = _Ear(run)
        for _ in range(each):
            for name, kills_of_it in found.items():
                seen |= _processes(run)
                kills_of_it.append(_killed(run, ear, name))
        seen |= _processes(run)
    every = [kill for kills in found.values() for kill in kills]
    restarts, works = [kill.restart_s for kill in every], [kill.works_s for kill in every]
    return KillFigures(
        kills=len(every),
        restart_s_max=max(restarts),
        restart_s_median=float(np.median(restarts)),
        by_process=tuple((name, float(np.median([k.restart_s for k in kills]))) for name, kills in found.items()),
        works_s_max=max(works),
        works_s_median=float(np.median(works)),
        fast_decisions=sum(kill.fast_decisions for kill in every),
        orphans=sum(psutil.pid_exists(pid) for pid in seen),
    )


def _processes(run: GraphRun) -> set[int]:
    return {*run.launcher.children().values(), *run.launcher.spares().values()}


class _Ear:
    """When each process was last heard, and what the arm was told."""

    def __init__(self, run: GraphRun) -> None:
        self.heard_at: dict[str, float] = {}
        """Monotonic, s."""
        self.told: list[tuple[float, float]] = []
        """When (monotonic, s), and the speed fraction."""
        for name, topic in SPEAKS_ON.items():
            run.listen(topic, partial(self._hear, name))

    def _hear(self, name: str, message: object) -> None:
        self.heard_at[name] = time.monotonic()
        if name == "arm":
            self.told.append((self.heard_at[name], convert.separation_from_message(message).speed_fraction))


def _killed(run: GraphRun, ear: _Ear, name: str) -> _Kill:
    """Kills a process, and waits until another one in its place is active, and is heard."""
    run.wait_until(lambda: run.spin(0.05) or run.launcher.is_whole, "the graph was not whole")
    run.wait_until(lambda: run.spin(0.05) or len(ear.heard_at) == len(SPEAKS_ON), "not every process was heard")
    before = run.launcher.children()[name]
    begun = time.monotonic()
    os.kill(before, signal.SIGKILL)
    run.wait_until(
        lambda: run.spin(0.01) or run.launcher.active().get(name, before) != before, f"{name} was not started again"
    )
    active = time.monotonic()
    run.wait_until(lambda: run.spin(0.01) or ear.heard_at[name] > active, f"{name} was not heard again")
    heard = ear.heard_at[name]
    limiter = LimiterParameters()
    fast = [at for at, fraction in ear.told if fraction > limiter.slow_fraction]
    unsafe = sum(begun + 2 * limiter.deadline_s < at < heard for at in fast) if name in EVIDENCE else 0
    return _Kill(active - begun, heard - begun, unsafe)


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
