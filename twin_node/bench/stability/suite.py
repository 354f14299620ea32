"""All failures at all levels, in processes of their own, and what the runs add up to."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace

import numpy as np
import torch

from twin_node.bench.contenders import BASELINES, OURS
from twin_node.bench.errors import BenchError
from twin_node.bench.stability.case import Case, CaseResult, run_case
from twin_node.bench.stability.failures import FAILURES, LONG, UNDISTURBED
from twin_node.bench.stability.pictures import PICTURES
from twin_node.bench.stability.scenes import WIDTH
from twin_node.bench.stability.scores import LEAST_RECALL, Pooled
from twin_node.bench.workers import spread
from twin_node.forecast import GridParameters
from twin_node.nodes.chain_parameters import ChainParameters

LEAST_PICTURE_DB = 15.0
"""A picture below this on the pixels that changed shows nothing of use: the first image for ever reaches 13 dB here."""
METHODS = (OURS, *BASELINES, *PICTURES)
OUR_PICTURES = "our_pictures"
"""Those of `OURS`, beside its forecasts, where methods are named that give way."""

Progress = Callable[[Iterable[CaseResult], int], Iterable[CaseResult]]
"""May wrap the results as they come; told how many there will be."""


def _small_chain() -> ChainParameters:
    """The chain as shipped, but for coarser voxels and a shorter first fit: both take time that tells nothing here."""
    chain = ChainParameters()
    model = replace(chain.model, seed=replace(chain.model.seed, steps=32))
    return replace(chain, model=model, grid=GridParameters(0.03))


@dataclass(frozen=True)
class StabilityParameters:
    """How much is run."""

    names: tuple[str, ...] = tuple(FAILURES)
    """Of `FAILURES`."""
    seeds: int = 1
    """Runs per level, of other noise and stamps."""
    seconds: float = 2.4
    """Usual length of a run, s."""
    stride: int = 2
    """Every so many sets of the 30 Hz rig are taken: 15 Hz is what a chain on two busy cores keeps up with."""
    width: int = WIDTH
    """Of the cameras' images, px."""
    most_levels: int | None = None
    """Levels per failure, the hardest and evenly below it; None: all."""
    processes: int = 2
    chain: ChainParameters = field(default_factory=_small_chain)

    def __post_init__(self) -> None:
        """Raises `BenchError` for a failure that is none."""
        for name in self.names:
            if name not in FAILURES:
                raise BenchError(f"--only {name}: expected one of {', '.join(FAILURES)}")


def _quick() -> StabilityParameters:
    chain = _small_chain()
    model = replace(chain.model, seed=replace(chain.model.seed, steps=16))
    names = tuple(name for name in FAILURES if name not in LONG)
    return StabilityParameters(names, seconds=1.6, width=96, most_levels=2, chain=replace(chain, model=model))


QUICK = _quick()
"""Two levels of each failure in short runs of small images, none of them long: shows that all run, that nothing fails
silently, and the roughest of the rest."""
MOST_WARNINGS = 0.01
"""Share of the time that the status may warn while nothing is wrong: more, and nobody listens."""


@dataclass(frozen=True)
class Level:
    """All runs of a failure at one level."""

    level: float
    methods: Mapping[str, Pooled]
    answered: float
    """Share of the rig's sets for which a forecast came."""
    warnings: tuple[str, ...]
    """What the status said, each once."""


