"""What is known of whether cameras stand where they were calibrated, and what to do about it in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum

from twin_node.scene import FrameSet


class Verdict(IntEnum):
    """What is known of a camera's place."""

    STEADY = 0
    """Where it was calibrated."""
    UNSURE = 1
    """Too little of what stands is in sight to tell."""
    DRIFTING = 2
    """Off by less than a bump, for a while: still used."""
    BUMPED = 3
    """Not where it was calibrated: its images must not be used."""
    LOST = 4
    """Nothing that stood is in sight, and what is stands as well, or is what another camera saw: turned away, covered,
    or its device has changed places. Its images must not be used."""
    FROZEN = 5
    """Sends the same image again and again under new stamps: what it shows is past. Its images must not be used."""


@dataclass(frozen=True)
class Drift:
    """What the last check of a camera found."""

    camera: str
    verdict: Verdict
    residual_px: float
    """Root mean square displacement of landmarks from where they were, pixels of the images watched."""
    angle_deg: float
    """The turn that would explain it."""
    features: int
    """Landmarks that it is judged by; 0 where too few were found."""
    since: int
    """When the verdict's cause began, ns; of a drift, when it was last at half its size or less."""
    slow: bool = False
    """Whether it came little by little: heat and loosening mounts creep, knocks do not."""
    measures_depth: bool = False
    """Whether the camera has ever measured depth."""

    @property
    def trusted(self) -> bool:
        """Whether the camera's images may be used."""
        return self.verdict not in (Verdict.BUMPED, Verdict.LOST, Verdict.FROZEN)

    @property
    def message(self) -> str:
        """The verdict and what to do about it, to follow the camera's name."""
        return _CREPT if self.slow and self.verdict == Verdict.BUMPED else _MESSAGES[self.verdict]


@dataclass(frozen=True)
class DriftReport:
    """What is known of all cameras of a rig."""

    stamp: int
    """ns."""
    drifts: tuple[Drift, ...]

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """Of the cameras, in their order."""
        return tuple(drift.verdict for drift in self.drifts)

    @property
    def distrusted(self) -> tuple[str, ...]:
        """Names of the cameras whose images must not be used."""
        return tuple(drift.camera for drift in self.drifts if not drift.trusted)

    def trusted(self, frames: FrameSet) -> FrameSet | None:
        """A set of the cameras' without those images; None where none is left: nobody knows then what is there."""
        views = tuple(view for view in frames.views if view.camera.name not in self.distrusted)
        return replace(frames, stamp=max(view.stamp for view in views), views=views) if views else None

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a reader must know, one line per matter; stable as long as nothing changes."""
        if self.drifts and len(self.distrusted) == len(self.drifts):
            return (_none_left(self.drifts),)
        lines = [f"camera {drift.camera} {drift.message}" for drift in self.drifts if drift.verdict != Verdict.STEADY]
        left = [drift for drift in self.drifts if drift.trusted]
        if len(left) == 1 < len(self.drifts):
            lines.append(f"camera {left[0].camera} is the only one left{_ALONE[left[0].measures_depth]}")
        return tuple(lines)


_CREPT = "has crept out of place: its images are left out; run `twin_node calibrate refine` on a recording of today"
_MESSAGES = {
    Verdict.STEADY: "stands where it was calibrated",
    Verdict.UNSURE: "sees too little of what stands still to tell whether it has moved",
    Verdict.DRIFTING: "creeps out of place: run `twin_node calibrate refine` on a recording of today",
    Verdict.BUMPED: "has moved: its images are left out; put it back, or calibrate it anew",
    Verdict.LOST: "sees nothing of what stood there, turned away, covered or swapped: its images are left out; free it",
    Verdict.FROZEN: "hangs, it sends the same image again and again: its images are left out; restart it or its driver",
}
_ALONE = {
    True: ": what it does not see is unknown",
    False: ", and measures no depth: all along its lines of sight to what moves is unknown",
}


def _none_left(drifts: Sequence[Drift]) -> str:
    """What to say where no camera may be used."""
    if len(drifts) == 1:
        return f"camera {drifts[0].camera} {drifts[0].message}; nothing is published, for it is the only one"
    if all(drift.verdict == Verdict.BUMPED for drift in drifts):
        return (
            "all cameras seem to have moved: what carries them has, or all that they look at; nothing is published; "
            "put it back, or calibrate anew and restart"
        )
    if all(drift.verdict == Verdict.LOST for drift in drifts):
        return (
            "all cameras see nothing of what stood there: the cell is lit otherwise than when the twin began, or all "
            "are covered; nothing is published; free their views, give the cell its light back, or start the twin anew"
        )
    return (
        "no camera is to be trusted: each has moved, hangs, is covered or turned away; nothing is published; free "
        "their views, and restart those that hang"
    )
