"""Tells cameras that do not send as they should: silent, slow, late, or with a clock that steps, is ahead or behind."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from twin_node.errors import several
from twin_node.messages.convert import Diagnosis, Level, Reading
from twin_node.nodes.latency import LONGEST_BRIDGED_NS
from twin_node.rig import InputCounts, SyncReport

SLOW_SHARE = 0.75
"""A camera at less than this share of the fastest one's rate is named, or of its own with depth: a missed image in four
is no jitter."""
ON_THE_EDGE = 1
"""Images that may have come just before or after a report, and that a camera is not slow, or silent, for."""
LATE_NS = 20_000_000
"""A camera whose images arrive so much later after their stamps than another's is named: half a period at 30 Hz."""
OLD_NS = LONGEST_BRIDGED_NS
"""Images this old when they arrive are of no use, though all cameras' be: an arm stands for what is older."""
AHEAD_NS = 5_000_000
"""Images that are stamped so long after their arrival come of a clock that is ahead: latency and forecasts seem shorter
by that. Less may be what a calibrated offset is wrong by."""
COUNTED = (
    ("late", "came after their set had gone"),
    ("duplicate", "had the stamp of the one before"),
    ("unsorted", "were stamped before the one before"),
    ("future", "were stamped after their arrival"),
)
"""Counts of the synchroniser that must stand still, and what they say of images."""


@dataclass
class _Seen:
    """One camera's images since the last report."""

    stamps: list[int] = field(default_factory=list)
    lags: list[int] = field(default_factory=list)
    depths: int = 0
    """Images with depth."""
    depth_frames: set[tuple[str, str]] = field(default_factory=set)
    """Frames of depth and of its colour image, where they differ."""
    unusable: list[str] = field(default_factory=list)
    """What was wrong with each image that could not be used."""


class CameraWatch:
    """Keeps stamps and arrivals between two reports."""

    def __init__(self, cameras: Sequence[str]) -> None:
        self._seen = {name: _Seen() for name in cameras}
        self._before: dict[str, InputCounts] = {}
        self._usual: dict[str, int] = {}
        """Images by the report before."""
        self._measuring: set[str] = set()
        """Cameras that have sent depth."""

    def add(self, camera: str, stamp: int, arrival: int, with_depth: bool = False) -> None:
        """Takes note of an image: both times in ns, on the graph's clock."""
        self._seen[camera].stamps.append(stamp)
        self._seen[camera].lags.append(arrival - stamp)
        if with_depth:
            self._seen[camera].depths += 1

    def add_depth(self, camera: str) -> None:
        """Takes note that a camera measures depth, whether or not its images can be paired with those of colour."""
        self._measuring.add(camera)

    def add_depth_frame(self, camera: str, of_depth: str, of_colour: str) -> None:
        """Takes note of the frames that a depth image and its colour image are said to be of."""
        if of_depth.lstrip("/") != of_colour.lstrip("/"):
            self._seen[camera].depth_frames.add((of_depth, of_colour))

    def add_unmeasured(self, camera: str) -> None:
        """Takes note that depth which has come tells nothing: no pixel of it was measured."""
        self._seen[camera].depths -= 1

    def add_unusable(self, camera: str, why: str) -> None:
        """Takes note of an image that its set goes without."""
        self._seen[camera].unusable.append(why)

    def diagnoses(self, node: str, report: SyncReport) -> tuple[Diagnosis, ...]:
        """One per camera, of what was seen since the last call; `report` holds the synchroniser's totals."""
        counts = {name: len(seen.stamps) for name, seen in self._seen.items()}
        lags = {name: float(np.median(seen.lags)) for name, seen in self._seen.items() if seen.lags}
        most = max(counts.values())
        least_lag = min((max(lag, 0.0) for lag in lags.values()), default=0.0)  # one ahead of time is not the quickest
        found = []
        for totals in report.inputs:
            name = totals.name
            lag = lags.get(name, 0.0)
            faults = self._faults(totals, counts[name], most, lag - least_lag)
            if lag > OLD_NS:
                faults.append(
                    f"old: images are stamped {lag / 1e9:.1f} s before their arrival; let chrony or PTP keep the "
                    "clocks together, or look for what holds them up"
                )
            if lag < -AHEAD_NS:
                faults.append(
                    f"ahead: images are stamped {-lag / 1e6:.0f} ms after their arrival; let chrony or PTP keep the "
                    "clocks together"
                )
            level = Level.ERROR if self._is_silent(name, counts[name]) else Level.WARN if faults else Level.OK
            text = "; ".join(faults) or "in step with the others"
            found.append(Diagnosis(f"{node}: {name}", level, text, _readings(totals, lag), name))
            self._before[name] = totals
        self._usual = counts
        self._seen = {name: _Seen() for name in self._seen}
        return tuple(found)

    def _is_silent(self, name: str, count: int) -> bool:
        """Whether a camera with so many images has stopped: one with about one a report may have it a moment later."""
        return count == 0 and not 0 < self._usual.get(name, 0) <= ON_THE_EDGE

    def _faults(self, totals: InputCounts, count: int, most: int, extra_lag: float) -> list[str]:
        before = self._before.get(totals.name, InputCounts(totals.name))
        faults = []
        if self._is_silent(totals.name, count):
            rest = "the twin goes on without it" if most else "nor of any other camera: the twin waits"
            faults.append(f"silent: no image since the last report; {rest}")
        elif count + ON_THE_EDGE < SLOW_SHARE * most:
            faults.append(f"slow: {several(count, 'image')} where the fastest camera sent {most}")
        if extra_lag > LATE_NS:
            faults.append(f"lags: images arrive {extra_lag / 1e6:.0f} ms later after their stamps than the quickest's")
        depths = max(self._seen[totals.name].depths, 0)  # what came before the last report may be decoded after it
        if totals.name in self._measuring and depths < SLOW_SHARE * count:
            faults.append(
                f"no depth: it came with {depths} of {count} images; look at the depth camera, and whether its images "
                "have the stamps of the colour images and come at most 60 ms after them"
            )
        for of_depth, of_colour in sorted(self._seen[totals.name].depth_frames):
            faults.append(
                f"depth of another lens: it is of {of_depth!r}, the image of {of_colour!r}; let the driver align it "
                "with the colour image (realsense2_camera: align_depth.enable:=true), or name their frames alike if it "
                "does"
            )
        if unusable := self._seen[totals.name].unusable:
            faults.append(f"unusable: {several(len(unusable), 'image')}, the last: {unusable[-1]}")
        apart = totals.unmatched - before.unmatched
        if totals.used == before.used and 2 * apart > count:
            faults.append(
                f"in no set: {apart} images came when the other cameras' were too far away; let the cameras be "
                "triggered together or faster, or raise the synchronizer's grouping.max_interval_ns or deadline_ns"
            )
        for key, meaning in COUNTED:
            more = getattr(totals, key) - getattr(before, key)
            if more > 0:
                faults.append(f"{key}: {several(more, 'image')} {meaning}")
        return faults


def _readings(totals: InputCounts, lag_ns: float) -> tuple[Reading, ...]:
    names = ("received", "used", "unmatched", "late", "duplicate", "unsorted", "future", "missed")
    return (
        *(Reading(name, str(getattr(totals, name))) for name in names),
        Reading("lag_ms", f"{lag_ns / 1e6:.1f}"),
    )
