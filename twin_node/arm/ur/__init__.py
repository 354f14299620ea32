"""The driver of a real UR arm through `ur_rtde`: in its own process, supervised, halted by whatever is wrong."""

from twin_node.arm.ur.braking import LOOKAHEAD_S, LOOKAHEADS_S, servo_stopping
from twin_node.arm.ur.driver import UrDriver
from twin_node.arm.ur.follower import PathFollower
from twin_node.arm.ur.foresight import Foresight
from twin_node.arm.ur.link import RtdeLink, UrLink
from twin_node.arm.ur.parameters import DriverMode, UrParameters
from twin_node.arm.ur.records import Acknowledge, Decide, DriverReport, DriverState, Follow, Halt, LeavePath, Order
from twin_node.arm.ur.sample import UrSample, implausible, not_ready
from twin_node.arm.ur.supervisor import SupervisedDriver

__all__ = [
    "LOOKAHEADS_S",
    "LOOKAHEAD_S",
    "Acknowledge",
    "Decide",
    "DriverMode",
    "DriverReport",
    "DriverState",
    "Follow",
    "Foresight",
    "Halt",
    "LeavePath",
    "Order",
    "PathFollower",
    "RtdeLink",
    "SupervisedDriver",
    "UrDriver",
    "UrLink",
    "UrParameters",
    "UrSample",
    "implausible",
    "not_ready",
    "servo_stopping",
]
