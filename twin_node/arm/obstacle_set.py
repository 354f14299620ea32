"""Obstacles checked once and laid out for distance computations."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from twin_node.arm.errors import ArmError
from twin_node.arm.path import check_stamps
from twin_node.geometry import rotation_from_quat
from twin_node.scene import HORIZONS_NS, Bool, Float64, ObstacleKind, Obstacles, ObstacleShape, UInt8, UInt32

_NO_TURN = np.array([1.0, 0.0, 0.0, 0.0])
SAME_LAYER_NS = 25_000_000
"""Obstacles whose validity begins, or ends, this close together belong to one layer: half the step of the forecast's
horizons."""
_EARLY_NS = HORIZONS_NS[-1]
"""Evidence may come so much later than the time that is asked of, as computers' clocks differ: see `decide`."""
FLUSH_M = 1e-6
"""What ends so near to a box's face ends at it, m: sums of places and sizes are rounded."""
_FARTHEST = 1e6
"""m, m/s and s: no obstacle is farther, larger, faster or later. With numbers beyond it distances become infinite."""


@dataclass(frozen=True)
class ObstacleSet:
    """A checked set of obstacles: `source` as it came, and what distances need of it."""

    source: Obstacles
    centers: Float64
    """[n, 3] m."""
    rotations: Float64
    """[n, 3, 3]."""
    any_turned: bool
    """Whether any box stands otherwise than along the axes of `base_link`."""
    half: Float64
    """[n, 3] half extents, three times the radius for a sphere, m."""
    is_sphere: Bool
    """[n]."""
    outer_radii: Float64
    """[n] radius of the sphere about the centre that holds the shape, m."""
    slack: Float64
    """[n] outer radius less that of the largest sphere about the centre inside the shape, m."""

    @staticmethod
    def of(obstacles: Obstacles) -> ObstacleSet:
        """Lays out obstacles; raises `ArmError` for values that no obstacle can have."""
        _refuse_wrong(obstacles)
        half = np.asarray(obstacles.sizes, dtype=np.float64) / 2
        is_sphere = np.asarray(obstacles.shapes == ObstacleShape.SPHERE)
        outer = np.where(is_sphere, half[:, 0], np.linalg.norm(half, axis=1))
        any_turned = bool(obstacles.quats[~is_sphere, 1:].any())
        quats = np.where(is_sphere[:, None], _NO_TURN, obstacles.quats) if any_turned else _NO_TURN
        return ObstacleSet(
            source=obstacles,
            centers=np.asarray(obstacles.positions, dtype=np.float64),
            rotations=np.broadcast_to(rotation_from_quat(quats), (len(half), 3, 3)),
            any_turned=any_turned,
            half=half,
            is_sphere=is_sphere,
            outer_radii=outer,
            slack=outer - half.min(axis=1, initial=np.inf),
        )

    @staticmethod
    def empty() -> ObstacleSet:
        """No obstacles."""
        return ObstacleSet.of(Obstacles.none())

    def __len__(self) -> int:
        return len(self.centers)

    @property
    def ids(self) -> UInt32:
        """[n]."""
        return self.source.ids

    @property
    def kinds(self) -> UInt8:
        """[n] values of `ObstacleKind`."""
        return self.source.kinds

    @property
    def is_static(self) -> Bool:
        """[n]."""
        return np.asarray(self.kinds == ObstacleKind.STATIC)

    @property
    def is_unseen(self) -> Bool:
        """[n]."""
        return np.asarray(self.kinds == ObstacleKind.UNSEEN)

    @cached_property
    def as_seen(self) -> Bool:
        """[n] what moved where it was seen, as `Obstacles` has it."""
        return self.source.as_seen

    @cached_property
    def begins(self) -> int:
        """When the forecast begins, ns, as `Obstacles` has it."""
        return self.source.begins

    def valid_at(self, stamps: NDArray[np.integer] | int) -> Bool:
        """True where an obstacle [n] counts at a time (ns); times [T, 1] give [T, n]."""
        return np.asarray((self.source.valid_from <= stamps) & (stamps <= self.source.valid_to))

    @cached_property
    def goes_on(self) -> Bool:
        """[n] where no later layer takes over: none of its kind begins when it ends, or later, and ends later.

        What was seen to move is taken over by any forecast of what moves.
        """
        found = np.ones(len(self), np.bool_)
        for kind in (ObstacleKind.MOVING, ObstacleKind.UNKNOWN):
            rows = self.kinds == kind
            found[rows] = ~_taken_over(self.source.valid_from[rows], self.source.valid_to[rows])
        last = self.last_valid(ObstacleKind.MOVING)
        if last is not None:
            found[self.as_seen] = last < self.source.stamp + SAME_LAYER_NS
        return found

    def last_valid(self, kind: ObstacleKind) -> int | None:
        """Last time (ns) that obstacles of a kind speak of; None where there are none."""
        ends = self.source.valid_to[self.kinds == kind]
        return int(ends.max()) if len(ends) else None

    @cached_property
    def told_until(self) -> int:
        """Last time (ns) of which the forecasts of every kind speak; that of the evidence where nothing is forecast."""
        forecast = ~self.as_seen
        ends = [self.source.valid_to[forecast & (self.kinds == kind)] for kind in ObstacleKind]
        return min((int(end.max()) for end in ends if len(end)), default=self.source.stamp)

    def counting_at(self, stamps: NDArray[np.int64]) -> Bool:
        """True [T, n] for obstacles that count at times [T] (ns): those valid then, and what was seen if no motion is
        forecast. A forecast begins when it is expected to be read: before that those count that it begins with.

        Raises `ArmError` for times that the obstacles say nothing of: later ones, and those of another clock.
        """
        source, until = self.source, self.told_until
        if len(self) and len(stamps) and not source.stamp - _EARLY_NS <= stamps.min() <= stamps.max() <= until:
            first_s, last_s = ((int(stamp) - source.stamp) * 1e-9 for stamp in (stamps.min(), stamps.max()))
            raise ArmError(
                f"obstacles: expected times by the clock of their stamps, up to {(until - source.stamp) * 1e-9:.3g} s "
                f"after their evidence, found {first_s:.3g} to {last_s:.3g} s after it; what is then nobody has "
                "forecast: look no farther, or take newer obstacles"
            )
        valid = self.valid_at(np.maximum(stamps, self.begins)[:, None])
        moving = self.kinds == ObstacleKind.MOVING
        return valid | self.as_seen if (self.as_seen == moving).all() else valid

    def inside(self, lower: Float64, upper: Float64) -> Bool:
        """True [n] for obstacles that lie wholly inside a box given by its corners [3] (m)."""
        reach = self._reach
        begins, ends = self.centers - reach + FLUSH_M, self.centers + reach - FLUSH_M
        return np.asarray(((begins >= lower) & (ends <= upper)).all(axis=1))

    def reaching_into(self, lower: Float64, upper: Float64) -> Bool:
        """True [n] for obstacles whose bounding boxes share space with a box given by its corners [3] (m)."""
        reach = self._reach
        return np.asarray(((self.centers + reach > lower) & (self.centers - reach < upper)).all(axis=1))

    @property
    def _reach(self) -> Float64:
        """[n, 3] half extents of the bounding boxes along the axes of `base_link`, m."""
        turned = np.einsum("nij,nj->ni", np.abs(self.rotations), self.half)
        return np.where(self.is_sphere[:, None], self.half, turned)


