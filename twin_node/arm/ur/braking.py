"""How a servoed arm stops: along its path, within its own accelerations, and behind servoJ's look-ahead."""

from __future__ import annotations

import numpy as np

from twin_node.arm.stopping import StoppingTable
from twin_node.ranges import Range
from twin_node.robot import ArmModel

LOOKAHEAD_S = 0.1
"""servoJ's own default (URScript). Its error is taken from where the arm will be so much later at its speed (UR's
article "ServoJ command"), so it follows as a low pass of this time constant does."""
LOOKAHEADS_S = Range(0.03, 0.2)
"""What servoJ takes (URScript). A shorter one brakes sooner, and lets an arm vibrate that is sent rough angles."""
_STANDS_RAD = 0.0025
"""The arm stands where so little is left: half of `SeparationParameters.position_error_m` at 1 m."""
_SPEEDS = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6)
"""rad/s: from row to row, and up to the arm's rating, the table is read as if it were straight."""


def servo_stopping(model: ArmModel, own: StoppingTable, lookahead_s: float = LOOKAHEAD_S) -> StoppingTable:
    """The stopping table of a servoed arm; `own` is that of the arm's own stop, which counts where it is slower.

    `PathFollower` brakes at the joints' accelerations a (rad/s^2), the arm follows behind `lookahead_s` T: from a
    speed v it goes v^2 / 2a + v T (rad). After v / a what it is sent stands, and a T^2 (1 - exp(-v / aT)) is left of
    its way, which goes on falling by e in every T.
    """
    speeds = np.union1d(_SPEEDS, model.max_velocity.max())
    braking = speeds[:, None] / model.max_acceleration
    left = model.max_acceleration * lookahead_s**2 * -np.expm1(-braking / lookahead_s)
    tail = lookahead_s * np.log(np.maximum(left / _STANDS_RAD, 1.0))
    table = StoppingTable(speeds, braking + tail, speeds[:, None] * (braking / 2 + lookahead_s))
    return table.slower_of(own)
