"""The program that the stand-in has of its own: what an integrator's URScript does beside the twin."""

from __future__ import annotations

from twin_node.cell.ur_sim.controller import Controller
from twin_node.cell.ur_sim.motions import FollowCycle, MoveJ
from twin_node.cell.ur_sim.watchdogs import WatchdogAction

_APPROACH_SPEED = 0.5
"""rad/s of the first move to the cycle's start: half of moveJ's default."""
_APPROACH_ACCELERATION = 1.4
"""rad/s^2: moveJ's default."""


class OwnProgram:
    """Waits for the first heartbeat, sets the watchdog, moves to the cycle's start, then repeats the cycle for ever."""

    name = "/programs/twin_cell.urp"

    def __init__(self) -> None:
        self._approach: MoveJ | None = None

    def tick(self, controller: Controller) -> None:
        """One period."""
        watchdog = controller.parameters.watchdog
        is_watched = watchdog.min_frequency_hz > 0 and watchdog.action is not WatchdogAction.IGNORE
        if self._approach is None and is_watched and controller.inputs.number(watchdog.variable) == 0:
            return
        if self._approach is None:
            controller.watchdogs.set(watchdog, controller.clock)
            start = controller.cycle.at(0)
            self._approach = MoveJ(controller.target.q, start, _APPROACH_SPEED, _APPROACH_ACCELERATION)
            controller.motion = self._approach
        elif self._approach is controller.motion and self._approach.is_done:
            controller.motion = FollowCycle(controller.cycle)
