"""The drift node: image sets in, sets of the cameras that still stand where they were calibrated out."""

from __future__ import annotations

import contextlib
from pathlib import Path

from twin_node.messages import convert
from twin_node.nodes.topics import DIAGNOSTICS, DRIFT, FRAMES, TRUSTED_FRAMES
from twin_node.rig.drift import DriftParameters, DriftWatch
from twin_node.rig.drift_report import Drift, DriftReport, Verdict
from twin_node.runtime.bus import Bus
from twin_node.runtime.clock import Clock, SystemClock
from twin_node.runtime.node import Node
from twin_node.scene import FrameSet

PERIOD_NS = 1_000_000_000
"""Diagnostics go out at 1 Hz of evidence time, as is customary, and at once when a verdict changes."""
KEPT_PERIOD_NS = 10_000_000_000
"""How often what is known of the cameras is saved, besides when a verdict changes: a camera that creeps is watched for
longer than this before it is named."""
FILE = "cameras"
"""Where, in the folder of what is kept."""

_LEVELS = {
    Verdict.STEADY: convert.Level.OK,
    Verdict.UNSURE: convert.Level.WARN,
    Verdict.DRIFTING: convert.Level.WARN,
    Verdict.BUMPED: convert.Level.ERROR,
    Verdict.LOST: convert.Level.ERROR,
    Verdict.FROZEN: convert.Level.ERROR,
}


class DriftNode(Node):
    """Takes the images of cameras that have moved, or hang, out of every set, and says which.

    What such a camera alone saw is unknown from then on. A set that no trusted camera is left of is not passed on:
    forecasts stop, and who depends on them slows and stops.

    By this computer's clock, a node that is made anew (that clock was put back, or the process before has ended) goes
    on with what the one before knew: neither puts a camera back. Where a log's time goes back it has begun again, and
    so does the watch.
    """

    def __init__(self, bus: Bus, clock: Clock, parameters: DriftParameters, kept: Path | None = None) -> None:
        """`kept`: folder in which the node leaves what it knows to the one that takes its place; None: in none."""
        super().__init__("drift", bus, clock)
        self._parameters = parameters
        self._watch: DriftWatch
        self._file = kept / FILE if kept is not None and isinstance(clock, SystemClock) else None
        self._told: tuple[Verdict, ...] = ()
        self._next = 0
        self._next_kept = 0
        self._passed: int | None = None
        """Stamp of the last set that was passed on, ns."""

    def on_configure(self) -> None:
        self._watch = DriftWatch(self._parameters)
        if self._file is not None and self._file.exists():
            self._watch.recall(self._file.read_bytes())
        self.bus.subscribe(FRAMES, self._on_frames)

    def on_cleanup(self) -> None:
        self._keep()
        self._passed = None

    def _on_frames(self, frames: FrameSet) -> None:
        report = self._watch.update(frames)
        self.bus.publish(DRIFT, report)
        self._tell(report)
        trusted = report.trusted(frames)
        if trusted is None:
            return
        if self._passed is None or trusted.stamp >= self._passed:  # without its newest camera a set may reach less far
            self._passed = trusted.stamp
            self.bus.publish(TRUSTED_FRAMES, trusted)

    def _tell(self, report: DriftReport) -> None:
        is_news = report.verdicts != self._told
        if is_news or report.stamp >= self._next_kept:
            self._next_kept = report.stamp + KEPT_PERIOD_NS
            self._keep()
        if not is_news and report.stamp < self._next:
            return
        self._told, self._next = report.verdicts, report.stamp + PERIOD_NS
        diagnoses = [diagnosis_of(drift) for drift in report.drifts]
        self.bus.publish(DIAGNOSTICS, convert.diagnostics_to_message(report.stamp, diagnoses))

    def _keep(self) -> None:
        if self._file is None:
            return
        with contextlib.suppress(OSError):  # a full disk must not end the twin too; what was kept before stands
            new = self._file.with_suffix(".new")
            new.write_bytes(self._watch.memory())
            new.replace(self._file)


def diagnosis_of(drift: Drift) -> convert.Diagnosis:
    """A camera's entry in `/diagnostics`."""
    return convert.Diagnosis(
        f"drift: {drift.camera}",
        _LEVELS[drift.verdict],
        drift.message,
        (
            convert.Reading("residual_px", f"{drift.residual_px:.2f}"),
            convert.Reading("turn_deg", f"{drift.angle_deg:.3f}"),
            convert.Reading("features", str(drift.features)),
            convert.Reading("since_s", f"{drift.since / 1e9:.3f}"),
        ),
        drift.camera,
    )
