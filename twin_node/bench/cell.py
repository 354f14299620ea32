"""`twin_node bench cell`: an arm at work beside people in closed loop, under laws that know more or less of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from twin_node.bench.cell_case import PERFECT, POLICIES, UNLIMITED, WORST_CASE, CellCase
from twin_node.bench.cell_scores import Outcome, score
from twin_node.bench.errors import BenchError
from twin_node.bench.text_table import text_table
from twin_node.bench.workers import spread
from twin_node.cell.closed_loop import LoopParameters
from twin_node.cell.scenario_file import load_scenario
from twin_node.ranges import Range, check_ranges
from twin_node.scene import Float64

if TYPE_CHECKING:
    from twin_node.bench.cell_twin import TwinTiming

SUITE = ("reach_in", "cross", "stop", "retreat", "two_people", "thrown_ball", "occlusion", "conveyor")
"""What `all` stands for."""
OURS = "ours"
BY_SIGHT = "by_sight"
"""The worst case with the twin's eyes."""

TWIN_WIDTH = 160
"""Working width of the twin's images, pixels."""

MOST_LATENCY = Range(0, 10_000)
"""ms: whoever gives more means another unit."""
RATE = Range(1, 1000)
"""Hz."""


@dataclass(frozen=True)
class CellBenchParameters:
    """What is run."""

    scenarios: tuple[str, ...] = SUITE
    seeds: int = 20
    """So many of each scenario, from `first_seed` on."""
    first_seed: int = 1
    latency_ms: float = 33.0
    """From the images to the obstacles, for perfect perception: the twin's own assumption in lockstep. Beside a twin
    it is as late as that usually is."""
    twin: bool = False
    """The real chain in the loop as `ours`: rendered images, model and forecast."""
    twin_latency_ms: float | None = None
    """From the images to the twin's obstacles; None: as long as the chain takes on this machine."""
    twin_rate_hz: float | None = None
    """Sets per second that the twin takes, beside its latency; None: each when the one before is done."""
    same_eyes: bool = False
    """Also the worst case with the twin's own perception, as `by_sight`: what a user without forecasts has."""
    processes: int = 2
    loop: LoopParameters = field(default_factory=LoopParameters)

    def __post_init__(self) -> None:
        """Raises `BenchError` for a latency that is none in milliseconds."""
        check_ranges(self, BenchError, "bench cell: ", latency_ms=MOST_LATENCY)
        if self.twin_latency_ms is not None:
            check_ranges(self, BenchError, "bench cell: ", twin_latency_ms=MOST_LATENCY)
        if self.twin_rate_hz is not None:
            check_ranges(self, BenchError, "bench cell: ", twin_rate_hz=RATE)


@dataclass(frozen=True)
class Job:
    """One scenario under one seed."""

    scenario: str
    seed: int
    parameters: CellBenchParameters


@dataclass(frozen=True)
class CaseResult:
    """How every policy did in one scenario under one seed."""

    scenario: str
    seed: int
    outcomes: Mapping[str, Outcome]
    """By policy."""
    work: Mapping[str, float]
    """By policy: progress as a share of the unobstructed arm's."""
    timing: TwinTiming | None = None
    """How late the twin was, where it was in the loop."""


@dataclass(frozen=True)
class PolicyFigures:
    """How one policy did over many runs."""

    contacts: int
    """Of the moving arm, with somebody who had been seen for long enough."""
    unwarned_contacts: int
    """The others: with somebody seen too late, or never."""
    work: float
    """Mean share of the unobstructed cycle."""
    min_distance_m: float | None
    """Smallest distance while the arm moved; None without people."""
    standing_contacts: int
    stops: int
    stop_distance_p1_m: float | None
    """First percentile of the distances at stops; None without stops."""
    false_stops: int


