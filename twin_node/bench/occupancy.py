"""`twin_node bench occupancy`: how good a log's forecasts are, beside the baselines made of the same evidence."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twin_node.bench.body import BodyScore, BodyTally
from twin_node.bench.contenders import OURS
from twin_node.bench.equal_recall import EqualRecall, PersistenceGrowth
from twin_node.bench.errors import BenchError
from twin_node.bench.space import SpaceScore, SpaceTally
from twin_node.bench.truth import ColourOf, Markers, PixelTruth
from twin_node.forecast import BaselineForecaster, Forecaster, default_grid
from twin_node.forecast.comparison import Comparison, Score, Truth
from twin_node.model.first_light import once_lit
from twin_node.nodes.chain import make_model
from twin_node.nodes.chain_parameters import ChainParameters
from twin_node.nodes.log_source import LogSession, LogSource
from twin_node.nodes.truth import truth_of
from twin_node.scene import HORIZONS_NS, Bool, FrameSet, Grid, Occupancy, TwinState


@dataclass(frozen=True)
class OccupancyBenchParameters:
    """How a log is scored."""

    rig: Path | None = None
    """Rig file that replaces the log's own calibration."""
    remaps: Mapping[str, str] | None = None
    """The log's topics -> the names that they are taken for."""
    start_offset_s: float = 0.0
    """Where in the log to begin, s."""
    duration_s: float | None = None
    """How much of it to score, s; None: to the end."""
    latency_ms: float = 33.0
    """From the evidence to the publication of a forecast, ms."""
    warm_up_s: float = 0.4
    """Forecasts from the first so many seconds are made and not scored: nothing has had time to be seen moving."""
    chain: ChainParameters = field(default_factory=ChainParameters)
    """Synchroniser, model, arm and grid as the chain's."""


@dataclass(frozen=True)
class WholeThings:
    """The scores of the same forecasts against whole things, once any of them had been seen."""

    scores: Mapping[str, Score]
    """By name."""
    persistence_equal_recall: EqualRecall | None
    """As that of `OccupancyBench`."""


@dataclass(frozen=True)
class OccupancyBench:
    """The scores of one log."""

    truth: str
    """Where the truth came from."""
    sets: int
    """Image sets forecast."""
    coverage: float | None
    """Share of what was seen to move that our forecasts held, as the forecaster itself reports it."""
    target: float
    """Coverage aimed at."""
    scores: Mapping[str, Score]
    """By name: ours, persistence, constant_velocity, worst_case."""
    persistence_equal_recall: EqualRecall | None = None
    """Persistence grown until it finds as much as ours; None without true points."""
    space: SpaceScore | None = None
    """Vacated and unseen space; None without exact truth."""
    update_ms: float | None = None
    """Median time of one forecast, without its evidence being scored."""
    body: BodyScore | None = None
    """The node that carries the thing of the colour; None without a colour."""
    whole_things: WholeThings | None = None
    """None but in a simulated cell."""

    def as_json(self) -> dict[str, object]:
        """The stable names that `--json` prints."""
        named = {name: asdict(score) for name, score in self.scores.items()}
        own = {"truth": self.truth, "sets": self.sets, "coverage": self.coverage, "target": self.target}
        equal = None if self.persistence_equal_recall is None else asdict(self.persistence_equal_recall)
        space = dict.fromkeys(SpaceScore.__dataclass_fields__) if self.space is None else asdict(self.space)
        body = None if self.body is None else asdict(self.body)
        return {**named, "persistence_equal_recall": equal, **space, **own, "update_ms": self.update_ms, "body": body}


def run(
    log: Path,
    markers: Path | None = None,
    colour: ColourOf | None = None,
    parameters: OccupancyBenchParameters | None = None,
    progress: Callable[[Iterable[FrameSet]], Iterable[FrameSet]] = iter,
) -> OccupancyBench:
    """Forecasts a whole log in lockstep and scores each forecast when its time has come.

    The truth is, in this order: `markers`, `colour` (the moving thing's own pixels; only what has this colour is
    forecast then), the log's `/truth/occupancy`, or what the twin sees to move 200 ms later. `progress` may wrap the
    sets. Raises `BenchError` for markers that cannot be read or a log without forecasts to score, and the errors of
    the log and its calibration.
    """
    parameters = parameters or OccupancyBenchParameters()
    remaps = dict(parameters.remaps or {})
    session = LogSession(log, parameters.rig, remaps, parameters.start_offset_s, parameters.duration_s)
    with session:
        source = LogSource(session, parameters.chain.synchronizer, parameters.chain.arm.arm().joint_names)
        grid = default_grid(source.workspace, parameters.chain.grid.voxel_size)
        truth = _truth_of(session, markers, colour)
        tally = None if colour is None else BodyTally(colour, round(parameters.latency_ms * 1e6))
        states = _states(once_lit(progress(source)), make_model(parameters.chain).update, colour)
        bench = score_states(states if tally is None else tally.watch(states), grid, truth, parameters)
        bench = replace(bench, body=None if tally is None else tally.score())
    if not bench.scores:
        least_s = parameters.warm_up_s + parameters.latency_ms * 1e-3 + HORIZONS_NS[-1] * 1e-9
        raise BenchError(f"{log}: expected more than {least_s:.2f} s of images, found {bench.sets} sets")
    return bench


