"""What `bench graph` found, as lines to read: a heading per part, what was measured below it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from twin_node.bench.graph import IdleFigures, KillFigures, LatencyFigures
from twin_node.bench.graph_cameras import CameraFigures
from twin_node.bench.graph_hops import HopFigures
from twin_node.bench.graph_live import LiveFigures
from twin_node.bench.graph_network import NetworkFigures
from twin_node.bench.graph_recorder import KilledFigures, RecorderFigures
from twin_node.bench.graph_run import Percentiles
from twin_node.bench.text_table import percent, text_table
from twin_node.errors import several

Figures = (
    LatencyFigures
    | HopFigures
    | IdleFigures
    | KillFigures
    | RecorderFigures
    | KilledFigures
    | NetworkFigures
    | CameraFigures
    | LiveFigures
)
"""What a part of the bench gives back."""


def table(part: str, figures: Figures) -> str:
    """A part's figures as lines; `part` is what `--only` calls it."""
    heads, *rows = _rows(part, figures)
    return text_table(heads, rows)


def _rows(part: str, figures: Figures) -> Iterator[Sequence[str]]:
    match figures:
        case LatencyFigures():
            yield from _latency(part, figures)
        case HopFigures():
            yield from _hops(part, figures)
        case IdleFigures():
            yield f"{part}: share of one core", percent(figures.core_share)
            yield from (("  " + name, percent(share)) for name, share in figures.by_process)
        case KillFigures():
            yield from _kills(part, figures)
        case RecorderFigures():
            yield f"{part}: {figures.seconds:.0f} s", "sent", "written", "dropped", "MB/s", "of a core"
            counts = (str(count) for count in (figures.sent, figures.written, figures.dropped))
            yield "  messages", *counts, f"{figures.megabytes_per_s:.1f}", percent(figures.core_share)
        case KilledFigures():
            yield f"{part}: {figures.kills} recorders", "opened", "lost s"
            yield "  files; the most that one lost", str(figures.opened), _seconds(figures.lost_s_max)
        case NetworkFigures():
            yield from _network(part, figures)
        case CameraFigures():
            yield from _cameras(part, figures)
        case LiveFigures():
            yield from _live(part, figures)


def _latency(part: str, figures: LatencyFigures) -> Iterator[Sequence[str]]:
    yield f"{part}: camera stamp to decision", *_PERCENTILES
    yield "  a process per node", *_percentiles(figures.processes)
    yield "  all nodes in one process", *_percentiles(figures.one_process)
    yield "  more with a process per node", f"{figures.p50_overhead_ms:.1f}", f"{figures.p99_overhead_ms:.1f}"


def _hops(part: str, figures: HopFigures) -> Iterator[Sequence[str]]:
    yield f"{part}: from process to process", *_PERCENTILES
    yield "  image", *_percentiles(figures.image)
    yield "  depth", *_percentiles(figures.depth)
    yield "  small message", *_percentiles(figures.small)
    yield (f"  came out of order: {figures.refused}",)


def _kills(part: str, figures: KillFigures) -> Iterator[Sequence[str]]:
    yield f"{part}: {several(figures.kills, 'time')}", "median s", "most s"
    yield "  until active again", _seconds(figures.restart_s_median), _seconds(figures.restart_s_max)
    yield from ((f"    {name}", _seconds(median)) for name, median in figures.by_process)
    yield "  until heard again", _seconds(figures.works_s_median), _seconds(figures.works_s_max)
    yield (f"  fast decisions meanwhile: {figures.fast_decisions}",)
    yield (f"  processes left at the end: {figures.orphans}",)


def _network(part: str, figures: NetworkFigures) -> Iterator[Sequence[str]]:
    link = f"{figures.delay_ms:g} ms, {100 * figures.loss:g} % lost"
    yield f"{part}: {link}", "median s", "most s"
    yield (f"  cuts of {figures.cut_s:.1f} s: {figures.cuts}",)
    yield "    from the last message until slow", *map(_seconds, (figures.slow_after_s_median, figures.slow_after_s))
    yield "    until stopped", *map(_seconds, (figures.stopped_after_s_median, figures.stopped_after_s))
    yield "    from the link's return until moving", "", _seconds(figures.resumes_after_s)
    yield (f"  before cuts: slow by loss alone {percent(figures.slow_share)} of the time",)
    yield (f"    age of evidence: p50 {figures.age_ms_p50:.1f} ms, p99 {figures.age_ms_p99:.1f} ms",)
    yield (f"  decisions out of order: {figures.out_of_order}",)


def _cameras(part: str, figures: CameraFigures) -> Iterator[Sequence[str]]:
    yield f"{part}: {figures.named} of {len(figures.faults)} faults named", "named s", "well s", "forecasts/s", "others"
    yield "  no fault", "", "", f"{figures.forecasts_per_s:.1f}"
    for one in figures.faults:
        times = _seconds(one.named_after_s), _seconds(one.well_after_s)
        yield f"  {one.fault}", *times, f"{one.forecasts_per_s:.1f}", str(one.others_named)


def _live(part: str, figures: LiveFigures) -> Iterator[Sequence[str]]:
    yield f"{part}: {figures.seconds:.0f} s, {figures.sets_per_s:.1f} sets/s", *_PERCENTILES
    yield "  age of what decisions rest on", *_percentiles(figures.age_ms)
    yield (f"  speed that the arm was allowed: {percent(figures.speed_share)} of full speed",)
    yield (f"  it moved: {percent(figures.moving_share)} of the time",)
    nearest = (
        f"{figures.nearest_m:.2f} m" if math.isfinite(figures.nearest_m) else "it did not move, or nobody was there"
    )
    yield (f"  nearest to somebody meanwhile: {nearest}",)
    yield (f"  in contact meanwhile: {figures.contact_s:.2f} s",)


_PERCENTILES = ("p50 ms", "p99 ms", "least ms", "messages")


def _percentiles(found: Percentiles) -> tuple[str, ...]:
    return f"{found.p50:.1f}", f"{found.p99:.1f}", f"{found.smallest:.1f}", str(found.count)


def _seconds(value: float) -> str:
    return f"{value:.2f}" if math.isfinite(value) else "never"
