"""What the controller tells and what it is told: its output variables and the inputs that clients have written."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from twin_node.cell.errors import CellError
from twin_node.cell.ur_sim.rtde_types import DOUBLE_REGISTERS, INPUTS, INT_REGISTERS, OUTPUTS
from twin_node.scene import Float64

Value = float | Float64
"""A variable's value: a number, or a vector of its type's length."""

_JOINT_MODE_RUNNING = 253
"""RTDE guide, joint modes."""
_ROOM_TEMPERATURE = 25.0
"""degC: the stand-in's joints do not warm up."""


def _vector() -> Float64:
    return np.zeros(6)


class Inputs:
    """Input variables: their last values, when they came (s of the controller's clock), and who may write them."""

    def __init__(self) -> None:
        self._values: dict[str, Value] = {
            name: np.zeros(kind.count) if kind.count > 1 else 0 for name, kind in INPUTS.items()
        }
        self._written: dict[str, float] = {}
        self._owners: dict[str, object] = {}

    def claim(self, name: str, client: object) -> bool:
        """Reserve a variable for one client; False where another has it."""
        return self._owners.setdefault(name, client) is client

    def release(self, client: object, name: str | None = None) -> None:
        """Give up one variable of a client, or all of them (it has gone); their values stay."""
        gone = {held for held, owner in self._owners.items() if owner is client and name in (None, held)}
        self._owners = {held: owner for held, owner in self._owners.items() if held not in gone}

    def write(self, name: str, value: Value, clock: float) -> None:
        """Take a value that arrived at a time."""
        self._values[name] = value
        self._written[name] = clock

    def written(self, name: str) -> float:
        """When a variable last came, s; minus infinity: never."""
        return self._written.get(name, -math.inf)

    def value(self, name: str) -> Value:
        """What a variable holds."""
        return self._values[name]

    def number(self, name: str) -> float:
        """A scalar's value."""
        value = self._values[name]
        return float(value) if isinstance(value, int | float) else float(value[0])

    def integer(self, register: int) -> int:
        """An integer register's value."""
        return int(self.number(f"input_int_register_{register}"))

    def double(self, register: int) -> float:
        """A double register's value; raises `CellError` where that is no finite number."""
        name = f"input_double_register_{register}"
        value = self.number(name)
        if not math.isfinite(value):
            raise CellError(f"{name}: expected a finite number, found {value:g}; correct the command")
        return value

    def vector(self, first: int) -> Float64:
        """[6] Values of six double registers from `first` on; raises as `double` does."""
        return np.array([self.double(first + offset) for offset in range(6)])


@dataclass
class Outputs:
    """Output variables that the stand-in computes; attributes are named as RTDE names them, in RTDE's units.

    What it does not compute (currents, voltages, forces, speeds of the TCP, the elbow, measured accelerations, inputs
    and outputs) is sent as zero.
    """

    tool_pose: Callable[[Float64], Float64]
    """The arm's TCP pose in `base` for an offset: computed when it is asked for, which is seldom."""
    inputs: Inputs = field(default_factory=Inputs)
    """What clients have written, whose registers are told too."""
    timestamp: float = 0.0
    """s since the controller's start."""
    target_q: Float64 = field(default_factory=_vector)
    target_qd: Float64 = field(default_factory=_vector)
    target_qdd: Float64 = field(default_factory=_vector)
    actual_q: Float64 = field(default_factory=_vector)
    actual_qd: Float64 = field(default_factory=_vector)
    tcp_offset: Float64 = field(default_factory=_vector)
    joint_mode: Float64 = field(default_factory=lambda: np.full(6, _JOINT_MODE_RUNNING))
    joint_temperatures: Float64 = field(default_factory=lambda: np.full(6, _ROOM_TEMPERATURE))
    speed_scaling: float = 1.0
    target_speed_fraction: float = 1.0
    payload: float = 0.0
    robot_mode: int = 0
    safety_mode: int = 1
    safety_status: int = 1
    runtime_state: int = 1
    robot_status_bits: int = 0
    safety_status_bits: int = 1
    actual_digital_output_bits: int = 0
    int_registers: list[int] = field(default_factory=lambda: [0] * INT_REGISTERS)
    double_registers: list[float] = field(default_factory=lambda: [0.0] * DOUBLE_REGISTERS)

    @property
    def actual_TCP_pose(self) -> Float64:
        """[6] m and rotation vector, in `base`."""
        return self.tool_pose(self.tcp_offset)

    @property
    def target_TCP_pose(self) -> Float64:
        """The same: the stand-in's joints follow their targets closely."""
        return self.actual_TCP_pose

    def write_doubles(self, values: Float64) -> None:
        """Put values into the first double registers."""
        self.double_registers[: len(values)] = [float(value) for value in values]


def output_reader(name: str) -> Callable[[Outputs], Value]:
    """What reads an output variable; raises `KeyError` for a name that is no output."""
    kind = OUTPUTS[name]
    if name in INPUTS:
        return lambda outputs: outputs.inputs.value(name)
    prefix, _, number = name.rpartition("_")
    if prefix == "output_int_register":
        return lambda outputs: outputs.int_registers[int(number)]
    if prefix == "output_double_register":
        return lambda outputs: outputs.double_registers[int(number)]
    zero: Value = 0 if kind.count == 1 else np.zeros(kind.count)
    return partial(_attribute, name=name, otherwise=zero)


def _attribute(outputs: Outputs, name: str, otherwise: Value) -> Value:
    value: Value = getattr(outputs, name, otherwise)
    return value
