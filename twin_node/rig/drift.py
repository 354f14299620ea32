"""Watches whether cameras stay where they were calibrated: what stands still must stay still in their images."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from twin_node.ranges import NOT_NEGATIVE, POSITIVE, Range, check_ranges
from twin_node.rig.drift_report import Drift, DriftReport, Verdict
from twin_node.rig.errors import RigError
from twin_node.rig.landmarks import INLIER_PX, CommonMotion, Landmarks, contrast, features_of, tracked
from twin_node.rig.repeats import Streams
from twin_node.scene import Bool, Camera, Float64, FrameSet, UInt8

STANDING_PART = 0.5
"""Share of an image's features that stand from check to check where the scene does: people and the arm are the rest."""


@dataclass(frozen=True)
class DriftParameters:
    """When a camera counts as bumped, as drifting, as lost."""

    angle_deg: float = 0.3
    """Turn from which a camera is named: at 1 m it puts things 5 mm off."""
    least_px: float = 0.35
    """The same in pixels of the images watched: below it tracking noise rules."""
    confirm: int = 3
    """Checks in a row that must agree before a camera is named, or cleared again."""
    period_ms: float = 200.0
    """Time between two checks of a camera."""
    least_features: int = 15
    """Landmarks that must be found for a verdict."""
    least_share: float = 0.6
    """Share of the image that must stand still, or move as one: otherwise too much is in the way for a verdict."""
    slow_deg: float = 0.06
    """Turn, averaged over `average_s`, from which a camera that was not bumped counts as drifting."""
    slow_px: float = 0.1
    """The same in pixels of the images watched: averaged tracking noise and compression stay below it."""
    average_s: float = 10.0
    """Time constant of that average, s."""
    drifting_s: float = 30.0
    """A camera drifts when the average stayed beyond `slow_deg` for so long, s."""
    lost_s: float = 3.0
    """A camera is lost when it showed another, standing scene for so long, s: people do not stand so still."""

    def __post_init__(self) -> None:
        """Raises `RigError` for a number that is none of its kind."""
        check_ranges(
            self,
            RigError,
            "drift: ",
            angle_deg=POSITIVE,
            least_px=POSITIVE,
            confirm=Range(1, 1000),
            period_ms=NOT_NEGATIVE,
            least_features=Range(4, 1000),
            least_share=Range(0, 1, above=True),
            slow_deg=POSITIVE,
            slow_px=POSITIVE,
            average_s=POSITIVE,
            drifting_s=NOT_NEGATIVE,
            lost_s=NOT_NEGATIVE,
        )


class DriftWatch:
    """Names cameras that are no longer where they were when the watch began.

    Light, people and the arm move no camera: brightness is taken out, and the parts of the image vote. A camera that
    nothing can be said of stays off where it was off, else it becomes UNSURE. One that comes with another calibration
    is watched anew; make another watch when the cell was rearranged. A camera that hangs is named too: its image would
    show for ever that nobody has come.
    """

    def __init__(self, parameters: DriftParameters | None = None) -> None:
        self._parameters = parameters or DriftParameters()
        self._cameras: dict[str, _Watched] = {}

    def update(self, frames: FrameSet) -> DriftReport:
        """Takes a set of undistorted images, in the order in which they were taken.

        Where stamps go back the clock was put back: what began so long ago still did.
        """
        for view in frames.views:
            watched = self._cameras.get(view.camera.name)
            if watched is None or not _is_same(watched.camera, view.camera):
                landmarks = Landmarks(contrast(view.rgb), view.valid, view.camera.K)
                watched = _Watched(view.camera, landmarks, view.stamp, view.depth is not None)
                watched.streams.take(view)
                self._cameras[view.camera.name] = watched
                continue
            watched.measures_depth |= view.depth is not None
            if view.stamp < watched.checked:
                watched.put_back(watched.checked - view.stamp)
            watched.streams.take(view)
            if view.stamp - watched.checked >= self._parameters.period_ms * 1e6:
                others = [other.landmarks for other in self._cameras.values() if other is not watched]
                watched.check(contrast(view.rgb), view.valid, view.stamp, self._parameters, others)
        return DriftReport(frames.stamp, tuple(map(self._drift_of, self._cameras.values())))

    def memory(self) -> bytes:
        """What is known of the cameras, for a watch in another process; not which of them hang just now."""
        return pickle.dumps(list(self._cameras.values()), pickle.HIGHEST_PROTOCOL)

    def recall(self, memory: bytes) -> None:
        """Goes on with what a watch of the same program has left as its `memory`."""
        self._cameras = {watched.camera.name: watched for watched in pickle.loads(memory)}

    def _drift_of(self, watched: _Watched) -> Drift:
        """What to say of a camera: that it hangs goes before where it stands, which is not known then."""
        others = [other.streams for other in self._cameras.values() if other is not watched]
        if not watched.streams.hang(others):
            return watched.drift
        return replace(watched.drift, verdict=Verdict.FROZEN, since=watched.streams.since, slow=False)


