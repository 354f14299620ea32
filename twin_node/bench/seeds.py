"""`twin_node bench occupancy SCENARIO --seeds N`: scenarios of the simulated cell, each scored with many seeds."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass, replace

import numpy as np

from twin_node.bench.occupancy import OURS, OccupancyBench, OccupancyBenchParameters, score_states
from twin_node.bench.truth import SeenThings
from twin_node.cell import CellSource, Scenario, load_scenario
from twin_node.forecast import default_grid
from twin_node.nodes.chain import make_model
from twin_node.scene import HORIZONS_NS, TwinState

ALL = "all"
SCENARIOS = ("reach_in", "thrown_ball", "conveyor", "retreat")
"""What `ALL` stands for: a person who reaches in, a ball, parcels and their sorter, a hand drawn back from the arm."""


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
        return {
            "scenario": self.scenario,
            "seeds": len(self.runs),
            **{name: _means([asdict(run.scores[name]) for run in self.runs if name in run.scores]) for name in names},
            "least": {
                "recall": min((score.recall for score in ours if score.recall is not None), default=None),
                "recall_new": min((score.recall_new for score in ours if score.recall_new is not None), default=None),
            },
            "persistence_equal_recall": {"volume_l": self._equal_recall_l},
            "volume_ratio": self.volume_ratio,
            **_means(space),
            **_means([{"coverage": run.coverage, "update_ms": run.update_ms} for run in self.runs]),
            "target": self.runs[0].target,
        }

    @property
    def volume_ratio(self) -> float | None:
        """Our moving volume over that of all that moves grown alike to the same recall; None where nothing was."""
        ours = [run.scores[OURS].moving_volume_l for run in self.runs if run.persistence_equal_recall is not None]
        known = [volume for volume in ours if volume is not None]
        return float(np.mean(known)) / self._equal_recall_l if known and self._equal_recall_l else None

    @property
    def row(self) -> tuple[str, ...]:
        """Its line of the table, in the order of `HEADINGS`."""
        means = _means([asdict(run.scores[OURS]) for run in self.runs if OURS in run.scores])
        space = _means([asdict(run.space) for run in self.runs if run.space is not None])
        shares = (means.get("recall"), means.get("recall_new"))
        return (
            self.scenario,
            *("" if share is None else f"{100 * share:.1f} %" for share in shares),
            *("" if litres is None else f"{litres:.0f} l" for litres in (means.get("moving_volume_l"),)),
            "" if self.volume_ratio is None else f"{self.volume_ratio:.2f}",
            *("" if late is None else f"{late:.0f} ms" for late in (space.get("vacated_free_ms_p95"),)),
            *("" if share is None else f"{100 * share:.1f} %" for share in (space.get("unseen_not_free"),)),
        )

    @property
    def _equal_recall_l(self) -> float | None:
        equal = [run.persistence_equal_recall.volume_l for run in self.runs if run.persistence_equal_recall is not None]
        return float(np.mean(equal)) if equal else None


HEADINGS = ("scenario", "recall", "of new space", "moving", "of equal recall", "vacated free, p95", "unseen not free")


def table(benches: Iterable[SeedsBench]) -> str:
    """A Markdown table, one scenario per line."""
    lines = (HEADINGS, ("---",) * len(HEADINGS), *(bench.row for bench in benches))
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def run_seeds(
    scenario: str,
    seeds: int,
    parameters: OccupancyBenchParameters,
    progress: Callable[[Iterable[int]], Iterable[int]] = iter,
) -> SeedsBench:
    """Simulates and scores a scenario per seed, rendered at the working width. `progress` may wrap the seeds.

    Raises `CellError` or `ResourceError` for a scenario that is none.
    """
    read = _small(load_scenario(scenario), parameters)
    arm = parameters.chain.arm
    chain = parameters.chain if read.arm is None else replace(parameters.chain, arm=replace(arm, model=read.arm.model))
    parameters = replace(parameters, chain=chain)
    return SeedsBench(read.name, tuple(_scored(read.with_seed(seed), parameters) for seed in progress(_counted(seeds))))


def _counted(seeds: int) -> range:
    return range(1, seeds + 1)


def _small(scenario: Scenario, parameters: OccupancyBenchParameters) -> Scenario:
    """The scenario at the working width, and no longer than asked for."""
    sensing, width = scenario.sensing, parameters.width or scenario.sensing.width
    sensing = replace(sensing, width=width, height=round(sensing.height * width / sensing.width))
    return replace(scenario, sensing=sensing, duration_s=min(scenario.duration_s, parameters.duration_s or np.inf))


def _scored(scenario: Scenario, parameters: OccupancyBenchParameters) -> OccupancyBench:
    source = CellSource(scenario)
    grid = default_grid(np.array(scenario.workspace), parameters.chain.grid.voxel_size)
    ahead_ns = round(parameters.latency_ms * 1e6) + HORIZONS_NS[-1]
    truth = SeenThings(source.simulated, grid, ahead_ns)
    model = make_model(parameters.chain)

    def states() -> Iterator[TwinState]:
        for frames in source:
            truth.look(frames)
            yield model.update(frames)

    return score_states(states(), grid, truth, parameters)


def _means(rows: list[dict[str, float | None]]) -> dict[str, float | None]:
    """Means of each key over the rows that know it."""
    if not rows:
        return {}
    known = {key: [row[key] for row in rows if row[key] is not None] for key in rows[0]}
    return {key: float(np.mean(np.array(values, np.float64))) if values else None for key, values in known.items()}
