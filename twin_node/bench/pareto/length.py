"""What a set costs and what the process holds while a run gets longer: the chain on a clip to and fro, for an hour."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from twin_node.bag.qos import is_latched
from twin_node.bench.errors import BenchError
from twin_node.bench.results_folder import save_chart
from twin_node.bench.stability.scenes import RATE_HZ, circling, one_box
from twin_node.bench.text_table import markdown_table, text_table
from twin_node.bench.track_runs import to_and_fro
from twin_node.cell import CellSource, Scenario
from twin_node.errors import several
from twin_node.forecast import GridParameters
from twin_node.nodes.chain import Chain
from twin_node.nodes.chain_parameters import ChainParameters
from twin_node.nodes.latency import ASSUMED_LATENCY_NS, Latency
from twin_node.nodes.sizes import SIZES
from twin_node.nodes.topics import FORECAST, FRAMES
from twin_node.runtime.bus import LocalBus
from twin_node.runtime.clock import SteppedClock
from twin_node.runtime.memory import resident_bytes
from twin_node.scene import FrameSet, Tier
from twin_node.scene.narrowing import Narrower

CLIP_S = 3.0
"""Length of the clip that is followed to and fro, s: the box goes three quarters of its circle in it."""
SPEED = 0.5
"""Of the box that circles, m/s."""
SETTLED_SPANS = 1
"""Spans at the start that the run is not judged by: pools and caches fill."""

Progress = Callable[[Iterable["Span"], int], Iterable["Span"]]
"""May wrap the spans as they come; told how many there will be."""


@dataclass(frozen=True)
class LengthParameters:
    """How long, and how much a set is given."""

    seconds: float = 3600.0
    """Of stamps; it takes as long as the sets take to be worked on."""
    rate_hz: float = 10.0
    """Sets per second; divides the rig's 30."""
    size: str = "tiny"
    """In `SIZES`."""
    span_s: float = 60.0
    """The figures are told once per so much of the run, s."""

    @property
    def stride(self) -> int:
        """Every so many sets of the rig are taken."""
        return round(RATE_HZ / self.rate_hz)

    @property
    def sets(self) -> int:
        """Of the whole run."""
        return int(self.seconds * self.rate_hz + 1e-6)


@dataclass(frozen=True)
class Span:
    """A part of the run."""

    until_s: float
    """After the start."""
    ms_p50: float
    """Work on a set, of one core: drift watch, model with its mapper, forecast, status."""
    ms_p95: float
    resident_mb: float
    """What the process holds at the end of the span."""
    gaussians: int
    moving_gaussians: int
    """Of all tiers but STATIC, at the end of the span."""
    forecasts: int
    """That went out."""