def _refuse_wrong(obstacles: Obstacles) -> None:
    count = len(obstacles.ids)
    for name, values, width in (
        ("positions", obstacles.positions, 3),
        ("quats", obstacles.quats, 4),
        ("sizes", obstacles.sizes, 3),
        ("velocities", obstacles.velocities, 3),
    ):
        if np.shape(values) != (count, width):
            raise ArmError(
                f"obstacles: expected {count} rows of {width} {name}, found {_shape(values)}; check the forecast"
            )
        if not _are_tame(values):
            wild = ~(np.abs(values) <= _FARTHEST)
            raise ArmError(
                f"obstacles: expected {count} rows of finite {name} of at most {_FARTHEST:g}, found {int(wild.sum())} "
                "values not finite or larger; check the forecast"
            )
    for name, column in (
        ("kinds", obstacles.kinds),
        ("shapes", obstacles.shapes),
        ("valid_from", obstacles.valid_from),
        ("valid_to", obstacles.valid_to),
        ("bounds", obstacles.bounds),
        ("experts", obstacles.ids if obstacles.experts is None else obstacles.experts),
    ):
        if np.shape(column) != (count,):
            raise ArmError(
                f"obstacles: expected {count} {name}, one per id, found {_shape(column)}; check the forecast"
            )
    _refuse_untimed(obstacles)
    for name, told in (("reach_speeds", obstacles.reach_speeds), ("reach_delays", obstacles.reach_delays)):
        if told is not None and (np.shape(told) != (count,) or not _are_tame(told)):
            raise ArmError(
                f"obstacles: expected {count} finite {name} of at most {_FARTHEST:g}, found {_shape(told)}, of which "
                f"{int((~(np.abs(told) <= _FARTHEST)).sum())} are not finite or larger; check the forecast"
            )
    if obstacles.reach_speeds is not None and (obstacles.reach_speeds < 0).any():
        raise ArmError(
            "obstacles: expected reach_speeds in m/s of zero or more, found a negative one; check the forecast"
        )
    if (obstacles.sizes < 0).any():
        raise ArmError("obstacles: expected sizes in metres of zero or more, found a negative one; check the forecast")
    spheres = obstacles.sizes[obstacles.shapes == ObstacleShape.SPHERE]
    uneven = (spheres != spheres[:, :1]).any(axis=1)
    if uneven.any():
        raise ArmError(
            f"obstacles: expected a sphere's diameter three times, found sizes {spheres[uneven.argmax()].tolist()}; "
            "give a box where it is longer one way"
        )
    turns_sq = np.einsum("ni,ni->n", obstacles.quats, obstacles.quats)
    if ((turns_sq < 1e-12) & (obstacles.shapes == ObstacleShape.BOX)).any():
        raise ArmError("obstacles: expected unit quaternions for boxes, found one of length zero; check the forecast")
    if not (_are_among(ObstacleShape, obstacles.shapes) and _are_among(ObstacleKind, obstacles.kinds)):
        raise ArmError("obstacles: expected known shapes and kinds, found others; check the versions of the messages")