def run_case(job: Job) -> CaseResult:
    """All policies in one scenario under one seed; `ours` is the twin, or else the law with perfect perception.

    Raises `BenchError` where the arm does not work even without people.
    """
    parameters = job.parameters
    whole = _unobstructed_s(job.scenario, parameters)
    scenario = load_scenario(job.scenario).with_seed(job.seed)
    assumed = case = CellCase(scenario, parameters.latency_ms, parameters.loop)
    timing: TwinTiming | None = None
    twins: dict[str, Outcome] = {}
    if parameters.twin:
        from twin_node.bench.cell_twin import Pace, run_twin  # imports torch, which takes as long as a run without it

        latency_ms = parameters.twin_latency_ms
        pace = None if latency_ms is None else Pace.of(latency_ms, parameters.twin_rate_hz)
        twin = run_twin(assumed, TWIN_WIDTH, pace)
        timing = twin.timing
        case = CellCase(scenario, timing.usual_ms, parameters.loop)
        twins[OURS] = score(case, twin.record, twin.first_seen_s, with_delays=True)
        if parameters.same_eyes:
            seen = run_twin(assumed, TWIN_WIDTH, pace, by_sight=True)
            twins[BY_SIGHT] = score(case, seen.record, seen.first_seen_s)
    perfect = {
        policy.name: score(case, case.run(policy), with_delays=policy is PERFECT and not twins) for policy in POLICIES
    }
    outcomes = {OURS: perfect[PERFECT.name], **twins, **perfect}
    work = {name: outcome.progress_s / whole for name, outcome in outcomes.items()}
    return CaseResult(scenario.name, job.seed, outcomes, work, timing)


@lru_cache
def _unobstructed_s(scenario: str, parameters: CellBenchParameters) -> float:
    """Program time that the arm goes through beside the furniture alone, s; the same for every seed.

    Raises `BenchError` where it goes through none.
    """
    case = CellCase(load_scenario(scenario), parameters.latency_ms, parameters.loop)
    whole = case.run_unobstructed().progress_s
    if whole == 0:
        raise BenchError(
            f"scenario {case.scenario.name}: expected an arm that works where nobody is, found that it stands for all "
            f"{case.scenario.duration_s:g} s; keep furniture away from its path, or give it a longer duration_s"
        )
    return whole


def run(
    parameters: CellBenchParameters | None = None,
    progress: Callable[[Iterable[CaseResult], int], Iterable[CaseResult]] = lambda results, total: results,
) -> list[CaseResult]:
    """Runs every scenario under every seed, in processes of their own; `progress` may wrap the results as they come.

    Raises the errors of scenarios and their motion files, and `BenchError` for one without an arm and for two of one
    name, before any is run.
    """
    parameters = parameters or CellBenchParameters()
    files: dict[str, str] = {}
    for name in parameters.scenarios:
        case = CellCase(load_scenario(name), parameters.latency_ms, parameters.loop)
        _ = case.world  # reads motion files too
        other = files.setdefault(case.scenario.name, name)
        if other != name:
            raise BenchError(
                f"scenarios {other} and {name}: expected a 'name' of each one's own, found '{case.scenario.name}' in "
                "both; give one another, or leave one out"
            )
    seeds = range(parameters.first_seed, parameters.first_seed + parameters.seeds)
    jobs = [Job(name, seed, parameters) for seed in seeds for name in parameters.scenarios]
    return list(progress(spread(run_case, jobs, parameters.processes), len(jobs)))


def summary(results: Sequence[CaseResult]) -> dict[str, object]:
    """The stable names that `--json` prints."""
    names = list(dict.fromkeys(result.scenario for result in results))
    scenarios = {name: _figures([result for result in results if result.scenario == name]) for name in names}
    return {
        **_figures(results),
        "slow_down_ms": _slow_downs([result.outcomes[OURS] for result in results]),
        **_twin_figures(results),
        "runs": len(results),
        "scenarios": scenarios,
    }


def _slow_downs(outcomes: Sequence[Outcome]) -> dict[str, object]:
    """Within which times so many percent of all entries were answered, ms; None where not so many ever were."""
    answered = np.array([delay for outcome in outcomes for delay in outcome.delays_s])
    unanswered = sum(outcome.unanswered for outcome in outcomes)
    delays = np.append(answered, np.full(unanswered, np.inf))

    def within_ms(percent: float) -> float | None:
        known = float(np.percentile(delays, percent, method="inverted_cdf")) if len(delays) else np.inf
        return 1e3 * known if np.isfinite(known) else None

    times = {name: within_ms(percent) for name, percent in (("p50", 50), ("p95", 95), ("max", 100))}
    return {"entries": len(delays), **times, "unanswered": unanswered}


