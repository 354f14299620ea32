"""Where the arm will be, from what the controller says: as if it ran at its full programmed speed."""

from __future__ import annotations

import numpy as np

from twin_node.arm.path import extrapolate
from twin_node.arm.ur.sample import UrSample
from twin_node.robot import ArmModel
from twin_node.scene import Float64, JointPath

_SLOWEST = 0.05
"""Share of the speed below which an arm that lags behind its slider seems to have a program of no speed."""
_LEAST = 0.005
"""Share of the speed below which the target tells nothing of the program: the driver's smallest step."""
_BRAKING_NS = 200_000_000
"""After the share has fallen the arm is faster than it for about so long, ns: what was known before still holds. For no
longer: the law gives another share with every decision, and a program turns meanwhile."""


class Foresight:
    """The controller's targets extrapolated, with the slider's share taken out.

    The separation law asks how fast the program would move the arm, not how fast it moves while it is held back: an
    arm that was stopped for somebody still means to go on. So its programmed velocity is remembered while it stands.
    """

    def __init__(self, model: ArmModel) -> None:
        self._model = model
        self._programmed: Float64 | None = None
        self._share = 0.0
        self._fell = 0
        self._learnt = 0

    def ahead(self, sample: UrSample, stamp: int) -> JointPath:
        """The next 200 ms from a time on (ns) of an arm in the state of a checked sample."""
        if not (sample.is_playing and sample.may_move):
            self._programmed = None
            return extrapolate(self._model, sample.target_q, sample.target_qd, stamp)
        share = sample.speed_share
        if share < self._share:
            self._fell = stamp
        self._share = share
        is_braking = self._programmed is not None and stamp - min(self._fell, self._learnt) < _BRAKING_NS
        if share > _LEAST and not is_braking:
            self._learn(sample.target_qd / share, share, stamp)
        programmed = sample.target_qd if self._programmed is None else self._programmed
        return extrapolate(self._model, sample.target_q, programmed, stamp)

    def _learn(self, seen: Float64, share: float, stamp: int) -> None:
        """Take the program's velocity [J] (rad/s) as seen at a share, unless the arm may only lag behind it."""
        known = self._programmed
        if known is None or share > _SLOWEST or np.abs(seen).max() >= np.abs(known).max() / 2:
            self._programmed, self._learnt = seen, stamp
