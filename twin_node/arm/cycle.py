"""A made-up pick-and-place cycle: what an arm of which nobody tells is taken to do, and what the simulated ones do."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from twin_node.arm.errors import ArmError
from twin_node.arm.inverse import reach_down
from twin_node.arm.path import SampledPath, ahead_offsets, sample_path
from twin_node.ranges import NOT_NEGATIVE, POSITIVE, check_ranges
from twin_node.robot import ArmModel
from twin_node.scene import Float64, JointPath

_TEMPLATE_STEP_NS = 8_000_000
"""Sampling of a template, ns: 125 Hz, the slowest rate that a UR controller speaks."""
_NOMINAL_WORKSPACE = np.array([[0.3, -0.4, 0.0], [0.7, 0.4, 0.5]])
"""Where the default cycle works without a workspace: in front of the arm, m."""
_DRAWN_IN = (1.0, 0.85, 0.7, 0.55)
"""Shares of their distance from `base_link` at which pick and place are tried: far out a small arm lifts nothing."""


@dataclass(frozen=True)
class CycleParameters:
    """How the pick-and-place cycle moves."""

    speed: float = 1.05
    """Fastest joint, rad/s: URScript's default for moveJ."""
    acceleration: float = 1.4
    """Fastest joint, rad/s^2: URScript's default for moveJ."""
    dwell_s: float = 0.4
    """Time at the pick and at the place point: a gripper closes in about this time."""
    lift_m: float = 0.15
    """How far above pick and place the arm approaches and leaves."""
    tool_length_m: float = 0.0
    """Distance of the tool's tip beyond `tool0`."""


@dataclass(frozen=True)
class CyclicPath:
    """A joint path that repeats for ever; its template starts and ends at the same place."""

    template: JointPath
    """One period; stamps start at 0."""

    def __post_init__(self) -> None:
        """Raises `ArmError` for a template whose stamps (ns) do not rise from 0 on."""
        stamps = self.template.stamps
        if len(stamps) < 2 or stamps[0] != 0 or stamps[-1] <= 0:
            told = f"{stamps[:1].tolist()} to {stamps[-1:].tolist()}"
            raise ArmError(
                f"cycle: expected a template of one period whose stamps rise from 0 ns on, found stamps {told}; "
                "subtract the first stamp, and give two poses at least"
            )

    @cached_property
    def period_ns(self) -> int:
        """Length of one period, ns."""
        return int(self.template.stamps[-1])

    @cached_property
    def rests(self) -> NDArray[np.int64]:
        """[n, 2] when (ns, from the period's start) each of its rests begins and ends, as at the pick and the place."""
        stands = ~np.diff(self.template.positions, axis=0).any(axis=1)
        edges = np.diff(np.concatenate([[False], stands, [False]]).astype(np.int8))
        return np.stack([self.template.stamps[edges == 1], self.template.stamps[edges == -1]], axis=1)

    @cached_property
    def _sampled(self) -> SampledPath:
        return SampledPath(self.template)

    def at(self, stamp: int) -> Float64:
        """Joint positions [J] (rad) at a time, ns."""
        return self._sampled.at(stamp % self.period_ns)

    def ahead(self, stamp: int, speed_fraction: float = 1.0) -> JointPath:
        """The next 200 ms from a time on (ns), for an arm whose program runs at a fraction of its speed."""
        offsets = ahead_offsets()
        phases = (stamp + np.rint(offsets * speed_fraction).astype(np.int64)) % self.period_ns
        return JointPath(self.template.names, stamp + offsets, sample_path(self.template, phases))


def default_path(
    model: ArmModel, workspace: NDArray[np.floating] | None = None, parameters: CycleParameters | None = None
) -> CyclicPath:
    """A pick-and-place cycle that reaches into a workspace [2, 3] (lower and upper corner, m, `base_link`).

    Pick and place lie at a quarter and three quarters of the workspace's width as the arm sees it, near its floor,
    drawn into the arm's comfortable reach. Every move is a quintic in joint space, all joints in step, so that
    velocities and accelerations are continuous and within the limits of parameters and model. Where the arm cannot lift
    there, both are drawn in. Raises `ArmError` for a workspace that is no box, for parameters by which nothing moves,
    and for an arm that cannot put its tool down anywhere before it.
    """
    chosen = parameters or CycleParameters()
    check_ranges(chosen, ArmError, "cycle: ", speed=POSITIVE, acceleration=POSITIVE, dwell_s=NOT_NEGATIVE)
    check_ranges(chosen, ArmError, "cycle: ", lift_m=NOT_NEGATIVE, tool_length_m=NOT_NEGATIVE)
    points = _pick_and_place(model, _NOMINAL_WORKSPACE if workspace is None else np.asarray(workspace))
    stops = _first_reached(model, [share * points for share in _DRAWN_IN], chosen)
    return CyclicPath(_through(model, stops, chosen))