@dataclass
class _Watched:
    """One camera's landmarks and what became of them."""

    camera: Camera
    landmarks: Landmarks
    checked: int
    """When it was last looked at, ns."""
    measures_depth: bool
    """Whether it ever has."""
    drift: Drift = field(init=False)
    turn: Float64 = field(default_factory=lambda: np.zeros(3))
    """[3] rotation vector by which the camera was off when its landmarks were last found, rad."""
    suspected: Verdict = Verdict.STEADY
    """What the last checks in a row said."""
    suspicions: int = 0
    suspected_since: int = 0
    creep: _Creep = field(init=False)
    still: _Stillness = field(init=False)
    streams: Streams = field(default_factory=Streams)

    def __post_init__(self) -> None:
        name, count = self.camera.name, len(self.landmarks)
        self.drift = Drift(name, Verdict.STEADY, 0.0, 0.0, count, self.checked, measures_depth=self.measures_depth)
        self.creep = _Creep(self.checked)
        self.still = _Stillness(self.checked)

    def __getstate__(self) -> dict[str, Any]:
        """Without the last images: they are many times as large, and whether a camera hangs is soon found out anew."""
        return {**self.__dict__, "streams": Streams(), "still": _Stillness(self.checked)}

    def put_back(self, by: int) -> None:
        """The clock was put back by so much, ns."""
        self.checked -= by
        self.suspected_since -= by
        self.drift = replace(self.drift, since=self.drift.since - by)
        self.creep.put_back(by)
        self.still.put_back(by)
        self.streams.since -= by

    def check(
        self, image: UInt8, valid: Bool | None, stamp: int, parameters: DriftParameters, others: Sequence[Landmarks]
    ) -> None:
        """Compares an image with the landmarks, or else with other cameras', and remembers the verdict."""
        seconds, self.checked = (stamp - self.checked) / 1e9, stamp
        now = self.landmarks.found_in(image)
        motion = self.landmarks.motion(now, parameters.least_features, parameters.least_share)
        if motion is None:
            features, least, share = self.landmarks.agreeing(now), parameters.least_features, parameters.least_share
            if features < least and any(other.stand_in(image, least, share) for other in others):
                self._conclude(Verdict.LOST, 0, stamp, parameters)
            else:
                self._judge_blind(image, valid, stamp, parameters, features)
        else:
            self.still.forget()
            self._judge_motion(motion, stamp, seconds, parameters)
        if self.suspected != Verdict.BUMPED and self.drift.trusted:
            self.landmarks.drop_strays(now)
            self._renew(image, valid, motion is not None, parameters)

    def _judge_motion(self, motion: CommonMotion, stamp: int, seconds: float, parameters: DriftParameters) -> None:
        off = _degrees(motion.turn) > parameters.angle_deg and motion.residual_px > parameters.least_px
        if not off:
            share = 1 - np.exp(-seconds / parameters.average_s)
            self.creep.turn = self.creep.turn + share * (motion.turn - self.creep.turn)
            self.creep.watch(self._excess(parameters), stamp)
        creeps = self.creep.lasts_s(stamp) >= parameters.drifting_s
        verdict = Verdict.BUMPED if off else Verdict.DRIFTING if creeps else Verdict.STEADY
        self.turn = motion.turn
        self._conclude(verdict, motion.features, stamp, parameters)

    def _excess(self, parameters: DriftParameters) -> float:
        """The averaged motion as a share of what counts as drift."""
        pixels = self.landmarks.displacement_px(self.creep.turn)
        return min(_degrees(self.creep.turn) / parameters.slow_deg, pixels / parameters.slow_px)

    def _judge_blind(
        self, image: UInt8, valid: Bool | None, stamp: int, parameters: DriftParameters, features: int
    ) -> None:
        """Nothing vouches for the camera: a bumped one stays so, another is lost once what it shows stands still."""
        standing_s = self.still.seconds(image, valid, stamp, parameters.least_features)
        if features < parameters.least_features and standing_s >= parameters.lost_s:
            self._conclude(Verdict.LOST, 0, stamp, parameters)
        elif self.drift.trusted:
            self._conclude(Verdict.UNSURE, 0, stamp, parameters)

    def _conclude(self, verdict: Verdict, features: int, stamp: int, parameters: DriftParameters) -> None:
        """A verdict changes once enough checks in a row say the same."""
        if verdict != self.suspected:
            self.suspected, self.suspicions, self.suspected_since = verdict, 0, stamp
        self.suspicions += 1
        told, since, slow = self.drift.verdict, self.drift.since, self.drift.slow
        if verdict != told and self.suspicions >= parameters.confirm:
            told = verdict
            slow = told in (Verdict.DRIFTING, Verdict.BUMPED) and self.creep.rose_s >= parameters.drifting_s
            since = self.creep.began if slow or told == Verdict.DRIFTING else self.suspected_since
        turn = self.creep.turn if told == Verdict.DRIFTING else self.turn
        pixels = self.landmarks.displacement_px(turn)
        angle_deg = _degrees(turn)
        self.drift = Drift(self.camera.name, told, pixels, angle_deg, features, since, slow, self.measures_depth)

    def _renew(self, image: UInt8, valid: Bool | None, stands: bool, parameters: DriftParameters) -> None:
        """New landmarks where none was ever found again, for the watch began in the dark; and where few are left.

        Then only of a camera that `stands`, as they tell, or too few to tell are left: else what covers it, or what it
        sees once it was moved, would be where it belongs.
        """
        proven, count, least = self.landmarks.proven, len(self.landmarks), parameters.least_features
        if proven and (count >= 2 * least or (count >= least and not stands)):
            return
        fresh = Landmarks(image, valid, self.camera.K, self.creep.turn)
        if not proven or len(fresh) > 2 * count or count < least <= len(fresh):
            self.landmarks = fresh