class _Tally:
    """Forecasts against one truth."""

    def __init__(self, grid: Grid, truth: Truth) -> None:
        self._comparison, self._growth = Comparison(truth, "persistence"), PersistenceGrowth(grid, truth)

    def add(self, state: TwinState, forecasts: Mapping[str, Occupancy], places: NDArray[np.int32]) -> None:
        """Takes in the forecasts of a state, none to settle only, and the voxels `places` [3, n] seen to move."""
        self._comparison.add(state, forecasts)
        self._growth.settle(state.stamp)
        if forecasts:
            self._growth.add(places, state.stamp, forecasts[OURS].publish_stamp + HORIZONS_NS[-1])

    @property
    def scores(self) -> Mapping[str, Score]:
        """By name."""
        return self._comparison.scores()

    @property
    def equal_recall(self) -> EqualRecall | None:
        """Persistence grown until it finds as much as ours."""
        recall = self.scores[OURS].recall if OURS in self.scores else None
        return None if recall is None else self._growth.grown_to(recall)


def score_states(
    states: Iterable[TwinState],
    grid: Grid,
    truth: Truth,
    parameters: OccupancyBenchParameters,
    whole: Truth | None = None,
) -> OccupancyBench:
    """Forecasts states in rising order of stamps, ours and the baselines, and scores them against the truth.

    `whole`: a second truth, that of whole things.
    """
    chosen = parameters.chain.forecast
    arm = parameters.chain.arm.arm()
    forecaster = Forecaster(grid, chosen, arm)
    baselines = BaselineForecaster(grid, chosen.carving, chosen.static, arm)
    tallies = [_Tally(grid, one) for one in (truth, whole) if one is not None]
    space, spent = SpaceTally(grid, arm), []
    sets, begin, is_exact = 0, None, False
    for state in states:
        begin = state.stamp if begin is None else begin
        publish = state.stamp + round(parameters.latency_ms * 1e6)
        started = time.perf_counter()
        ours = forecaster.update(state, publish).occupancy
        spent.append(time.perf_counter() - started)
        others = baselines.update(state, publish)
        truth.observe(state, others.persistence)
        sets += 1
        is_warm = state.stamp - begin >= parameters.warm_up_s * 1e9
        forecasts = {OURS: ours, **vars(others)} if is_warm else {}
        for tally in tallies:
            tally.add(state, forecasts, baselines.places)
        occupied = truth.occupied(state.stamp)
        is_exact = is_exact or occupied is not None
        space.add(state, ours, occupied)
    quality = forecaster.quality
    return OccupancyBench(
        truth=truth.source,
        sets=sets,
        coverage=quality.coverage if np.isfinite(quality.coverage) else None,
        target=quality.target,
        scores=tallies[0].scores,
        persistence_equal_recall=tallies[0].equal_recall,
        space=space.score() if is_exact else None,
        update_ms=1e3 * float(np.median(spent)) if spent else None,
        whole_things=None if whole is None else WholeThings(tallies[1].scores, tallies[1].equal_recall),
    )


def _truth_of(session: LogSession, markers: Path | None, colour: ColourOf | None) -> Truth:
    if markers is not None:
        return Markers(markers, session.log.start_ns)  # of the whole log, wherever in it the scoring begins
    if colour is not None:
        return PixelTruth(colour)
    return truth_of(session.log)


def _states(
    sets: Iterable[FrameSet], model: Callable[[FrameSet], TwinState], colour: ColourOf | None
) -> Iterator[TwinState]:
    """The model's states; with a colour, only what has it counts as moving, and what hides it as in the way."""
    for frames in sets:
        state = model(frames)
        if colour is None:
            yield state
            continue
        marked = [colour.mask(view.rgb) for view in frames.views]
        moving = tuple(mask & mine for mask, mine in zip(state.moving_masks, marked, strict=True))
        hiding = zip(state.moving_masks, marked, state.robot_masks, strict=True)
        robots: tuple[Bool | None, ...] = tuple(
            mask & ~mine if robot is None else (mask & ~mine) | robot for mask, mine, robot in hiding
        )
        yield replace(state, moving_masks=moving, robot_masks=robots)
