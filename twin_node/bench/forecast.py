"""`twin_node bench forecast`: the experts and the bound on 3D trajectories, beside simple forecasts of the same."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from twin_node.bag.trajectories import Trajectories
from twin_node.bag.trajectory_files import read_trajectories
from twin_node.bench.errors import BenchError
from twin_node.forecast.baselines import AHEAD_S
from twin_node.forecast.bound import PERSON_SPEED, BoundParameters
from twin_node.forecast.experts import EXPERT_NAMES
from twin_node.forecast.pace import USUAL_STEPS
from twin_node.forecast.points import PointForecaster
from twin_node.scene import Bool, Float64

WARM_UP_S = 2.0
"""Forecasts from the first so many seconds are made and not scored."""


@dataclass(frozen=True)
class ForecastBenchParameters:
    """How trajectories are sampled, spoilt and scored."""

    fps: float = 30.0
    """Samples per second that the forecaster is given, as nearly as every so many of the file's are."""
    noise_m: float = 0.005
    """1 sigma of the noise added to every coordinate, m: what a tracker leaves."""
    height_m: float = 1.75
    """Of the person in a BVH file, which has no unit."""
    joints: tuple[str, ...] = ()
    """Score points whose name holds one of these, in any case; none given: all. All are given to the forecaster."""
    seed: int = 0
    """Of the noise."""
    bound: BoundParameters = field(default_factory=BoundParameters)


@dataclass(frozen=True)
class Foretold:
    """Forecasts of T samples of J points at one horizon, and what came true; NaN where not known."""

    errors: Float64
    """[T, J] distance of the forecast from the truth, m."""
    single: Float64
    """[E, T, J] the same of each expert alone (`EXPERT_NAMES`), m."""
    radii: Float64
    """[T, J] bound, m."""
    update_s: float
    """Median time of one update of all points, s."""

    @property
    def known(self) -> Bool:
        """[T, J] True where both forecast and truth are known."""
        return np.isfinite(self.errors)


def foretell(
    times: Float64, seen: Float64, truth_at: Callable[[float], Float64], bound: BoundParameters | None = None
) -> Foretold:
    """Forecasts positions `seen` [T, J, 3] (m, NaN where not seen) at `times` [T] (s), one sample after the other, by
    `AHEAD_S`.

    `truth_at`: positions [J, 3] at a time, NaN where unknown.
    """
    forecaster = PointForecaster(seen.shape[1], np.array([AHEAD_S]), bound)
    errors, single, radii, spent = [], [], [], []
    for now, positions in zip(times, seen, strict=True):
        begin = time.perf_counter()
        forecast = forecaster.update(float(now), positions)
        spent.append(time.perf_counter() - begin)
        came_true = truth_at(float(now) + AHEAD_S) - positions
        errors.append(np.linalg.norm(forecast.displacements[-1] - came_true, axis=-1))
        single.append(np.linalg.norm(forecast.single - came_true, axis=-1))
        radii.append(forecast.radii[-1])
    return Foretold(np.array(errors), np.stack(single, axis=1), np.array(radii), float(np.median(spent)))


@dataclass(frozen=True)
class ForecastScore:
    """How good the forecasts of some points were."""

    error_mm: Mapping[str, float]
    """Mean distance from the truth: ours, persistence, constant_velocity, the other experts, and best_single, the
    smallest mean of any one expert in hindsight."""
    coverage: float
    """Share of the truths within the bound."""
    radius_m: Mapping[str, float]
    """median and mean of the bound; constant_same_coverage: the one radius that would have held as many."""
    worst_case: Mapping[str, float]
    """radius_m that 1.6 m/s allow about where a point was seen, and the coverage of that."""


@dataclass(frozen=True)
class ForecastBench:
    """The scores of one file."""

    score: ForecastScore
    by_joint: Mapping[str, ForecastScore]
    target: float
    rate_hz: float
    """Samples per second that the forecaster was given."""
    samples: int
    """Forecasts scored."""
    update_ms: float
    """Median time of one update of all points, on one thread if that is all that NumPy is given."""

    def as_json(self) -> dict[str, object]:
        """The stable names that `--json` prints."""
        by_joint = {name: asdict(score) for name, score in self.by_joint.items()}
        own = {"target": self.target, "rate_hz": self.rate_hz, "samples": self.samples, "update_ms": self.update_ms}
        return {**asdict(self.score), **own, "by_joint": by_joint}