@dataclass(frozen=True)
class Length:
    """The whole run."""

    spans: tuple[Span, ...]
    parameters: LengthParameters

    @property
    def settled(self) -> tuple[Span, ...]:
        """Without the first ones."""
        return self.spans[SETTLED_SPANS:] or self.spans

    @property
    def last_over_first(self) -> float | None:
        """Time per set in the last tenth of the run over that in the first, the start left out; None of one span."""
        if len(self.settled) < 2:
            return None
        tenth = max(1, len(self.settled) // 10)
        first, last = ([span.ms_p50 for span in spans] for spans in (self.settled[:tenth], self.settled[-tenth:]))
        return float(np.median(last) / np.median(first))

    @property
    def growth_mb(self) -> float | None:
        """What memory has grown by since the start was over; None of one span."""
        return self.settled[-1].resident_mb - self.settled[0].resident_mb if len(self.settled) > 1 else None

    @property
    def growth_mb_per_hour(self) -> float | None:
        """Slope of the straight line through the memory of the second half of the run; None of one span."""
        later = self.settled[len(self.settled) // 2 :]
        if len(later) < 2:
            return None
        hours = [span.until_s / 3600 for span in later]
        return float(np.polyfit(hours, [span.resident_mb for span in later], 1)[0])

    def as_json(self) -> dict[str, object]:
        """The stable names that `--json` prints."""
        return {
            "last_over_first": self.last_over_first,
            "growth_mb": self.growth_mb,
            "growth_mb_per_hour": self.growth_mb_per_hour,
            "sets": self.parameters.sets,
            "settings": asdict(self.parameters),
            "spans": [asdict(span) for span in self.spans],
        }


def run(
    parameters: LengthParameters | None = None, progress: Progress = lambda spans, total: spans, seed_steps: int = 32
) -> Length:
    """Follows the clip in this process, on one core.

    `seed_steps`: of the first fit. Raises `BenchError` for a size that is none, and a rate or length that does not fit.
    """
    parameters = parameters or LengthParameters()
    _check(parameters)
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        total = -(-parameters.sets // _sets_per_span(parameters))
        return Length(tuple(progress(_spans(parameters, seed_steps), total)), parameters)
    finally:
        torch.set_num_threads(threads)


def _check(parameters: LengthParameters) -> None:
    if parameters.size not in SIZES:
        raise BenchError(f"--size: expected one of {', '.join(SIZES)}, found '{parameters.size}'")
    if parameters.stride < 1 or not np.isclose(parameters.stride * parameters.rate_hz, RATE_HZ):
        raise BenchError(f"--rate: expected {RATE_HZ:g} divided by a whole number, found {parameters.rate_hz:g}")
    if parameters.stride >= CLIP_S * RATE_HZ:
        raise BenchError(
            f"--rate: expected more than {1 / CLIP_S:.2g}, so that the clip of {CLIP_S:g} s has two sets or more, "
            f"found {parameters.rate_hz:g}"
        )
    if parameters.sets < 2:
        raise BenchError(f"--seconds: expected time for two sets at least, found {parameters.seconds:g}")


def _sets_per_span(parameters: LengthParameters) -> int:
    return max(1, round(parameters.span_s * parameters.rate_hz))


def _spans(parameters: LengthParameters, seed_steps: int) -> Iterator[Span]:
    scenario, narrower = one_box(circling(SPEED), CLIP_S), Narrower(SIZES[parameters.size].width)
    sets = [narrower.narrowed(one) for one in CellSource(scenario, stride=parameters.stride)]
    followed = _Followed(scenario, parameters, seed_steps)
    whole, per_span = parameters.sets, _sets_per_span(parameters)
    laps: list[float] = []
    try:
        for index, frames in enumerate(_endless(sets)):
            if index == whole:
                break
            laps.append(followed.follow(frames))
            if len(laps) == per_span or index == whole - 1:
                yield followed.told(laps, (index + 1) / parameters.rate_hz)
                laps = []
    finally:
        followed.stop()


def _endless(sets: Sequence[FrameSet]) -> Iterator[FrameSet]:
    for one in to_and_fro(sets, 10**9):
        yield from one


class _Followed:
    """The chain without an arm, in lockstep."""

    def __init__(self, scenario: Scenario, parameters: LengthParameters, seed_steps: int) -> None:
        chain = ChainParameters(grid=GridParameters(0.03))
        model = SIZES[parameters.size].model(chain.model)
        chain = replace(chain, model=replace(model, seed=replace(model.seed, steps=seed_steps)))
        self._bus, self._clock = LocalBus(is_latched), SteppedClock(scenario.start_ns)
        latency = Latency(ASSUMED_LATENCY_NS, is_measured=False)
        workspace = np.array(scenario.workspace)
        self._chain = Chain(self._bus, self._clock, workspace, chain, latency)
        self._forecasts = 0
        self._bus.subscribe(FORECAST, self._on_forecast)
        self._chain.start()

    def follow(self, frames: FrameSet) -> float:
        """Sends a set through the chain; its time of one core, ms."""
        started = time.process_time()
        self._clock.advance_to(frames.stamp)
        self._bus.publish(FRAMES, frames)
        self._chain.model_node.work_between_sets()
        return 1e3 * (time.process_time() - started)

    def stop(self) -> None:
        """Ends the chain, without which nothing of it is ever freed."""
        self._chain.stop()

    def told(self, laps: Sequence[float], until_s: float) -> Span:
        """The span that has just ended."""
        gc.collect()
        counts, forecasts = self._chain.model_node.model.tier_counts, self._forecasts
        self._forecasts = 0
        return Span(
            until_s,
            float(np.median(laps)),
            float(np.percentile(laps, 95)),
            resident_bytes() / 2**20,
            sum(counts.values()),
            sum(count for tier, count in counts.items() if tier != Tier.STATIC),
            forecasts,
        )

    def _on_forecast(self, _: Any) -> None:
        self._forecasts += 1


HEADS = ("until s", "ms p50", "ms p95", "MB", "Gaussians", "moving", "forecasts")
MOST_ROWS = 12
"""Of the tables."""


def text(found: Length) -> str:
    """The run as lines."""
    return f"{text_table(HEADS, _rows(found))}\n{_verdict(found)}"


def markdown(found: Length) -> str:
    """The run as a table in Markdown."""
    return f"{markdown_table(HEADS, _rows(found))}\n\n{_verdict(found)}\n"


def _rows(found: Length) -> Iterator[tuple[str, ...]]:
    """At most `MOST_ROWS` of the spans, evenly."""
    for span in found.spans[:: -(-len(found.spans) // MOST_ROWS)]:
        measured = (span.until_s, span.ms_p50, span.ms_p95, span.resident_mb)
        counts = (span.gaussians, span.moving_gaussians, span.forecasts)
        yield (*(f"{value:.1f}" for value in measured), *(str(count) for count in counts))


def _verdict(found: Length) -> str:
    if found.last_over_first is None or found.growth_mb is None:
        span_s = found.parameters.span_s
        spans = several(len(found.spans), "span")
        return f"too short to tell what grows: {spans} of {span_s:g} s, the first of them the start"
    verdict = f"last tenth over first: {found.last_over_first:.2f} times; memory {found.growth_mb:+.1f} MB"
    per_hour = found.growth_mb_per_hour
    return verdict if per_hour is None else f"{verdict}, at the end {per_hour:+.1f} MB per hour"


def draw(found: Length, folder: Path) -> Path:
    """`length.png` and `length.svg`: time per set and memory. Raises `BenchError` where they cannot be written."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 4.2), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    minutes = [span.until_s / 60 for span in found.spans]
    above.plot(minutes, [span.ms_p95 for span in found.spans], color="#e6b0aa", label="95 % of the sets below")
    above.plot(minutes, [span.ms_p50 for span in found.spans], color="#c0392b", label="median")
    above.set_ylabel("ms per set, one core")
    below.plot(minutes, [span.resident_mb for span in found.spans], color="#2c3e50")
    below.set_ylabel("memory held, MB")
    below.set_xlabel("minutes of the run")
    settings = found.parameters
    sets = f"{settings.seconds * settings.rate_hz:,.0f} sets at {settings.rate_hz:g} Hz, size {settings.size}"
    above.set_title(f"The whole chain on {sets}", loc="left")
    above.legend(frameon=False, fontsize=8)
    for axes in (above, below):
        axes.set_ylim(0, 1.15 * axes.get_ylim()[1])
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(color="#eeeeee")
    return save_chart(figure, folder, "length")
