"""`twin_node bench occupancy SCENARIO --seeds N`: scenarios of the simulated cell, each scored with many seeds."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from twin_node.bench.contenders import OURS
from twin_node.bench.equal_recall import EqualRecall
from twin_node.bench.occupancy import OccupancyBench, OccupancyBenchParameters, score_states
from twin_node.bench.seen import SeenSurfaces, SeenThings, Sightings
from twin_node.bench.simulated_arm import told_of_arm
from twin_node.bench.text_table import markdown_table, percent
from twin_node.cell import CellSource, Scenario, load_scenario
from twin_node.forecast import default_grid
from twin_node.forecast.comparison import Score
from twin_node.nodes.chain import make_model
from twin_node.scene import TwinState

ALL = "all"
SCENARIOS = ("reach_in", "thrown_ball", "conveyor", "retreat")
"""What `ALL` stands for: a person who reaches in, a ball, parcels and their sorter, a hand drawn back from the arm."""


@dataclass(frozen=True)
class SeedsBench:
    """The scores of one scenario over all seeds."""

    scenario: str
    runs: tuple[OccupancyBench, ...]
    """One per seed."""

    def as_json(self) -> dict[str, object]:
        """The stable names that `--json` prints: means over the seeds, and the least recalls of ours.

        They are those of what cameras saw (`seen.SeenSurfaces`); `whole_things` are the same of `seen.SeenThings`.
        """
        space = [asdict(run.space) for run in self.runs if run.space is not None]
        return {
            "scenario": self.scenario,
            "seeds": len(self.runs),
            **self.seen.as_json(),
            "whole_things": self.whole.as_json(),
            **_means(space),
            **_means([{"coverage": run.coverage, "update_ms": run.update_ms} for run in self.runs]),
            "target": self.runs[0].target,
        }

    @property
    def seen(self) -> SeedScores:
        """Against what cameras saw."""
        runs = [run for run in self.runs if run.scores]
        return SeedScores([run.scores for run in runs], [run.persistence_equal_recall for run in runs])

    @property
    def whole(self) -> SeedScores:
        """Against whole things."""
        runs = [run.whole_things for run in self.runs if run.whole_things is not None and run.whole_things.scores]
        return SeedScores([run.scores for run in runs], [run.persistence_equal_recall for run in runs])

    @property
    def row(self) -> tuple[str, ...]:
        """Its line of the table, in the order of `HEADINGS`."""
        space = _means([asdict(run.space) for run in self.runs if run.space is not None])
        litres = self.seen.ours.get("moving_volume_l")
        return (
            self.scenario,
            *self.seen.cells,
            "" if litres is None else f"{litres:.0f} l",
            *self.whole.cells,
            *("" if late is None else f"{late:.0f} ms" for late in (space.get("vacated_free_ms_p95"),)),
            percent(space.get("unseen_not_free")),
        )


@dataclass(frozen=True)
class SeedScores:
    """Scores of several seeds against one kind of truth."""

    runs: Sequence[Mapping[str, Score]]
    """By name, run by run."""
    equal: Sequence[EqualRecall | None]
    """Persistence grown to the recall of ours, run by run."""

    def as_json(self) -> dict[str, object]:
        """Means over the runs, and the least recalls of ours."""
        ours = [run[OURS] for run in self.runs]
        return {
            **{name: self._mean(name) for name in (self.runs[0] if self.runs else ())},
            "least": {
                "recall": min((score.recall for score in ours if score.recall is not None), default=None),
                "recall_new": min((score.recall_new for score in ours if score.recall_new is not None), default=None),
            },
            "persistence_equal_recall": {
                "volume_l": self._equal_recall_l,
                "reached_in": sum(one is not None for one in self.equal),
            },
            "volume_ratio": self.volume_ratio,
        }

    @property
    def ours(self) -> dict[str, float | None]:
        """Means of our scores."""
        return self._mean(OURS)

    @property
    def volume_ratio(self) -> float | None:
        """Our moving volume over that of all that moves grown alike to the same recall, of the runs in which some
        growth reaches it; None where there is none."""
        ours = [run[OURS].moving_volume_l for run, one in zip(self.runs, self.equal, strict=True) if one is not None]
        known = [volume for volume in ours if volume is not None]
        return float(np.mean(known)) / self._equal_recall_l if known and self._equal_recall_l else None

    @property
    def cells(self) -> tuple[str, ...]:
        """Recall, the same with what stands, recall of new space and volume ratio for the table."""
        ratio = "" if self.volume_ratio is None else f"{self.volume_ratio:.2f}"
        return (*(percent(self.ours.get(name)) for name in ("recall", "recall_held", "recall_new")), ratio)

    @property
    def _equal_recall_l(self) -> float | None:
        known = [one.volume_l for one in self.equal if one is not None]
        return float(np.mean(known)) if known else None

    def _mean(self, name: str) -> dict[str, float | None]:
        return _means([asdict(run[name]) for run in self.runs])


HEADINGS = (
    *("scenario", "recall", "with what stands", "of new space", "of equal recall", "moving"),
    *("whole things: recall", "with what stands", "of new space", "of equal recall"),
    *("vacated free, p95", "unseen not free"),
)


def table(benches: Iterable[SeedsBench]) -> str:
    """A Markdown table, one scenario per line."""
    return markdown_table(HEADINGS, (bench.row for bench in benches))


def run_seeds(
    scenario: str,
    seeds: range,
    parameters: OccupancyBenchParameters,
    progress: Callable[[Iterable[int]], Iterable[int]] = iter,
) -> SeedsBench:
    """Simulates and scores a scenario per seed, rendered at the working width. `progress` may wrap the seeds.

    Raises `CellError` or `ResourceError` for a scenario that is none.
    """
    read = _small(load_scenario(scenario), parameters)
    parameters = replace(parameters, chain=told_of_arm(parameters.chain, read))
    return SeedsBench(read.name, tuple(_scored(read.with_seed(seed), parameters) for seed in progress(seeds)))


def _small(scenario: Scenario, parameters: OccupancyBenchParameters) -> Scenario:
    """The scenario at the working width, and no longer than asked for."""
    scaled = scenario.at_width(parameters.chain.synchronizer.width or scenario.sensing.width)
    return replace(scaled, duration_s=min(scenario.duration_s, parameters.duration_s or np.inf))


def _scored(scenario: Scenario, parameters: OccupancyBenchParameters) -> OccupancyBench:
    source = CellSource(scenario)
    grid = default_grid(np.array(scenario.workspace), parameters.chain.grid.voxel_size)
    sightings = Sightings(source.simulated, grid)
    model = make_model(parameters.chain)

    def states() -> Iterator[TwinState]:
        for frames in source:
            sightings.look(frames)
            yield model.update(frames)

    return score_states(states(), grid, SeenSurfaces(sightings), parameters, SeenThings(sightings))


def _means(rows: list[dict[str, float | None]]) -> dict[str, float | None]:
    """Means of each key over the rows that know it."""
    if not rows:
        return {}
    known = {key: [row[key] for row in rows if row[key] is not None] for key in rows[0]}
    return {key: float(np.mean(np.array(values, np.float64))) if values else None for key, values in known.items()}
