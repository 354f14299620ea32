"""Two machines whose link is slow, loses packets and is cut: how soon the arm notices, and that it goes on."""

from __future__ import annotations

import itertools
import json
import math
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import IO

import numpy as np

from twin_node.arm import LimiterParameters
from twin_node.bench.errors import BenchError
from twin_node.bench.graph_link import Link, Machine
from twin_node.bench.graph_machine import Told
from twin_node.bench.graph_run import PATIENCE_S

TWIN, ARM = "10.77.0.1", "10.77.0.2"
PORT = 7447
DELAY_S, LOSS = 0.02, 0.01
"""Of the link, each way, and the share of its packets that never arrive."""
CUT_S = 3.0
"""How long the link is cut, s."""
LOSS_SEEN_S = 10.0
"""How long the arm runs over the link before it is cut, s: some hundred packets are lost."""
RUNNING = 0.9
"""Speed fraction of an arm that nothing holds up; it rises to one."""


@dataclass(frozen=True)
class NetworkFigures:
    """Two network namespaces, obstacles at 30 Hz; the deadline is the arm's `limiter.deadline_s` of 0.1 s.

    Silence counts from the last message that arrived: what had left before a cut may still come.
    """

    delay_ms: float
    loss: float
    cut_s: float
    cuts: int
    slow_after_s: float
    """From the last message until the arm was told to be slow, the longest of all cuts, s; infinite: never in one."""
    stopped_after_s: float
    """The same until it was told to stand."""
    slow_after_s_median: float
    stopped_after_s_median: float
    resumes_after_s: float
    """From the link's return until the arm was told to move, the longest, s."""
    out_of_order: int
    """Decisions whose evidence was older than that of one before."""
    slow_share: float
    """Share of the time before cuts in which loss alone kept the arm slow or standing."""
    age_ms_p50: float
    """Of evidence, when the decision made of it is heard, before cuts."""
    age_ms_p99: float


class _Heard:
    """What the arm's machine prints, as it comes."""

    def __init__(self, output: IO[str]) -> None:
        self.told: list[Told] = []
        self._changed = threading.Condition()
        self._ended = False
        self._thread = threading.Thread(target=self._read, args=(output,), name="heard", daemon=True)
        self._thread.start()

    def wait_until(self, condition: Callable[[], bool], complaint: str) -> None:
        """Raises `BenchError` where the condition does not come true."""
        with self._changed:
            if not self._changed.wait_for(lambda: self._ended or condition(), PATIENCE_S) or not condition():
                raise BenchError(f"bench graph: {complaint} within {PATIENCE_S:.0f} s; is the machine overloaded?")

    def _read(self, output: IO[str]) -> None:
        for line in output:
            with self._changed:
                self.told.append(Told(*json.loads(line)))
                self._changed.notify_all()
        with self._changed:
            self._ended = True
            self._changed.notify_all()


@dataclass(frozen=True)
class Cut:
    """When the link was cut and mended, and when it had begun to be watched before, monotonic, s."""

    watched: float
    cut: float
    mended: float


def network(cuts: int = 3) -> NetworkFigures:
    """Lets the arm run, cuts the link, and mends it, `cuts` times. Raises `BenchError` without namespaces."""
    twin, arm = Machine(f"{TWIN}/24"), Machine(f"{ARM}/24")
    link = Link(twin, arm, DELAY_S, LOSS)
    here = [sys.executable, "-m", "twin_node.bench.graph_machine"]
    try:
        twin.start([*here, "twin", f"tcp/{TWIN}:{PORT}"])
        output = arm.start([*here, "arm", f"tcp/{ARM}:{PORT}", f"tcp/{TWIN}:{PORT}"]).stdout
        assert output is not None
        heard = _Heard(output)
        made = [_cut(link, heard) for _ in range(cuts)]
    finally:
        link.is_cut = False
        for machine in (arm, twin):
            machine.end()
        link.close()
        for machine in (arm, twin):
            machine.close()
    return figures_of(heard.told, made)


def _cut(link: Link, heard: _Heard) -> Cut:
    told, pause = heard.told, threading.Event()
    heard.wait_until(lambda: bool(told) and told[-1].fraction > RUNNING, "the arm did not move")
    watched = time.monotonic()
    pause.wait(LOSS_SEEN_S)
    heard.wait_until(lambda: told[-1].fraction > RUNNING, "the arm did not move")
    link.is_cut, cut = True, time.monotonic()
    pause.wait(CUT_S)
    link.is_cut, mended = False, time.monotonic()
    heard.wait_until(lambda: told[-1].at > mended and told[-1].fraction > 0, "the arm did not go on")
    return Cut(watched, cut, mended)


def figures_of(told: list[Told], cuts: list[Cut]) -> NetworkFigures:
    """What decisions, in the order in which they were heard, say of the cuts that were made meanwhile."""
    slow_fraction = LimiterParameters().slow_fraction
    slow = [_silence_s(told, cut, slow_fraction) for cut in cuts]
    stopped = [_silence_s(told, cut, 0.0) for cut in cuts]
    resumed = [next(t.at for t in told if t.at > c.mended and t.fraction > 0) - c.mended for c in cuts]
    evidence = [t.evidence for t in told if t.evidence]
    offset_s = time.time() - time.monotonic()
    before = [t for c in cuts for t in told if c.watched < t.at < c.cut]
    ages = [1e3 * (t.at + offset_s - t.evidence * 1e-9) for t in _news(before)]
    return NetworkFigures(
        delay_ms=1e3 * DELAY_S,
        loss=LOSS,
        cut_s=cuts[0].mended - cuts[0].cut,
        cuts=len(cuts),
        slow_after_s=max(slow),
        stopped_after_s=max(stopped),
        slow_after_s_median=float(np.median(slow)),
        stopped_after_s_median=float(np.median(stopped)),
        resumes_after_s=max(resumed),
        out_of_order=int((np.diff(evidence) < 0).sum()),
        slow_share=sum(_slow_s(told, c, slow_fraction) for c in cuts) / sum(c.cut - c.watched for c in cuts),
        age_ms_p50=float(np.percentile(ages, 50)),
        age_ms_p99=float(np.percentile(ages, 99)),
    )


def _slow_s(told: list[Told], cut: Cut, fraction: float) -> float:
    """For how long before a cut, s, the arm was told no more than a fraction: silence is filled with decisions as often
    as it takes, which are no measure of its length."""
    watched = [t for t in told if cut.watched < t.at < cut.cut]
    until = [*(t.at for t in watched[1:]), cut.cut]
    return sum(end - t.at for t, end in zip(watched, until, strict=True) if t.fraction <= fraction)


def _news(told: list[Told]) -> list[Told]:
    """Decisions that a message had come for."""
    return [now for before, now in itertools.pairwise(told) if now.evidence != before.evidence]


def _silence_s(told: list[Told], cut: Cut, fraction: float) -> float:
    """From the last message before or during a cut until the arm was told no more than a fraction; infinite: never."""
    last = max(t.at for t in _news([t for t in told if t.at < cut.mended]))
    return next((t.at - last for t in told if last <= t.at < cut.mended and t.fraction <= fraction), math.inf)
