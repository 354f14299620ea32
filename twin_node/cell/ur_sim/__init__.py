"""A stand-in for a UR controller: what `ur_rtde` speaks to when there is no arm, with faults on demand."""

from twin_node.cell.ur_sim.controller import Controller, ControllerParameters
from twin_node.cell.ur_sim.faults import Faults, overview
from twin_node.cell.ur_sim.process import StandInProcess, free_loopback
from twin_node.cell.ur_sim.stand_in import ADMIN_PORT, StandIn, StandInParameters, TimedFault
from twin_node.cell.ur_sim.status import Status
from twin_node.cell.ur_sim.watchdogs import Watchdog, WatchdogAction

__all__ = [
    "ADMIN_PORT",
    "Controller",
    "ControllerParameters",
    "Faults",
    "StandIn",
    "StandInParameters",
    "StandInProcess",
    "Status",
    "TimedFault",
    "Watchdog",
    "WatchdogAction",
    "free_loopback",
    "overview",
]
