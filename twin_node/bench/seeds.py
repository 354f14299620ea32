"""`twin_node bench occupancy SCENARIO --seeds N`: a scenario of the simulated cell, scored with many seeds."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from twin_node.bench.occupancy import OURS, OccupancyBench, OccupancyBenchParameters, run
from twin_node.cell import load_scenario, write_log


@dataclass(frozen=True)
class SeedsBench:
    """The scores of one scenario over all seeds."""

    scenario: str
    runs: tuple[OccupancyBench, ...]
    """One per seed, counted from 1."""

    def as_json(self) -> dict[str, object]:
        """The stable names that `--json` prints: means over the seeds, and the least recalls of ours."""
        names = self.runs[0].scores
        ours = [run.scores[OURS] for run in self.runs if OURS in run.scores]
        space = [asdict(run.space) for run in self.runs if run.space is not None]
        equal = [run.persistence_equal_recall.volume_l for run in self.runs if run.persistence_equal_recall is not None]
        return {
            "scenario": self.scenario,
            "seeds": len(self.runs),
            **{name: _means([asdict(run.scores[name]) for run in self.runs if name in run.scores]) for name in names},
            "least": {
                "recall": min((score.recall for score in ours if score.recall is not None), default=None),
                "recall_new": min((score.recall_new for score in ours if score.recall_new is not None), default=None),
            },
            "persistence_equal_recall": {"volume_l": float(np.mean(equal)) if equal else None},
            **_means(space),
            **_means([{"coverage": run.coverage, "update_ms": run.update_ms} for run in self.runs]),
            "target": self.runs[0].target,
        }


def run_seeds(
    scenario: str,
    seeds: int,
    parameters: OccupancyBenchParameters,
    progress: Callable[[Iterable[int]], Iterable[int]] = iter,
) -> SeedsBench:
    """Writes and scores a log per seed; the logs go when they are scored. `progress` may wrap the seeds.

    Raises `CellError` or `ResourceError` for a scenario that is none, and the errors of `bench.occupancy.run`.
    """
    read = load_scenario(scenario)
    arm = parameters.chain.arm
    chain = parameters.chain if read.arm is None else replace(parameters.chain, arm=replace(arm, model=read.arm.model))
    parameters = replace(parameters, chain=chain)
    runs = []
    for seed in progress(range(1, seeds + 1)):
        with tempfile.TemporaryDirectory(prefix="twin_node-") as folder:
            log = Path(folder) / "scenario.mcap"
            write_log(read.with_seed(seed), log)
            runs.append(run(log, parameters=parameters))
    return SeedsBench(read.name, tuple(runs))


def _means(rows: list[dict[str, float | None]]) -> dict[str, float | None]:
    """Means of each key over the rows that know it."""
    if not rows:
        return {}
    known = {key: [row[key] for row in rows if row[key] is not None] for key in rows[0]}
    return {key: float(np.mean(np.array(values, np.float64))) if values else None for key, values in known.items()}
