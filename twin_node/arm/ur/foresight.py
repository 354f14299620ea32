"""Where the arm will be, from what the controller says: as if it ran at its full programmed speed."""

from __future__ import annotations

from twin_node.arm.path import extrapolate, gone_since
from twin_node.arm.programmed import ProgrammedVelocity
from twin_node.arm.ur.sample import UrSample
from twin_node.robot import ArmModel
from twin_node.scene import JointPath, JointSample

_LEAST_SHARE = 0.005
"""Below it the target tells nothing of the program: the driver's smallest step."""


class Foresight:
    """The controller's targets extrapolated, with the slider's share taken out."""

    def __init__(self, model: ArmModel) -> None:
        self._model = model
        self._programmed = ProgrammedVelocity(_LEAST_SHARE, model.max_velocity)

    @property
    def is_known(self) -> bool:
        """Whether the program was ever seen to run: of one that is paused, how it means to go on."""
        return self._programmed.is_known

    def ahead(self, sample: UrSample, received: int, stamp: int) -> JointPath:
        """The next 200 ms from a time on (ns) of an arm that was in the state of a checked sample when that came (ns).

        Until now it has gone on as it was told, from now on it goes as its program means to: one that is paused, or
        stopped by the safety system, means to go on when somebody lets it.
        """
        velocities = sample.target_qd
        if sample.is_playing and sample.may_move:
            velocities = self._programmed.seen(velocities, sample.speed_share, received)
        elif sample.has_ended:
            self._programmed.forget()
        else:
            velocities = self._programmed.recalled(velocities)
        told = JointSample(received, self._model.joint_names, sample.target_q, sample.target_qd)
        return extrapolate(self._model, gone_since(self._model, told, stamp), velocities, stamp)
