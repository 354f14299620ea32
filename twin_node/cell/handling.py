"""The part that an arm takes from one place to the other and back: where it is at any time."""

from __future__ import annotations

import numpy as np

from twin_node.arm.cycle import CyclicPath
from twin_node.cell.actors import Part
from twin_node.cell.shapes import Placed
from twin_node.cell.solids import Solid
from twin_node.robot import ArmModel, forward_kinematics
from twin_node.scene import Float64, JointSample

AT_PICK, AT_PLACE, HELD = range(3)
"""Where a part may be."""

ROUND = (AT_PICK, HELD, AT_PLACE, AT_PLACE, HELD, AT_PICK)
"""Where it is after so many rests, over and over: in between the arm comes once to each place with nothing to do."""

NEAR_RAD, SLOW_RAD_S = 0.01, 0.01
"""Joints so near to those of a rest, and so slow, rest there."""


class Handling:
    """A part between two rests of a cycle, the pick and the place; the arm takes it, or lets go, amid them."""

    def __init__(self, model: ArmModel, cycle: CyclicPath, parts: tuple[Part, ...]) -> None:
        """`parts`: in the frame of `tool0` while that holds them; none: nothing is handled."""
        self.parts = parts
        self._model = model
        self._period_ns = cycle.period_ns
        self._amid = cycle.rests.mean(axis=1).astype(np.int64)
        self._q = np.array([cycle.at(int(stamp)) for stamp in self._amid])
        self._T_base_tool = np.array([self._tool(q) for q in self._q])

    def rests(self, phase_ns: int) -> int:
        """How many rests are over, or half over, when so much of the program is, ns."""
        periods, phase = divmod(phase_ns, self._period_ns)
        return int(periods * len(self._amid) + np.count_nonzero(self._amid <= phase))

    def is_resting(self, joints: JointSample, rests: int) -> bool:
        """Whether joints in the model's order are at the next rest after so many, and stand."""
        apart = np.abs(joints.positions - self._q[rests % len(self._q)])
        return bool((apart < NEAR_RAD).all() and (np.abs(joints.velocities) < SLOW_RAD_S).all())

    def solids(self, q: Float64, rests: int, owner: int) -> tuple[Solid, ...]:
        """The part's solids with the joints at q [J] (rad), after so many rests."""
        place = ROUND[rests % len(ROUND)]
        T = self._tool(q) if place == HELD else self._T_base_tool[place]
        return tuple(Solid(Placed(part.shape, T @ part.T_body_part), part.texture, owner) for part in self.parts)

    def _tool(self, q: Float64) -> Float64:
        """[4, 4] pose of `tool0` with the joints at q [J] (rad)."""
        pose: Float64 = forward_kinematics(self._model, q)[-1] @ self._model.T_last_tool
        return pose
