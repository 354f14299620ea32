"""Predicts the arm: where it is and where it goes, by its trajectory or its joints while these can be believed."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from twin_node.arm.cycle import CyclicPath
from twin_node.arm.errors import ArmError
from twin_node.arm.path import STEP_NS, extrapolate, go_on, path_ahead, path_from_sample, sample_path
from twin_node.arm.programmed import ProgrammedVelocity
from twin_node.ranges import SHARE
from twin_node.robot import ArmModel, RobotError
from twin_node.scene import Float64, JointPath, JointSample

_LEAST_SHARE = 0.05
"""Below this share of its speed what is measured of an arm is not told from noise: that would count twenty times."""
_GONE_ON_NS = 1_000_000_000
"""An arm is taken to go on for so long as at the end of what its path tells, ns: late forecasts look as far."""
_STRAY_RAD = 0.05
"""So near to its path an arm is found that follows it: 3 degrees, as near as a trajectory must begin."""
_LAG_NS = 100_000_000
"""So long, ns, it may be behind its path or before it: as servoJ's look-ahead, the longest lag of those who obey."""
_JUMP_RAD = 0.1
"""Beside its way a joint is found so far from where it was, where messages are lost or stamped late."""
_FASTEST_RAD_S = 15.0
"""No joint turns faster, whatever its rating."""
_LAGS_NS = np.arange(-_LAG_NS, _LAG_NS + 1, STEP_NS)


