"""The UR arm of the cell: where its joints are at any time, and its links as capsules."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_node.arm.cycle import default_path
from twin_node.arm.path import sample_path
from twin_node.arm.tool import with_tool
from twin_node.cell.actors import ArmSpec
from twin_node.cell.handling import Handling
from twin_node.cell.scenario import Scenario
from twin_node.cell.shapes import Placed
from twin_node.cell.solids import Solid, capsule_between
from twin_node.robot import forward_kinematics, ur_model
from twin_node.scene import Float64, JointPath, JointSample

AHEAD_NS = 500_000_000
"""How far ahead the arm tells where it means to be: beyond the forecast's 200 ms and the time to the next message."""

STEP_NS = 20_000_000
"""Between two points of the path ahead."""

DIFFERENCE_NS = 4_000_000
"""Half the step of the central difference that gives joint speeds: the path's own sampling."""

FORESEEN_NS = 100_000_000
"""An arm that is heard of goes on at its joints' speeds for so long at most after it was heard of last."""

HEARD_NS = 1_000_000_000
"""What was heard of joints is kept for so long: images are drawn late, but not that late."""

_SIDE = np.array([0.0, 1.0, 0.0])
"""Where the texture of a link's capsule faces, in the link's frame."""


class ArmInCell:
    """The arm on its default pick-and-place cycle, which it follows exactly and without regard to anybody."""

    def __init__(self, spec: ArmSpec, scenario: Scenario) -> None:
        self.model = with_tool(ur_model(spec.model), spec.carried)
        """With all that it carries at times."""
        self.cycle = default_path(self.model, np.array(spec.workspace or scenario.workspace), spec.cycle)
        capsules = with_tool(ur_model(spec.model), spec.tool).capsules
        placed = [
            capsule_between(ends[0], ends[1], float(radius), _SIDE)
            for ends, radius in zip(capsules.ends, capsules.radii, strict=True)
        ]
        self._shapes = [capsule.shape for capsule in placed]
        self._links = capsules.links
        self._T_link_capsule = np.stack([capsule.T_base_shape for capsule in placed])
        self._texture = spec.texture
        self.handling = Handling(self.model, self.cycle, spec.handled)
        """Where the part that it handles is."""
        self._start = scenario.start_ns

    def positions(self, stamps: NDArray[np.int64]) -> Float64:
        """Joint angles [T, J] at stamps [T], rad."""
        return sample_path(self.cycle.template, self._phases(stamps) % self.cycle.period_ns)

    def rests(self, stamp: int) -> int:
        """How often it has rested until a stamp to take hold of a part or let go of it, as `Handling` counts."""
        return self.handling.rests(int(self._phases(np.array([stamp]))[0]))

    def sample(self, stamp: int) -> JointSample:
        """The joints at a stamp."""
        before, now, after = self.positions(stamp + DIFFERENCE_NS * np.arange(-1, 2))
        return JointSample(stamp, self.model.joint_names, now, (after - before) / (2e-9 * DIFFERENCE_NS))

    def ahead(self, stamp: int) -> JointPath:
        """Where the arm means to be over the next `AHEAD_NS`."""
        stamps = stamp + np.arange(0, AHEAD_NS + 1, STEP_NS)
        return JointPath(self.model.joint_names, stamps, self.positions(stamps))

    def solids(self, stamp: int, owner: int) -> tuple[Solid, ...]:
        """The capsules of its links at a stamp."""
        return self.solids_at(self.positions(np.array([stamp]))[0], owner)

    def handled(self, stamp: int, owner: int) -> tuple[Solid, ...]:
        """The part that it handles, at a stamp; nothing where it handles none."""
        if not self.handling.parts:
            return ()
        return self.handling.solids(self.positions(np.array([stamp]))[0], self.rests(stamp), owner)

    def solids_at(self, q: Float64, owner: int) -> tuple[Solid, ...]:
        """The capsules of its links at joint angles [J] (rad)."""
        poses = forward_kinematics(self.model, q)
        T_base = poses[self._links] @ self._T_link_capsule
        return tuple(
            Solid(Placed(shape, T), self._texture, owner) for shape, T in zip(self._shapes, T_base, strict=True)
        )

    def _phases(self, stamps: NDArray[np.int64]) -> NDArray[np.int64]:
        """How much [T] of its program it has gone through at stamps [T], ns."""
        return stamps - self._start


