"""Where the arm will be, from what the controller says: as if it ran at its full programmed speed."""

from __future__ import annotations

from twin_node.arm.path import extrapolate
from twin_node.arm.programmed import ProgrammedVelocity
from twin_node.arm.ur.sample import UrSample
from twin_node.robot import ArmModel
from twin_node.scene import JointPath

_LEAST_SHARE = 0.005
"""Below it the target tells nothing of the program: the driver's smallest step."""


class Foresight:
    """The controller's targets extrapolated, with the slider's share taken out."""

    def __init__(self, model: ArmModel) -> None:
        self._model = model
        self._programmed = ProgrammedVelocity(_LEAST_SHARE)

    def ahead(self, sample: UrSample, stamp: int) -> JointPath:
        """The next 200 ms from a time on (ns) of an arm in the state of a checked sample."""
        velocities = sample.target_qd
        if sample.is_playing and sample.may_move:
            velocities = self._programmed.seen(velocities, sample.speed_share, stamp)
        else:
            self._programmed.forget()
        return extrapolate(self._model, sample.target_q, velocities, stamp)