def _taken_over(begins: NDArray[np.int64], ends: NDArray[np.int64]) -> Bool:
    """[n] whether some of these intervals (ns) begins no sooner than one ends, and ends later."""
    order = np.argsort(begins)
    latest = np.maximum.accumulate(ends[order][::-1])[::-1]  # of those that begin no sooner
    following = np.searchsorted(begins[order], ends - SAME_LAYER_NS)
    return np.append(latest, np.iinfo(np.int64).min)[following] >= ends + SAME_LAYER_NS


def _are_tame(values: Float64) -> bool:
    """Whether all are numbers within `_FARTHEST`: the extremes of values some of which are none are none either."""
    return bool(values.min(initial=0.0) >= -_FARTHEST and values.max(initial=0.0) <= _FARTHEST)


def _are_among(known: Iterable[int], values: NDArray[np.integer]) -> bool:
    return bool(np.logical_or.reduce([values == value for value in known]).all())


def _shape(values: NDArray[np.generic]) -> str:
    return "x".join(map(str, np.shape(values))) or "one value"


def _refuse_untimed(obstacles: Obstacles) -> None:
    """What is valid at no time, or has no times: it would count for nothing, or as seen long ago."""
    for name, times in (("valid_from", obstacles.valid_from), ("valid_to", obstacles.valid_to)):
        check_stamps(f"obstacles: {name}", times)
    unset = (obstacles.valid_to == 0) & (obstacles.stamp > 0)
    never = (obstacles.valid_to < obstacles.valid_from) | unset
    if never.any():
        raise ArmError(
            "obstacles: expected each to be valid from valid_from to valid_to, found "
            f"{int(never.sum())} that never are, or whose times are not set (the first has id "
            f"{obstacles.ids[never.argmax()]}); set both, by the clock of the evidence"
        )
