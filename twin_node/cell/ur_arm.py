"""The UR arm of the cell: where its joints are at any time, and its links as capsules."""

from __future__ import annotations

import numpy as np

from twin_node.cell.motion import Path
from twin_node.cell.scenario import ArmSpec, Scenario
from twin_node.cell.solids import Solid, capsule_between
from twin_node.robot.kinematics import forward_kinematics, place_capsules
from twin_node.robot.ur import ur_model
from twin_node.scene import Float64, JointPath, JointSample

AHEAD_S = 0.5
"""How far ahead the arm tells where it means to be."""

STEP_S = 0.02
"""Between two points of the path ahead."""


class ArmInCell:
    """The arm on its pick-and-place path, which it follows exactly and without regard to anybody."""

    def __init__(self, spec: ArmSpec, scenario: Scenario) -> None:
        self.model = ur_model(spec.model)
        self._texture = spec.texture
        self._start = scenario.start_ns
        a = (0.6, -1.3, 1.9, -2.2, -1.57, 0.0)
        b = (-0.7, -1.3, 1.9, -2.2, -1.57, 0.0)
        c = (0.0, -1.6, 1.6, -1.6, -1.57, 0.0)
        pts = [a, c, b, c, a]
        times = (0.0, 1.2, 2.4, 3.6, 4.8)
        self._path = Path(times, tuple(p[:3] for p in pts), tuple(p[3:] for p in pts), "spline", True)

    def positions(self, stamp: int) -> Float64:
        """Joint angles [6] at a stamp, rad."""
        return self._path._values((stamp - self._start) / 1e9)

    def sample(self, stamp: int) -> JointSample:
        """The joints at a stamp."""
        half_step = 500_000
        velocities = (self.positions(stamp + half_step) - self.positions(stamp - half_step)) / (2e-9 * half_step)
        return JointSample(stamp, self.model.joint_names, self.positions(stamp), velocities)

    def ahead(self, stamp: int) -> JointPath:
        """Where the arm means to be over the next `AHEAD_S`."""
        stamps = stamp + np.arange(0, round(AHEAD_S * 1e9) + 1, round(STEP_S * 1e9))
        return JointPath(self.model.joint_names, stamps, np.stack([self.positions(int(s)) for s in stamps]))

    def solids(self, stamp: int, owner: int) -> tuple[Solid, ...]:
        """The capsules of its links at a stamp."""
        placed = place_capsules(self.model, forward_kinematics(self.model, self.positions(stamp)))
        return tuple(
            capsule_between(start, end, float(radius), self._texture, owner)
            for (start, end), radius in zip(placed.ends, placed.radii, strict=True)
        )