class ArmPredictor:
    """The arm's path while it lasts, else its joints extrapolated; a given cycle where nobody has told of an arm.

    Fresh joints that are elsewhere than the path has them end it: who plans a trajectory and publishes it once does not
    know that the arm is held back.
    """

    def __init__(self, model: ArmModel, make_cycle: Callable[[], CyclicPath], lasting_s: float) -> None:
        """`make_cycle()` is asked for only if an arm is looked for before anybody has told of one.

        `lasting_s`: what was heard of the joints longer ago tells nothing of where the arm is.
        """
        self._model = model
        self._make_cycle = make_cycle
        self._cycle: CyclicPath | None = None
        self._no_cycle: str | None = None
        self._lasting_ns = round(lasting_s * 1e9)
        self._path: JointPath | None = None
        self._is_held = False
        """Whether the arm has been told to leave its path and stay where it is."""
        self._stray_rad: float | None = None
        self._joints: JointSample | None = None
        self._jump_rad = 0.0
        self._jumped: int | None = None
        """When the joints were last somewhere no arm gets to from where they had been."""
        self._measures_velocities = False
        """Whether any velocity but 0 was ever told: some drivers fill in zeros for what they do not measure."""
        self._intended = np.zeros(model.joints)
        """Velocities [J] of its program at full speed, rad/s."""
        self._programmed = ProgrammedVelocity(_LEAST_SHARE, model.max_velocity)
        self._other: JointSample | None = None
        self._refused: str | None = None

    @property
    def is_made_up(self) -> bool:
        """Whether nobody has told of an arm yet: the cycle stands for it."""
        return self._path is None and self._joints is None and self.refused is None

    @property
    def refused(self) -> str | None:
        """Why all that was told of an arm so far cannot be believed; None: some can, or nothing was told.

        Joints of others alone (of an arm whose driver calls them otherwise) tell that there is one.
        """
        if self._path is not None or self._joints is not None:
            return None
        if self._refused is None and self._other is not None:
            try:
                self._model.order(self._other.names, self._other.positions)
            except RobotError as error:
                return str(error)
        return self._refused

    def refuse(self, reason: str) -> None:
        """Something was told of an arm that cannot be believed: there is one, and nobody knows where."""
        self._refused = reason

    @property
    def stray_rad(self) -> float | None:
        """How far the joints were from where the newest path had them, rad, when that ended it; None: they were not."""
        return self._stray_rad

    def torn_rad(self, now: int) -> float | None:
        """How far (rad) the joints have jumped lately (ns): they are two arms', and nobody knows which is this one."""
        is_lately = self._jumped is not None and abs(now - self._jumped) <= self._lasting_ns
        return self._jump_rad if is_lately else None

    def take_path(self, path: JointPath) -> None:
        """A new path; raises `RobotError` or `ArmError` as `take_joints` does, and `ArmError` as `sample_path` does."""
        self._refuse_two(path.names)
        own = JointPath(self._model.joint_names, path.stamps, self._model.order(path.names, path.positions))
        sample_path(own, own.stamps[:1])
        self._path = own
        self._is_held = False
        self._stray_rad = None

    def leave_path(self) -> None:
        """The path holds no longer: from now on the joints alone tell where the arm goes."""
        self._is_held = True
        if self._path is None:
            self.refuse("the arm is to stay where it is, and nobody has told where")

    def take_joints(self, sample: JointSample, has_velocities: bool = True, share: float = 1.0) -> None:
        """A new sample, its joints in any order; without velocities, they are those since the sample before.

        So they are for as long as all that ever came were 0, which is what many put there who measure none.
        `share`: of its speed, that the arm has been told to keep to. What others than the arm (a gripper, an axis) say
        on the same topic is left out, and so is what comes after newer joints. Raises `RobotError` where a joint is
        missing, and `ArmError` for a share that is none and for joints that are named twice: they are two arms'.
        """
        if not SHARE.holds(share):
            raise ArmError(f"share: expected {SHARE}, as the arm was told, found {share:g}; divide percentages by 100")
        if not set(sample.names) & set(self._model.joint_names):
            self._other = sample
            return
        self._refuse_two(sample.names)
        before = self._joints
        positions = self._model.order(sample.names, sample.positions)
        velocities = self._model.order(sample.names, sample.velocities)
        passed_ns = 0 if before is None else sample.stamp - before.stamp
        if before is not None and abs(passed_ns) <= self._lasting_ns:
            jump_rad = float(np.abs(_turned(before.positions, positions)).max())
            if jump_rad > _JUMP_RAD + _FASTEST_RAD_S * abs(passed_ns) * 1e-9:
                self._jump_rad, self._jumped = jump_rad, max(sample.stamp, before.stamp)
        if -self._lasting_ns < passed_ns < 0:
            return
        self._measures_velocities |= has_velocities and bool(velocities.any())
        if before is not None and not (has_velocities and self._measures_velocities):
            velocities = before.velocities
            if passed_ns > 0:
                velocities = _turned(before.positions, positions) / (passed_ns * 1e-9)
        self._joints = JointSample(sample.stamp, self._model.joint_names, positions, velocities)
        self._intended = self._programmed.seen(velocities, share, sample.stamp)

    def joints(self, now: int) -> JointSample | None:
        """The newest joints, where they are fresh by now (ns)."""
        is_fresh = self._joints is not None and abs(now - self._joints.stamp) <= self._lasting_ns
        return self._joints if is_fresh else None

    def stale(self, now: int) -> str | None:
        """That the newest joints are not of now (ns), in words; None: they are, or none have come."""
        if self._joints is None or self.joints(now) is not None:
            return None
        age_ms = (now - self._joints.stamp) / 1e6
        when = f"{age_ms:.0f} ms old" if age_ms > 0 else f"{-age_ms:.0f} ms in the future"
        return f"the arm's joints are {when}"

    def ahead(self, stamp: int, now: int) -> JointPath:
        """The arm's next 200 ms from a time on (ns), as it is known by now (ns).

        Raises `ArmError`, with the reason, where nobody knows any more or no cycle can be made up, and `RobotError`
        where only another arm's joints have come.
        """
        if (torn_rad := self.torn_rad(now)) is not None:
            raise ArmError(f"the arm's joints jump by {torn_rad:.2f} rad: two arms' have the same names")
        path, joints = self._path, self._joints
        if path is not None and not self._is_held and path.stamps[0] <= now <= path.stamps[-1]:
            gone_on = go_on(self._model, path, _GONE_ON_NS)
            self._stray_rad = self._stray_rad or self._strays(gone_on, now)
            if self._stray_rad is None:
                return path_ahead(self._model, gone_on, stamp)
        if joints is not None:
            if (stale := self.stale(now)) is not None:
                raise ArmError(stale)
            here = path_from_sample(self._model, joints, stamp).positions[0]  # as fast as it is let go until then
            return extrapolate(self._model, here, self._intended, stamp)
        if path is None and self._refused is not None:
            raise ArmError(self._refused)
        if path is None and self._other is not None:
            self._model.order(self._other.names, self._other.positions)
        if path is None:
            return self._made_up().ahead(stamp)
        state = "has not begun" if path.stamps[0] > now and not self._is_held else "is over"
        raise ArmError(f"the arm's trajectory {state}, and no joints come")

    def _refuse_two(self, names: Sequence[str]) -> None:
        """Raises `ArmError` where joints of the arm are named twice: of two arms nobody knows which is this one."""
        twice = [name for name in self._model.joint_names if names.count(name) > 1]
        if twice:
            raise ArmError(
                f"joints: expected each of the arm's once, found {', '.join(twice)} more often; where two arms tell of "
                "themselves in one message, give their joints' names a prefix each"
            )

    def _made_up(self) -> CyclicPath:
        """The cycle of an arm of which nobody has told; raises `ArmError` where it has none, having tried only once."""
        if self._no_cycle is not None:
            raise ArmError(self._no_cycle)
        try:
            self._cycle = self._cycle or self._make_cycle()
        except ArmError as error:
            self._no_cycle = f"nobody tells of an arm, and none can be made up: {error}"
            raise ArmError(self._no_cycle) from error
        return self._cycle

    def _strays(self, path: JointPath, now: int) -> float | None:
        """How far (rad) the joints are from all of the path that an arm on it may be at; None: no farther than it may.

        So too where the joints are old, or much older than the path.
        """
        joints = self.joints(now)
        if joints is None or path.stamps[0] - joints.stamp > _LAG_NS:
            return None
        before_s = max(int(path.stamps[0]) - joints.stamp, 0) * 1e-9
        q = joints.positions + before_s * joints.velocities
        told = sample_path(path, max(joints.stamp, int(path.stamps[0])) + _LAGS_NS)
        away = np.abs(_turned(told, q)).max(axis=1).min()
        return float(away) if away > _STRAY_RAD else None


def _turned(start: Float64, end: Float64) -> Float64:
    """How far [..., J] joints turn from pose to pose the short way, rad: some drivers wrap angles at half a turn."""
    turn = end - start
    short: Float64 = turn - 2 * np.pi * np.round(turn / (2 * np.pi))
    return short
