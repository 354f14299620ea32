"""`twin_node bench track`: how well and how fast the model follows a log, beside the frozen first frame."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from twin_node.bench.errors import BenchError
from twin_node.bench.track_runs import Followed, follow, follow_live, start, to_and_fro
from twin_node.bench.track_scores import ForesightScore, LookingBack, TrackScores, score_foresight, score_renderings
from twin_node.bench.visual_hull import HullScore, HullTally
from twin_node.model.first_light import once_lit
from twin_node.nodes.chain import make_model
from twin_node.nodes.chain_parameters import ChainParameters
from twin_node.nodes.log_source import LogSession, LogSource
from twin_node.nodes.report.figures import percentiles
from twin_node.nodes.report.quality import First, clouds_against_images, without
from twin_node.nodes.spool import Spool, Tick
from twin_node.scene import FrameSet, Tier

ALL_CAMERAS = "all"
"""Leaves out each camera in turn."""
WARM_UP = 0.2
"""Share of a run after which memory must no longer grow."""

Progress = Callable[[float], None]
"""Called with the seconds of log time that have been followed."""


@dataclass(frozen=True)
class TrackBenchParameters:
    """How a log is followed and scored."""

    rate: float | None = None
    """Log seconds per second; None: lockstep, every set in turn."""
    leave_out: str | None = None
    """Camera that a further model never sees and is scored on, or `ALL_CAMERAS`."""
    bounce: int = 0
    """Passes over the log, forward and backward in turn; 0: none."""
    rig: Path | None = None
    """Rig file that replaces the log's own calibration."""
    remaps: Mapping[str, str] = field(default_factory=dict)
    """The log's topics -> the names that they are taken for."""
    start_offset_s: float = 0.0
    """Where in the log to begin, s."""
    duration_s: float | None = None
    """How much of it to follow, s; None: to the end."""
    chain: ChainParameters = field(default_factory=ChainParameters)
    """Model and synchroniser as the chain's."""


@dataclass(frozen=True)
class TrackBench:
    """What following one log has shown."""

    mode: str
    followed: Followed
    scored: int
    """Sets that the scores are of: of a long run, blocks of a second all over it (see `Spool`)."""
    scores: TrackScores
    foresight: ForesightScore
    left_out: Mapping[str, TrackScores]
    """Per camera that the model did not see."""
    passes: Sequence[TrackScores]
    """Per pass to and fro."""
    growth_bytes: int | None
    """What memory has grown by since the second pass, or after the first fifth of the run; None without a third pass,
    or without a fifth."""
    afterwards_db: float | None = None
    """PSNR of sets half a window back as the model renders them now, less what they had live; in lockstep only."""
    hulls: Mapping[str, HullScore] = field(default_factory=dict)
    """Per camera that the model did not see: ours beside the visual hull."""

    def as_json(self) -> dict[str, object]:
        """The stable names that `--json` prints."""
        run, model = self.followed, self.followed.model
        tiers = np.array(run.tiers)
        moving = tiers[:, [Tier.RIGID, Tier.DEFORMABLE, Tier.TRANSIENT]].sum(1)
        forecast, present = self.foresight.forecast, self.foresight.present
        return {
            "mode": self.mode,
            "sets": run.sets,
            "scored": self.scored,
            "dropped": run.dropped,
            "dropped_share": run.dropped / (run.sets + run.dropped),
            "hurried": model.hurried,
            "rate_hz": run.sets / run.seconds,
            "latency_ms": percentiles(run.latencies_ms),
            "offer_ms": percentiles(run.offers_ms),
            "wait_ms": percentiles(run.waits_ms),
            "update_ms": percentiles(run.updates_ms[1:]),
            "stages_ms": {name: percentiles(times[1:]) for name, times in run.watch.stages.items()},
            "psnr_db": {name: asdict(method) for name, method in self.scores.methods.items()},
            "gain_db": gains(self.scores),
            "flicker_x100": self.scores.flicker,
            "images_flicker_x100": self.scores.images_flicker,
            "forecast_db": forecast,
            "present_db": present,
            "forecast_gain_db": None if forecast is None or present is None else forecast - present,
            "afterwards_less_live_db": self.afterwards_db,
            "left_out": {
                name: {
                    **asdict(one.methods["ours"]),
                    "gain_db": gains(one),
                    "visual_hull": {**asdict(self.hulls[name]), "gain_db": self.hulls[name].gain_db},
                }
                for name, one in self.left_out.items()
            },
            "tiers": {tier.name.lower(): int(tiers[-1, tier]) for tier in Tier},
            "moving_share": float((moving / tiers.sum(1).clip(1)).mean()),
            "most_gaussians": int(tiers.sum(1).max()),
            "capacity": model.capacity,
            "nodes": model.nodes_count,
            "parameters": model.parameters_count,
            "bytes_per_frame": float(np.mean(run.bytes_per_frame[1:])) if run.sets > 1 else None,
            "growth_mb": None if self.growth_bytes is None else self.growth_bytes / 2**20,
            "passes": [{**asdict(one.methods["ours"]), "gain_db": gains(one)} for one in self.passes],
            "last_less_second_db": last_less_second(self.passes),
            "warnings": run.warnings,
        }


