"""Where the arm will be, from what the controller says: as if it ran at its full programmed speed."""

from __future__ import annotations

from twin_node.arm.path import extrapolate
from twin_node.arm.ur.sample import UrSample
from twin_node.robot import ArmModel
from twin_node.scene import Float64, JointPath

_SLOWEST = 0.05
"""Share of the speed below which the programmed velocity can no longer be told from the target's."""


class Foresight:
    """The controller's targets extrapolated, with the slider's share taken out.

    The separation law asks how fast the program would move the arm, not how fast it moves while it is held back: an
    arm that was stopped for somebody still means to go on. So its programmed velocity is remembered while it stands.
    """

    def __init__(self, model: ArmModel) -> None:
        self._model = model
        self._programmed: Float64 | None = None

    def ahead(self, sample: UrSample, stamp: int) -> JointPath:
        """The next 200 ms from a time on (ns) of an arm in the state of a checked sample."""
        if not (sample.is_playing and sample.may_move):
            self._programmed = None
            return extrapolate(self._model, sample.target_q, sample.target_qd, stamp)
        if sample.speed_scaling > _SLOWEST:
            self._programmed = sample.target_qd / sample.speed_scaling
        programmed = sample.target_qd if self._programmed is None else self._programmed
        return extrapolate(self._model, sample.target_q, programmed, stamp)