class _Creep:
    """The average of a camera's small motions: what no single image could tell."""

    def __init__(self, stamp: int) -> None:
        self.turn: Float64 = np.zeros(3)
        """[3] average turn from home, rad: rotation vectors so small add up."""
        self.began = stamp
        """When it was last at half the threshold or less, ns."""
        self._beyond: int | None = None

    def put_back(self, by: int) -> None:
        """The clock was put back by so much, ns."""
        self.began -= by
        self._beyond = None if self._beyond is None else self._beyond - by

    def watch(self, excess: float, stamp: int) -> None:
        """Takes in the average's size as a share of the threshold."""
        if excess <= 0.5:
            self.began = stamp
        if excess <= 1:
            self._beyond = None
        elif self._beyond is None:
            self._beyond = stamp

    def lasts_s(self, stamp: int) -> float:
        """For how long it has been beyond the threshold, s."""
        return 0.0 if self._beyond is None else (stamp - self._beyond) / 1e9

    @property
    def rose_s(self) -> float:
        """How long it took from half the threshold to the threshold, s; 0 where it is not beyond it."""
        return 0.0 if self._beyond is None else (self._beyond - self.began) / 1e9


class _Stillness:
    """How long the image of a camera that recognises nothing has stood still."""

    def __init__(self, stamp: int) -> None:
        self._image: UInt8 | None = None
        self._since = stamp

    def put_back(self, by: int) -> None:
        """The clock was put back by so much, ns."""
        self._since -= by

    def forget(self) -> None:
        """The camera recognises something again."""
        self._image = None

    def seconds(self, image: UInt8, valid: Bool | None, stamp: int, least_features: int) -> float:
        """Time since the image changed, s; 0 for one without texture."""
        before, self._image = self._image, image
        if before is None:
            self._since = stamp
            return 0.0
        points = features_of(before, valid)
        now = tracked(before, image, points)
        stands = np.linalg.norm(now - points, axis=1) < INLIER_PX
        if len(points) < least_features or stands.mean() < STANDING_PART:
            self._since = stamp
        return (stamp - self._since) / 1e9


def _is_same(a: Camera, b: Camera) -> bool:
    """Whether two records are of one camera with one calibration."""
    if a is b:
        return True
    same_size = (a.width, a.height) == (b.width, b.height)
    return same_size and np.array_equal(a.K, b.K) and np.array_equal(a.T_base_cam, b.T_base_cam)


def _degrees(turn: Float64) -> float:
    return float(np.degrees(np.linalg.norm(turn)))