def run(log: Path, parameters: TrackBenchParameters | None = None, progress: Progress = lambda _: None) -> TrackBench:
    """Follows a log and scores every input set against the cloud that follows it, a dropped one against the one before;
    in real time also against the newest cloud that was out when its images were taken.

    Raises `BenchError` for a camera that the log does not have, a log without sets, or passes to and fro in real time,
    and the errors of the log and its calibration.
    """
    parameters = parameters or TrackBenchParameters()
    if parameters.bounce and parameters.rate is not None:
        raise BenchError("--bounce with --rate: to and fro is followed in lockstep; leave one of the two out")
    with contextlib.ExitStack() as stack:
        session = stack.enter_context(
            LogSession(log, parameters.rig, dict(parameters.remaps), parameters.start_offset_s, parameters.duration_s)
        )
        source = LogSource(session, parameters.chain.synchronizer, parameters.chain.arm.arm().joint_names)
        hidden = _hidden(source, parameters.leave_out, log)
        if parameters.bounce:
            bench = _bounce(list(once_lit(source)), parameters, log, progress)
        else:
            bench = _once(session, source, parameters, log, progress)
        hulls = {name: HullTally() for name in hidden}
        left_out = {
            name: score_renderings(
                tally.watch(without(name, _told(source, session, progress), make_model(parameters.chain)))
            )
            for name, tally in hulls.items()
        }
    scores = {name: tally.score for name, tally in hulls.items()}
    return TrackBench(**{**vars(bench), "left_out": left_out, "hulls": scores})


def _once(
    session: LogSession, source: LogSource, parameters: TrackBenchParameters, log: Path, progress: Progress
) -> TrackBench:
    """One pass in lockstep or in real time; ticks are scored when it is over."""
    followed, looking_back = start(parameters.chain), LookingBack()
    expected_hz = session.expected_hz(parameters.chain.synchronizer.max_rate_hz)
    with Spool(session.span.start_ns, session.span.stop_ns, expected_hz) as spool:
        if parameters.rate is None:
            for tick in follow(followed, once_lit(source)):
                progress((tick.stamp - session.span.start_ns) * 1e-9)
                looking_back.add(tick, followed.model)
                if spool.keeps(tick.stamp):
                    spool.add(tick)
        else:
            for seconds in follow_live(followed, session, parameters.chain, parameters.rate, spool):
                progress(seconds)
        if followed.sets == 0:
            raise _no_sets(log)
        scored, (scores, foresight) = len(spool), _scores(spool, followed)
    memory = followed.memory_bytes
    start_sets = int(WARM_UP * len(memory))
    growth = memory[-1] - memory[start_sets] if start_sets else None
    mode = "lockstep" if parameters.rate is None else "real time"
    return TrackBench(mode, followed, scored, scores, foresight, {}, (), growth, looking_back.mean.value)


def _bounce(sets: list[FrameSet], parameters: TrackBenchParameters, log: Path, progress: Progress) -> TrackBench:
    """Passes to and fro in lockstep, each scored as it goes."""
    if not sets:
        raise _no_sets(log)
    followed, passes, ends = start(parameters.chain), [], []
    firsts: dict[str, First] = {}
    begin = sets[0].stamp
    for sets_of_pass in to_and_fro(sets, parameters.bounce):
        ticks = _reporting(follow(followed, sets_of_pass), begin, progress)
        shown = clouds_against_images(ticks, lambda c: followed.model.render_frozen(c).rgb, firsts)
        passes.append(score_renderings(shown))
        ends.append(followed.memory_bytes[-1])
    growth = ends[-1] - ends[1] if len(ends) > 2 else None
    return TrackBench("to and fro", followed, len(sets), passes[-1], ForesightScore(None, None), {}, passes, growth)


def _scores(spool: Spool, followed: Followed) -> tuple[TrackScores, ForesightScore]:
    rendered = clouds_against_images(spool, lambda camera: followed.model.render_frozen(camera).rgb)
    return score_renderings(rendered), score_foresight(spool)


def _reporting(ticks: Iterable[Tick], begin_ns: int, progress: Progress) -> Iterator[Tick]:
    for tick in ticks:
        progress((tick.stamp - begin_ns) * 1e-9)
        yield tick


def _told(source: LogSource, session: LogSession, progress: Progress) -> Iterator[FrameSet]:
    for frames in source:
        progress((frames.stamp - session.span.start_ns) * 1e-9)
        yield frames


def _hidden(source: LogSource, leave_out: str | None, log: Path) -> tuple[str, ...]:
    """The cameras to leave out, in turn."""
    names = tuple(camera.name for camera in source.cameras)
    if leave_out is None:
        return ()
    if len(names) < 2:
        raise BenchError(f"--leave-out {leave_out}: {log} has one camera only; expected two or more")
    if leave_out == ALL_CAMERAS:
        return names
    if leave_out not in names:
        raise BenchError(f"--leave-out {leave_out}: {log} has no such camera; expected all or {', '.join(names)}")
    return (leave_out,)


def _no_sets(log: Path) -> BenchError:
    return BenchError(f"{log}: no set of images in the span; give a longer --duration")


def gains(scores: TrackScores) -> dict[str, float | None]:
    """dB of ours over the frozen first frame, per kind of pixel."""
    ours, frozen = asdict(scores.methods["ours"]), asdict(scores.methods["frozen"])
    return {kind: None if ours[kind] is None or frozen[kind] is None else ours[kind] - frozen[kind] for kind in ours}


def last_less_second(passes: Sequence[TrackScores]) -> dict[str, float | None] | None:
    """dB that the last pass is better than the first in its direction by, per kind of pixel; None without four passes.

    The very first does not count, for a model is settling in.
    """
    if len(passes) < 4:
        return None
    first, last = (asdict(one.methods["ours"]) for one in (passes[1 + len(passes) % 2], passes[-1]))
    return {kind: None if last[kind] is None or first[kind] is None else last[kind] - first[kind] for kind in last}