def run(path: Path, parameters: ForecastBenchParameters | None = None) -> ForecastBench:
    """Scores forecasts of the trajectories in a `.bvh`, `.trc` or `.csv` file.

    Raises `BagError` for a file that cannot be read and `BenchError` where nothing is left to score.
    """
    parameters = parameters or ForecastBenchParameters()
    trajectories = read_trajectories(path, parameters.height_m)
    chosen = _chosen(path, trajectories.names, parameters.joints)
    stride = max(1, round(trajectories.rate_hz / parameters.fps))
    rng = np.random.default_rng(parameters.seed)
    exact = trajectories.positions[::stride]
    seen = exact + rng.normal(0, parameters.noise_m, exact.shape)
    times = trajectories.times[::stride]
    foretold = foretell(times, seen, _truth(trajectories), parameters.bound)
    scored = times >= times[0] + WARM_UP_S
    if not foretold.known[scored][:, chosen].any():
        least = WARM_UP_S + AHEAD_S
        raise BenchError(f"{path}: expected more than {least:.1f} s of trajectories, found {np.ptp(times):.1f} s")
    return ForecastBench(
        score=_score(foretold, scored, chosen),
        by_joint={
            trajectories.names[joint]: _score(foretold, scored, [joint])
            for joint in chosen
            if foretold.known[scored, joint].any()
        },
        target=parameters.bound.coverage,
        rate_hz=trajectories.rate_hz / stride,
        samples=int(foretold.known[scored][:, chosen].sum()),
        update_ms=foretold.update_s * 1e3,
    )


def _chosen(path: Path, names: tuple[str, ...], wanted: Iterable[str]) -> list[int]:
    parts = [part.lower() for part in wanted]
    chosen = [row for row, name in enumerate(names) if not parts or any(part in name.lower() for part in parts)]
    if not chosen:
        raise BenchError(f"{path}: no point's name holds {' or '.join(parts)}; it has {', '.join(names)}")
    return chosen


def _truth(trajectories: Trajectories) -> Callable[[float], Float64]:
    """Positions at any time, interpolated; NaN after the end, and where samples are missing."""
    longest_s = USUAL_STEPS / trajectories.rate_hz  # beyond that there was a pause

    def at(moment: float) -> Float64:
        times = trajectories.times
        after = int(np.searchsorted(times, moment - _SAME_S))
        before = max(after - 1, 0)
        is_told = after < len(times) and (times[after] - times[before] <= longest_s or times[after] - moment <= _SAME_S)
        if not is_told:
            return np.full(trajectories.positions.shape[1:], np.nan)
        share = np.clip((moment - times[before]) / max(times[after] - times[before], _SAME_S), 0, 1)
        between: Float64 = (1 - share) * trajectories.positions[before] + share * trajectories.positions[after]
        return between

    return at


_SAME_S = 1e-4
"""Times this close are the same, s: what is left of a frame time written with four digits."""


def _score(foretold: Foretold, scored: Bool, joints: list[int]) -> ForecastScore:
    known = foretold.known[scored][:, joints]
    errors, radii = foretold.errors[scored][:, joints][known], foretold.radii[scored][:, joints][known]
    single = {
        name: errors_of[scored][:, joints][known] for name, errors_of in zip(EXPERT_NAMES, foretold.single, strict=True)
    }
    means = {name: 1e3 * float(mean.mean()) for name, mean in single.items()}
    coverage = float(np.mean(errors <= radii))
    reach = PERSON_SPEED * AHEAD_S
    return ForecastScore(
        error_mm={"ours": 1e3 * float(errors.mean()), **means, "best_single": min(means.values())},
        coverage=coverage,
        radius_m={
            "median": float(np.median(radii)),
            "mean": float(radii.mean()),
            "constant_same_coverage": float(np.quantile(errors, coverage)),
        },
        worst_case={"radius_m": reach, "coverage": float(np.mean(single["persistence"] <= reach))},
    )