def _first_reached(model: ArmModel, places: Sequence[Float64], parameters: CycleParameters) -> Float64:
    """Stops [S, J] of the cycle between the first pick and place points [2, 3] that the arm reaches.

    Raises `ArmError` for the last where it reaches none.
    """
    *others, last = places
    for pick, place in others:
        try:
            return _stops(model, pick, place, parameters)
        except ArmError:
            continue  # farther in it may reach them
    pick, place = last
    return _stops(model, pick, place, parameters)


def _stops(model: ArmModel, pick: Float64, place: Float64, parameters: CycleParameters) -> Float64:
    """Joint angles [S, J] (rad) of a cycle between two points [3]; raises `ArmError` where the arm cannot reach one."""
    tip = np.array([0.0, 0.0, parameters.tool_length_m])
    lift = np.array([0.0, 0.0, parameters.lift_m])
    above_pick = reach_down(model, pick + tip + lift, _posture(model, pick))
    at_pick = reach_down(model, pick + tip, above_pick)
    above_place = reach_down(model, place + tip + lift, above_pick + _pan(model, pick, place))
    at_place = reach_down(model, place + tip, above_place)
    return np.array(
        [above_pick, at_pick, at_pick, above_pick, above_place, at_place, at_place, above_place, above_pick]
    )


def _pick_and_place(model: ArmModel, workspace: Float64) -> Float64:
    """Pick and place points [2, 3] inside a workspace, drawn into 35 to 75 % of the arm's reach."""
    is_box = workspace.shape == (2, 3) and np.isfinite(workspace).all() and np.all(workspace[1] > workspace[0])
    if not is_box:
        raise ArmError(f"workspace: expected a lower and an upper corner, found {workspace.tolist()}; check the rig")
    reach = float(np.linalg.norm(model.origins[1:, :3, 3], axis=1).sum())
    low, high = 0.35 * reach, 0.75 * reach
    center = workspace.mean(0)
    radius = float(np.clip(np.hypot(center[0], center[1]), low, high))
    heading = float(np.arctan2(center[1], center[0])) if np.hypot(center[0], center[1]) > 1e-3 else 0.0
    forward = np.array([np.cos(heading), np.sin(heading), 0.0])
    sideways = np.array([-forward[1], forward[0], 0.0])
    half_width = float((np.ptp(workspace, axis=0) / 2) @ np.abs(sideways))
    aside = float(np.clip(half_width / 2, 0.1 * reach, np.sqrt(high**2 - low**2) / 2))
    ahead = min(radius, float(np.sqrt(high**2 - aside**2)))
    height = float(np.clip(workspace[0, 2] + 0.1, 0.05, 0.3 * reach))
    points: Float64 = np.stack([ahead * forward + side * sideways for side in (aside, -aside)])
    points[:, 2] = height
    return points


def _posture(model: ArmModel, point: Float64) -> Float64:
    """Where the search for a pose begins: turned to the point, elbow up, tool down, as UR arms are usually set up."""
    start = np.zeros(model.joints)
    bent = np.array([0.0, -1.8, 1.9, -1.7, -1.57, 0.0])
    count = min(model.joints, len(bent))
    start[:count] = bent[:count]
    start[0] = np.arctan2(point[1], point[0])
    return start


def _pan(model: ArmModel, start: Float64, end: Float64) -> Float64:
    """Turn [J] of the first joint alone that brings one point's direction to another's the short way."""
    turn = np.zeros(model.joints)
    apart = np.arctan2(end[1], end[0]) - np.arctan2(start[1], start[0])
    turn[0] = apart - 2 * np.pi * np.round(apart / (2 * np.pi))
    return turn


def _through(model: ArmModel, stops: Float64, parameters: CycleParameters) -> JointPath:
    """A path through joint positions [S, J], standing for the dwell time where two stops are the same."""
    speed = np.minimum(model.max_velocity, parameters.speed)
    acceleration = np.minimum(model.max_acceleration, parameters.acceleration)
    pieces = [stops[:1]]
    for start, end in itertools.pairwise(stops):
        way = np.abs(end - start)
        # A quintic's peak velocity is 15/8 way/duration, its peak acceleration 10/sqrt(3) way/duration^2.
        duration = float(max((1.875 * way / speed).max(), np.sqrt(5.7735 * way / acceleration).max()))
        seconds = duration if duration > 0 else parameters.dwell_s
        count = max(int(np.ceil(seconds * 1e9 / _TEMPLATE_STEP_NS)), 1)
        s = np.arange(1, count + 1)[:, None] / count
        piece = start + (end - start) * s**3 * (10 - 15 * s + 6 * s**2)
        piece[-1] = end  # a sum may miss it by a bit, and a rest would begin a sample late
        pieces.append(piece)
    positions = np.concatenate(pieces)
    stamps = np.arange(len(positions), dtype=np.int64) * _TEMPLATE_STEP_NS
    return JointPath(model.joint_names, stamps, positions)
