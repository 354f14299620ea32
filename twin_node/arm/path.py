"""Where the arm will be: sampling a joint path ahead of now, and extrapolation without one."""

from __future__ import annotations

from bisect import bisect_right
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin_node.arm.errors import ArmError
from twin_node.robot import ArmModel
from twin_node.scene import HORIZONS_NS, Float64, JointPath, JointSample

AHEAD_NS = HORIZONS_NS[-1]
"""How far ahead the arm is looked at, ns: as far as obstacles are forecast."""
STEP_NS = 10_000_000
"""Time between two looked-at poses, ns: at 1 m/s the arm moves 10 mm, far less than its own width."""
_FINE_NS = 30_000_000
"""Samples of a path no farther apart than this tell enough of it, ns: at 1 m/s the arm moves 30 mm."""
_PLAY_RAD = 0.02
"""So far beyond its range a joint at its end may be measured, by noise, give and zeros that differ: a degree."""
_SAMPLE_LASTS_NS = 1_000_000_000
"""An arm is taken to keep its velocities for so long, ns: twice as long as live joints are believed, for a forecast
begins later."""


def ahead_offsets() -> NDArray[np.int64]:
    """Times [T] after now at which the arm is looked at, ns: every 10 ms up to 200 ms."""
    return np.arange(0, AHEAD_NS + 1, STEP_NS, dtype=np.int64)


def sample_path(path: JointPath, stamps: NDArray[np.integer]) -> Float64:
    """Joint positions [T, J] (rad) at times [T] (ns), linear between samples; the arm stands before and after the path.

    Raises `ArmError` for a path without samples, with stamps that are unsorted or no signed integers, with the wrong
    shape or with values not finite.
    """
    _check(path)
    start = path.stamps[0]
    times = (np.asarray(stamps) - start).astype(np.float64)
    knots = (path.stamps - start).astype(np.float64)
    return np.stack([np.interp(times, knots, column) for column in path.positions.T], axis=-1)


def told_finely(path: JointPath) -> JointPath:
    """A path with poses every 10 ms where samples are farther apart than 30 ms; linear between these.

    Raises `ArmError` as `sample_path` does.
    """
    if len(path.stamps) < 2 or np.diff(path.stamps).max() <= _FINE_NS:
        return path
    stamps = np.union1d(path.stamps, np.arange(path.stamps[0], path.stamps[-1], STEP_NS))
    return JointPath(path.names, stamps, sample_path(path, stamps))


class SampledPath:
    """A path that is checked once, for those who ask it for one time after another: `sample_path` with less to do."""

    def __init__(self, path: JointPath) -> None:
        """Raises `ArmError` as `sample_path` does."""
        _check(path)
        self._stamps: list[int] = path.stamps.tolist()
        self._positions: Float64 = np.asarray(path.positions, dtype=np.float64)
        self._velocities = np.diff(self._positions, axis=0) / np.diff(path.stamps)[:, None]
        """[T - 1, J] rad/ns."""

    def at(self, stamp: int) -> Float64:
        """Joint positions [J] (rad) at a time, ns."""
        after = bisect_right(self._stamps, stamp)
        before = max(after - 1, 0)
        position: Float64 = self._positions[before].copy()
        if 0 < after < len(self._stamps):
            position += self._velocities[before] * (stamp - self._stamps[before])
        return position


def _check(path: JointPath) -> None:
    if len(path.stamps) == 0 or path.positions.shape != (len(path.stamps), len(path.names)):
        raise ArmError(
            f"joint path: expected positions of shape ({len(path.stamps)}, {len(path.names)}) with at least one row, "
            f"found {path.positions.shape}; check who publishes the trajectory"
        )
    check_stamps("joint path", path.stamps)
    if len(path.stamps) > 1 and np.diff(path.stamps).min() <= 0:
        raise ArmError("joint path: expected strictly increasing stamps, found one that is not; check the trajectory")
    if not np.isfinite(path.positions).all():
        raise ArmError("joint path: expected finite angles, found NaN or infinity; check the trajectory")


def check_stamps(what: str, stamps: NDArray[Any]) -> None:
    """Raises `ArmError` for stamps [T] that are no signed integers (ns): differences of unsigned ones wrap around."""
    if stamps.dtype.kind != "i":
        raise ArmError(
            f"{what}: expected stamps in whole nanoseconds, signed (int64), found {stamps.dtype}; convert them, and of "
            "seconds give np.rint(1e9 * seconds).astype(np.int64)"
        )