class DrivenArm(ArmInCell):
    """The arm where somebody else has driven it along its cycle: it is told step by step how far it has come."""

    def __init__(self, spec: ArmSpec, scenario: Scenario) -> None:
        super().__init__(spec, scenario)
        self._stamps = [scenario.start_ns]
        self._driven = [0.0]

    def drive(self, stamp: int, phase_ns: float) -> None:
        """At a stamp (ns), later than all before, the arm has gone through so much (ns) of its program."""
        if stamp > self._stamps[-1]:
            self._stamps.append(stamp)
            self._driven.append(phase_ns)

    def sample(self, stamp: int) -> JointSample:
        """The joints at a stamp; their speeds come of what was before it, since nothing is known of what comes."""
        before, now = self.positions(stamp + DIFFERENCE_NS * np.arange(-1, 1))
        return JointSample(stamp, self.model.joint_names, now, (now - before) / (1e-9 * DIFFERENCE_NS))

    def _phases(self, stamps: NDArray[np.int64]) -> NDArray[np.int64]:
        """How much [T] of its program it has gone through at stamps [T], ns; after the newest stamp it stays."""
        since = (np.asarray(stamps) - self._stamps[0]).astype(np.float64)
        known = (np.array(self._stamps) - self._stamps[0]).astype(np.float64)
        return np.rint(np.interp(since, known, self._driven)).astype(np.int64)


class HeardArm(ArmInCell):
    """The arm where somebody else moves it, as its joints are heard of; until then it waits where its cycle begins.

    One thread may hear of the joints while another draws them.
    """

    def __init__(self, spec: ArmSpec, scenario: Scenario) -> None:
        super().__init__(spec, scenario)
        self.teller_ahead_ns = 0
        """By how much the clock of who tells of the joints is ahead of the scenario's, ns."""
        self._heard: tuple[_Heard, ...] = ()
        """By their stamps on the teller's clock, rising."""

    def hear(self, sample: JointSample) -> None:
        """Takes in joints, in the order of their stamps; those of another arm and late ones are let be.

        A clock that was set back is followed.
        """
        if not set(self.model.joint_names).issubset(sample.names):
            return
        newest = self._heard[-1] if self._heard else None
        late_ns = -1 if newest is None else newest.joints.stamp - sample.stamp
        if 0 <= late_ns <= HEARD_NS:
            return
        kept = (one for one in self._heard if 0 < sample.stamp - one.joints.stamp <= HEARD_NS)
        joints, rests = self._in_order(sample), 0 if newest is None else newest.rests
        self._heard = (*kept, _Heard(joints, rests + self.handling.is_resting(joints, rests)))

    def rests(self, stamp: int) -> int:
        """How often it has rested, as heard of by a stamp of the scenario's clock."""
        heard = self._heard
        by_then = sum(one.joints.stamp <= stamp + self.teller_ahead_ns for one in heard)
        return heard[max(by_then - 1, 0)].rests if heard else 0

    def positions(self, stamps: NDArray[np.int64]) -> Float64:
        """Joint angles [T, J] at stamps [T] of the scenario's clock, rad."""
        heard = [one.joints for one in self._heard]
        if not heard:
            return np.tile(self.cycle.at(0), (len(stamps), 1))
        asked = (np.asarray(stamps) + (self.teller_ahead_ns - heard[0].stamp)).astype(np.float64)
        known = np.array([sample.stamp - heard[0].stamp for sample in heard], np.float64)
        told = np.stack([sample.positions for sample in heard], axis=1)
        between = np.stack([np.interp(asked, known, joint) for joint in told], axis=1)
        beyond_s = 1e-9 * np.clip(asked - known[-1], 0, FORESEEN_NS)
        gone_on: Float64 = between + beyond_s[:, None] * heard[-1].velocities
        return gone_on

    def _in_order(self, sample: JointSample) -> JointSample:
        """The joints in the model's order, without others."""
        rows = [sample.names.index(name) for name in self.model.joint_names]
        return JointSample(sample.stamp, self.model.joint_names, sample.positions[rows], sample.velocities[rows])


@dataclass(frozen=True)
class _Heard:
    """What was heard of the joints at once."""

    joints: JointSample
    """In the model's order, stamped by the teller."""
    rests: int
    """How often the arm had rested by then."""
