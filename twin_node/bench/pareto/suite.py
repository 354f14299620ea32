"""All methods on all data, and what the points add up to."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from twin_node.bench.errors import BenchError
from twin_node.bench.methods.made_up import MADE_UP_QUICK, MadeUpParameters, make_up
from twin_node.bench.methods.protocol import QUICK as QUICK_BUDGET
from twin_node.bench.methods.protocol import Budget
from twin_node.bench.methods.table import METHODS
from twin_node.bench.methods.truth import MotionTruth
from twin_node.bench.pareto.foresight import ForesightJob, ForesightPoint, foresee, has_truth
from twin_node.bench.pareto.front import dominated_sizes, on_front
from twin_node.bench.pareto.hexplane import HEXPLANE, against_hexplane
from twin_node.bench.pareto.measure import OURS, Job, Point, measure
from twin_node.bench.workers import workers
from twin_node.model.sequence import Recording, recording_of
from twin_node.nodes.chain_parameters import ChainParameters
from twin_node.nodes.log_source import LogSession, LogSource
from twin_node.nodes.sizes import SHIPPED, SIZES

RIVALS = tuple(name for name in METHODS if name not in (OURS, "static_3dgs"))
"""What ours is charted with; 3DGS of all frames is one of the ablations of `bench methods`."""

Progress = Callable[[Iterable[str], int], Iterable[str]]
"""May wrap the names of what is done, as it is done; told how many there will be."""


def _full_budget() -> Budget:
    """What `bench methods` gives, with a NeRF that is as good after a quarter of its steps on images this small."""
    budget = Budget(offline_steps=1200)
    return replace(budget, nerf=replace(budget.nerf, steps=500))


@dataclass(frozen=True)
class ParetoParameters:
    """How much is run."""

    logs: tuple[Path, ...] = ()
    """Recordings beside the made-up scene."""
    made_up: MadeUpParameters | None = field(default_factory=MadeUpParameters)
    """None leaves it out."""
    width: int = 160
    """Of recorded images, px; sizes that work on smaller ones make them so."""
    start_offset_s: float = 0.0
    """Where in each log to begin, s."""
    rate_hz: float = 15.0
    """Sets taken of each log per second, for pictures: a method that learns for seconds sees things move."""
    frames: int = 30
    """Sets taken of each log, for pictures."""
    forecast_frames: int = 120
    """The same for forecasts of logs with exact truth, at the log's own rate."""
    rivals: tuple[str, ...] = (*RIVALS, *(f"{HEXPLANE}:{steps}" for steps in (40, 75, 150, 300, 600)))
    """Names of `METHODS`, with a number of steps where one is given."""
    sizes: tuple[str, ...] = tuple(SIZES)
    images: int = 12
    """Images that are scored, of the training cameras and of those left out each."""
    budget: Budget = field(default_factory=_full_budget)
    chain: ChainParameters = field(default_factory=ChainParameters)
    """Its model, of every size, takes the place of the budget's."""
    processes: int = 1
    """Measured at once; each uses one core."""


QUICK = ParetoParameters(
    made_up=MADE_UP_QUICK,
    width=96,
    frames=12,
    forecast_frames=40,
    rivals=(*RIVALS, *(f"{HEXPLANE}:{steps}" for steps in (40, 75, 300))),
    images=4,
    budget=QUICK_BUDGET,
    processes=2,
)
"""Shows that all run, not what they reach."""


@dataclass(frozen=True)
class Pareto:
    """All points."""

    points: tuple[Point, ...]

    def check(self) -> None:
        """Raises `BenchError` where an online method that is not ours is no worse than one of our sizes in anything."""
        for point in self.points:
            sizes = dominated_sizes(point, self.points)
            if sizes:
                raise BenchError(
                    f"pareto: expected nobody to dominate ours, found {point.name} on {point.data}: {sizes[0]}"
                )

    def by_data(self) -> dict[str, list[Point]]:
        """The points of every data set by its name."""
        names = dict.fromkeys(point.data for point in self.points)
        return {name: [point for point in self.points if point.data == name] for name in names}

    def as_json(self) -> dict[str, object]:
        """The stable names that `--json` prints."""
        return {
            "methods": [
                {
                    **asdict(point),
                    "on_front": on_front(point, self.points),
                    "dominates_ours": list(dominated_sizes(point, self.points)),
                }
                for point in self.points
            ],
            "against_hexplane": [asdict(one) for one in against_hexplane(self.points)],
        }