def path_ahead(model: ArmModel, path: JointPath, stamp: int) -> JointPath:
    """The path's next 200 ms from a time on (ns), in the model's own order of joints; the arm stands from its end on.

    Raises `ArmError` or `RobotError` for a path that the arm cannot follow, and `ArmError` for one that has not begun
    or is over: of where the arm is it tells nothing.
    """
    if len(path.stamps) and not path.stamps[0] <= stamp <= path.stamps[-1]:
        early_s, late_s = (path.stamps[0] - stamp) * 1e-9, (stamp - path.stamps[-1]) * 1e-9
        found = f"begins {early_s:.3g} s later" if early_s > 0 else f"was over {late_s:.3g} s before"
        raise ArmError(
            f"joint path: expected one that holds at the time that is asked for, found one that {found}; give what the "
            "arm does now, stamped by the clock of that time, or where its joints are (`path_from_sample`)"
        )
    stamps = stamp + ahead_offsets()
    return JointPath(model.joint_names, stamps, model.order(path.names, sample_path(path, stamps)))


def extrapolate(model: ArmModel, q: NDArray[np.floating], qd: NDArray[np.floating], stamp: int) -> JointPath:
    """The next 200 ms from a time on (ns) of an arm at angles [J] (rad) that keeps its velocities [J] (rad/s).

    Both are in the model's order, measured or the controller's targets, and joints stop at the ends of their range,
    unless they are beyond it already. No velocity is too high to be believed: ratings of an arm's file may be made up.
    Raises `RobotError` for a wrong count or values that are not finite.
    """
    start = model.check_positions(q)
    offsets = ahead_offsets()
    positions = kept_up(model, start, model.check_positions(qd), offsets * np.float64(1e-9))
    return JointPath(model.joint_names, stamp + offsets, positions)


def path_from_sample(model: ArmModel, sample: JointSample, stamp: int) -> JointPath:
    """The next 200 ms from a time on (ns) of an arm that has kept, and keeps, the velocities of a sample.

    The sample's joints may be in any order; ranges hold since the sample as `extrapolate` has them. Raises `RobotError`
    where a joint is missing or a value is not finite, and `ArmError` for a sample that is more than a second from that
    time, or by another clock: of where the arm is it tells nothing.
    """
    if abs(stamp - sample.stamp) > _SAMPLE_LASTS_NS:
        raise ArmError(
            f"joints: expected them within {_SAMPLE_LASTS_NS / 1e9:g} s of the time that is asked for, found some of "
            f"{(stamp - sample.stamp) / 1e9:.3g} s before it; give the newest, stamped by the clock of that time"
        )
    return extrapolate(model, gone_since(model, sample, stamp), model.order(sample.names, sample.velocities), stamp)


def gone_since(model: ArmModel, sample: JointSample, stamp: int) -> Float64:
    """Angles [J] (rad) at a time (ns), however late, of an arm that has kept the velocities of a sample until then.

    Raises `RobotError` where a joint is missing or a value is not finite.
    """
    q, qd = model.order(sample.names, sample.positions), model.order(sample.names, sample.velocities)
    age_s = max(stamp - sample.stamp, 0) * 1e-9
    now: Float64 = kept_up(model, model.check_positions(q), model.check_positions(qd), np.array([age_s]))[0]
    return now


def go_on(model: ArmModel, path: JointPath, lasting_ns: int, step_ns: int = STEP_NS) -> JointPath:
    """A path in the model's order whose joints keep, for a time (ns), the velocities that they have at its end.

    It is told in steps of `step_ns` at most. Ranges hold as `extrapolate` has them. Of a path of one sample nothing is
    told: it is given back as it is.
    """
    if len(path.stamps) < 2 or lasting_ns == 0:
        return path
    *_, before, last = path.positions
    velocities = (last - before) / (int(path.stamps[-1] - path.stamps[-2]) * 1e-9)
    offsets = np.linspace(0, lasting_ns, -(-lasting_ns // step_ns) + 1)[1:].round().astype(np.int64)
    positions = kept_up(model, last, velocities, offsets * np.float64(1e-9))
    stamps = np.concatenate([path.stamps, path.stamps[-1] + offsets])
    return JointPath(path.names, stamps, np.concatenate([path.positions, positions]))


def kept_up(model: ArmModel, start: Float64, velocities: Float64, seconds: Float64) -> Float64:
    """Angles [T, J] (rad) after times [T] of joints that keep their velocities [J] (rad/s), within the arm's ranges.

    A joint that is beyond its range by no more than play comes no further there. One that is farther beyond has no end
    there: its driver counts turns otherwise, or the file is wrong.
    """
    lower, upper = model.lower, model.upper
    if max(np.maximum(start - upper, lower - start).tolist()) > 0:  # a list's `max` takes half the time of an array's
        lower = np.where(start < lower - _PLAY_RAD, -np.inf, np.minimum(lower, start))
        upper = np.where(start > upper + _PLAY_RAD, np.inf, np.maximum(upper, start))
    kept: Float64 = start + velocities * seconds[:, None]
    np.maximum(kept, lower, out=kept)
    return np.minimum(kept, upper, out=kept)