@dataclass(frozen=True)
class Stability:
    """The whole suite."""

    failures: Mapping[str, Sequence[Level]]
    """Per failure, its levels in rising order."""
    isometry_error: float | None
    """Of the undisturbed runs: mean change of the distance of two Gaussians of a rigid box in 200 ms, as a share."""
    isometry_error_mm: float | None
    ghost: Mapping[str, float]
    """Of the undisturbed runs: energy left where something has just been, per kind of picture; 1: a whole ghost."""
    parameters: StabilityParameters

    def gives_way(self, method: str, failure: str) -> float | None:
        """The first level at which a method's forecasts, over all runs, recall less than `LEAST_RECALL`.

        Of a method that makes pictures alone, and of `OUR_PICTURES`, the first at which these give way. None: never.
        """
        if method == OUR_PICTURES:
            return self.pictures_give_way(OURS, failure)
        if method in PICTURES:
            return self.pictures_give_way(method, failure)
        recalls = ((one.level, one.methods[method].recall) for one in self.failures[failure])
        return next((level for level, recall in recalls if recall is not None and recall < LEAST_RECALL), None)

    def pictures_give_way(self, method: str, failure: str) -> float | None:
        """The first level at which a method's pictures are below `LEAST_PICTURE_DB` on the pixels that changed."""
        reached = ((one.level, one.methods[method].psnr_moving_db) for one in self.failures[failure])
        return next((level for level, db in reached if db is not None and db < LEAST_PICTURE_DB), None)

    def blocked_l(self, method: str, failure: str) -> float | None:
        """Moving and unknown space that a method reports 200 ms ahead, litres, mean over the levels."""
        return _mean([one.methods[method].blocked_l for one in self.failures[failure]])

    def silent_failures(self, method: str) -> int:
        """Over all runs."""
        return sum(one.methods[method].silent_failures for levels in self.failures.values() for one in levels)

    def warning_share(self, method: str) -> float | None:
        """Share of the ticks of undisturbed runs at which the status warned; None where none was run."""
        return _mean([one.methods[method].warning_share for name in UNDISTURBED for one in self.failures.get(name, ())])

    def check(self) -> None:
        """Raises `BenchError` where ours failed silently, or warned of nothing for more than `MOST_WARNINGS`."""
        silent = [
            f"{name} at {one.level:g}"
            for name, levels in self.failures.items()
            for one in levels
            if one.methods[OURS].silent_failures
        ]
        if silent:
            raise BenchError(f"stability: expected no silent failure of ours, found some in {', '.join(silent)}")
        share = self.warning_share(OURS)
        if share is not None and share > MOST_WARNINGS:
            raise BenchError(
                f"stability: expected warnings for at most {MOST_WARNINGS:.0%} of the time while nothing is wrong, "
                f"found {share:.1%}"
            )

    def as_json(self) -> dict[str, object]:
        """The stable names that `--json` prints."""
        return {
            **{method: self._figures(method) for method in METHODS},
            "elastic_jelly": {"isometry_error": self.isometry_error, "isometry_error_mm": self.isometry_error_mm},
            "ghost": dict(self.ghost),
            "settings": {
                "seeds": self.parameters.seeds,
                "seconds": self.parameters.seconds,
                "stride": self.parameters.stride,
                "width": self.parameters.width,
                "voxel_m": self.parameters.chain.grid.voxel_size,
            },
        }

    def _figures(self, method: str) -> dict[str, object]:
        levels = {
            name: [
                {"level": one.level, **asdict(one.methods[method]), "answered": one.answered, "warnings": one.warnings}
                for one in runs
            ]
            for name, runs in self.failures.items()
        }
        figures: dict[str, object] = {
            "silent_failures": self.silent_failures(method),
            "warning_share": self.warning_share(method),
            "gives_way": {name: self.gives_way(method, name) for name in self.failures},
            "levels": levels,
        }
        if method == OURS:
            figures["pictures_give_way"] = {name: self.pictures_give_way(method, name) for name in self.failures}
        return figures


def run(
    parameters: StabilityParameters | None = None, progress: Progress = lambda results, total: results
) -> Stability:
    """Runs the suite."""
    parameters = parameters or StabilityParameters()
    cases = list(_cases(parameters))
    return summed(list(progress(spread(run_case, cases, parameters.processes, _one_thread), len(cases))), parameters)


def _cases(parameters: StabilityParameters) -> Iterator[Case]:
    for name in parameters.names:
        for level in chosen_levels(FAILURES[name].levels, parameters.most_levels):
            for seed in range(1, parameters.seeds + 1):
                yield Case(name, level, seed, parameters.seconds, parameters.stride, parameters.width, parameters.chain)


def chosen_levels(levels: Sequence[float], most: int | None) -> tuple[float, ...]:
    """At most so many of the levels: the hardest, and others evenly below it."""
    if most is None or len(levels) <= most:
        return tuple(levels)
    return tuple(levels[len(levels) - 1 - (index * len(levels)) // most] for index in reversed(range(most)))


def _one_thread() -> None:
    """As many processes as cores leave a core to each."""
    torch.set_num_threads(1)


def summed(results: Sequence[CaseResult], parameters: StabilityParameters) -> Stability:
    """Pools the runs of each level over the seeds."""
    failures: dict[str, list[Level]] = {}
    for name in dict.fromkeys(result.failure for result in results):
        of_name = [result for result in results if result.failure == name]
        failures[name] = [
            _level(level, [result for result in of_name if result.level == level])
            for level in sorted({result.level for result in of_name})
        ]
    calm = [result.shape for result in results if result.failure in UNDISTURBED]
    return Stability(
        failures,
        _mean([shape.isometry_error for shape in calm]),
        _mean([shape.isometry_error_mm for shape in calm]),
        {name: value for name in (OURS, *PICTURES) if (value := _mean([s.ghost.get(name) for s in calm])) is not None},
        parameters,
    )


def _level(level: float, results: Sequence[CaseResult]) -> Level:
    methods = {name: Pooled.of([result.outcomes[name] for result in results]) for name in METHODS}
    warnings = tuple(dict.fromkeys(warning for result in results for warning in result.warnings))
    return Level(level, methods, float(np.mean([result.answered for result in results])), warnings)


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None