def run(parameters: ParetoParameters | None = None, progress: Progress = lambda names, total: names) -> Pareto:
    """Measures every method on every data set.

    Raises `BenchError` for a method or size that is none, two data sets of one name and a log of fewer than three
    cameras, and a log's errors.
    """
    parameters = parameters or ParetoParameters()
    _check(parameters)
    names = (*parameters.rivals, *(f"{OURS}_{size}" for size in parameters.sizes))
    data = list(_data(parameters))
    check_names([one.recording.name for one in data])
    budget = replace(parameters.budget, online=parameters.chain.model)
    jobs = [Job(name, one.recording, one.truth, budget, parameters.images) for one in data for name in names]
    forecasts = [
        ForesightJob(
            one.recording.name,
            size,
            one.forecast_log,
            parameters.start_offset_s,
            parameters.forecast_frames,
            parameters.chain,
        )
        for one in data
        if one.forecast_log is not None
        for size in parameters.sizes
    ]
    with workers(parameters.processes, fresh=True) as pool:  # peaks need fresh processes
        foreseen = [pool.submit(foresee, job) for job in forecasts]  # first: of a log too short, they tell so at once
        measured = [pool.submit(measure, job) for job in jobs]
        labels = [f"forecast, {job.size}" for job in forecasts] + [f"{job.name}, {job.recording.name}" for job in jobs]
        for _ in progress(_as_done(labels, [*foreseen, *measured]), len(labels)):
            pass
        points = [one.result() for one in measured]
        for job, one in zip(forecasts, foreseen, strict=True):
            points = _with_forecast(points, job, one.result())
    return Pareto(tuple(points))


def _check(parameters: ParetoParameters) -> None:
    for name in parameters.rivals:
        base, colon, steps = name.partition(":")
        if base not in METHODS:
            raise BenchError(f"--methods: expected some of {', '.join(METHODS)}, found '{name}'")
        if colon and not (METHODS[base].takes_steps and steps.isdecimal() and int(steps) > 0):
            trained = ", ".join(key for key, method in METHODS.items() if method.takes_steps)
            raise BenchError(f"--methods: expected steps, 1 or more, with {trained} alone, found '{name}'")
    for name in parameters.sizes:
        if name not in SIZES:
            raise BenchError(f"sizes: expected some of {', '.join(SIZES)}, found '{name}'")


def check_names(names: Sequence[str]) -> None:
    """Raises `BenchError` where two data sets have one name: their figures would be taken for those of one."""
    for name in names:
        if names.count(name) > 1:
            raise BenchError(f"{name}: expected logs with names of their own, found two of this; rename one")


def _as_done(labels: Sequence[str], futures: Sequence[Future[Any]]) -> Iterator[str]:
    """The labels one by one, as what they stand for is done; after an error nothing more is begun."""
    try:
        for label, future in zip(labels, futures, strict=True):
            future.result()
            yield label
    finally:
        for future in futures:
            future.cancel()


@dataclass(frozen=True)
class _Data:
    """What all methods are given."""

    recording: Recording
    truth: MotionTruth | None = None
    forecast_log: Path | None = None
    """Log with the exact occupancy that forecasts are scored on."""


def _data(parameters: ParetoParameters) -> Iterator[_Data]:
    if parameters.made_up is not None:
        scene = make_up(parameters.made_up)
        yield _Data(scene.recording, scene.truth)
    for log in parameters.logs:
        recording = _recorded(log, parameters)
        yield _Data(recording, None, log if has_truth(log) else None)


def _recorded(log: Path, parameters: ParetoParameters) -> Recording:
    """Some sets of a log; the rig's first camera is left out, and two others must be left."""
    with LogSession(log, start_offset_s=parameters.start_offset_s) as session:
        names = [camera.name for camera in session.rig.cameras]
        if len(names) < 3:
            raise BenchError(f"{log}: expected three cameras, so that one can be left out, found {len(names)}")
        read = replace(parameters.chain.synchronizer, width=parameters.width, max_rate_hz=parameters.rate_hz)
        return recording_of(log.stem, LogSource(session, read), names[:1], parameters.frames)


def _with_forecast(points: Sequence[Point], job: ForesightJob, foreseen: Sequence[ForesightPoint]) -> list[Point]:
    """The points with the forecasts of one of our sizes; beside those of the size that ships come the baselines'."""
    own, *others = foreseen
    name = f"{OURS}_{job.size}"
    result = [
        replace(point, recall=own.score.recall, volume_l=own.score.volume_l, forecast_ms=own.forecast_ms)
        if (point.data, point.name) == (job.data, name)
        else point
        for point in points
    ]
    if job.size != SHIPPED:
        return result
    return result + [
        Point(
            one.name,
            f"forecast: {one.name.replace('_', ' ')}",
            job.data,
            online=True,
            ms_per_frame=one.forecast_ms,
            recall=one.score.recall,
            volume_l=one.score.volume_l,
            forecast_ms=one.forecast_ms,
        )
        for one in others
    ]