def _twin_figures(results: Sequence[CaseResult]) -> dict[str, object]:
    timings = [result.timing for result in results if result.timing is not None]
    if not timings:
        return {}
    latencies_ms = np.concatenate([timing.latencies_ms for timing in timings])
    return {
        "twin": {
            "sets": sum(timing.sets for timing in timings),
            "dropped": sum(timing.dropped for timing in timings),
            "latency_ms": {f"p{percent}": _percentile(latencies_ms, percent) for percent in (50, 95, 99)},
        }
    }


def _figures(results: Sequence[CaseResult]) -> dict[str, object]:
    policies = {name: _policy_figures(results, name) for name in results[0].outcomes}
    figures: dict[str, object] = {name: asdict(figures) for name, figures in policies.items()}
    figures["gap_closed"] = _gap_closed(policies, WORST_CASE.name)
    if BY_SIGHT in policies:
        figures["gap_closed_by_sight"] = _gap_closed(policies, BY_SIGHT)
    return figures


def _gap_closed(policies: Mapping[str, PolicyFigures], lowest_name: str) -> float | None:
    """Where `ours` lies between a policy and unlimited foresight; None where there is no gap."""
    lowest, highest = policies[lowest_name].work, policies[UNLIMITED.name].work
    return (policies[OURS].work - lowest) / (highest - lowest) if highest - lowest > 1e-9 else None


def _policy_figures(results: Sequence[CaseResult], policy: str) -> PolicyFigures:
    outcomes = [result.outcomes[policy] for result in results]
    stops = np.array([distance for outcome in outcomes for distance in outcome.stop_distances_m])
    nearest = min(outcome.min_distance_m for outcome in outcomes)
    return PolicyFigures(
        contacts=sum(outcome.contacts for outcome in outcomes),
        unwarned_contacts=sum(outcome.unwarned_contacts for outcome in outcomes),
        work=float(np.mean([result.work[policy] for result in results])),
        min_distance_m=nearest if np.isfinite(nearest) else None,
        standing_contacts=sum(outcome.standing_contacts for outcome in outcomes),
        stops=len(stops),
        stop_distance_p1_m=_percentile(stops, 1),
        false_stops=sum(outcome.false_stops for outcome in outcomes),
    )


def _percentile(values: Float64, percent: float) -> float | None:
    return float(np.percentile(values, percent)) if len(values) else None


def table(figures: Mapping[str, Any]) -> str:
    """The figures of `summary` as lines of text: a row per policy and scenario."""
    rows = []
    for name, group in {"all": figures, **figures["scenarios"]}.items():
        for policy in (OURS, BY_SIGHT, *(policy.name for policy in POLICIES)):
            if policy not in group:
                continue
            row, gap = group[policy], group["gap_closed"] if policy == OURS else None
            counts = (str(row[count]) for count in ("stops", "false_stops"))
            nearest = _text(row["min_distance_m"], "m")
            rows.append((name, policy, str(row["contacts"]), f"{row['work']:.3f}", nearest, *counts, _text(gap)))
    delays = figures["slow_down_ms"]
    told = (
        f"slow-down after entry: {delays['entries']} entries, p50 {_text(delays['p50'], 'ms')}, "
        f"p95 {_text(delays['p95'], 'ms')}, unanswered {delays['unanswered']}; {figures['runs']} runs"
    )
    heads = ("", "policy", "contacts", "work", "nearest", "stops", "false", "gap")
    return f"{text_table(heads, rows)}\n{told}"


def _text(value: float | None, unit: str = "") -> str:
    digits = ".0f" if unit == "ms" else ".3f" if unit else ".2f"
    return "-" if value is None else f"{value:{digits}}{' ' * bool(unit)}{unit}"
