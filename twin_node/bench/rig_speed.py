"""How fast the simulated rig is: sets of images per second, without the twin."""

from __future__ import annotations

import itertools
import time
from dataclasses import dataclass

import numpy as np

from twin_node.bench.errors import BenchError
from twin_node.cell import CellSource, Scenario


@dataclass(frozen=True)
class RigSpeed:
    """Measured speed of a scenario's cameras."""

    rig_hz: float
    """Sets per second: the median of the seconds measured."""
    rig_hz_best: float
    """The best second: nearest to what an idle machine gives."""
    cpu_ms_per_set: float
    """Processor time of one set in the best second, all threads together: hardly moved by what else is running."""
    target_hz: float
    """The scenario's own rate."""
    cameras: int
    width: int
    height: int
    threads: int


def measure(scenario: Scenario, threads: int = 2, most_sets: int = 300) -> RigSpeed:
    """Renders a scenario's sets as fast as they come, RGB-D with noise, one second of scenario time at a time.

    Raises `BenchError` for a scenario that lasts no second and one set more.
    """
    source = CellSource(scenario, threads)
    per_second = max(round(scenario.sensing.rate_hz), 1)
    rates, costs, sets = [], [], iter(source)
    next(sets, None)  # starts the threads
    for _ in range(max(most_sets // per_second, 1)):
        begun, begun_cpu = time.perf_counter(), time.process_time()
        count = sum(1 for _ in itertools.islice(sets, per_second))
        if count < per_second:
            break
        rates.append(count / (time.perf_counter() - begun))
        costs.append((time.process_time() - begun_cpu) / count)
    if not rates:
        raise BenchError(
            f"scenario {scenario.name}: expected more than a second to measure, found {scenario.duration_s:g} s; give "
            "it a longer duration_s"
        )
    sensing = scenario.sensing
    return RigSpeed(
        rig_hz=float(np.median(rates)),
        rig_hz_best=max(rates),
        cpu_ms_per_set=1e3 * min(costs),
        target_hz=sensing.rate_hz,
        cameras=len(scenario.cameras),
        width=sensing.width,
        height=sensing.height,
        threads=threads,
    )
