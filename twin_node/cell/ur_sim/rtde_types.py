"""The variables of RTDE and their types, as the Real-Time Data Exchange guide lists them for PolyScope 5."""

from __future__ import annotations

from enum import Enum


class RtdeType(Enum):
    """A type on the wire: the name by which a recipe is answered, its `struct` code and its number of elements."""

    BOOL = ("BOOL", "?", 1)
    UINT8 = ("UINT8", "B", 1)
    UINT32 = ("UINT32", "I", 1)
    UINT64 = ("UINT64", "Q", 1)
    INT32 = ("INT32", "i", 1)
    DOUBLE = ("DOUBLE", "d", 1)
    VECTOR3D = ("VECTOR3D", "3d", 3)
    VECTOR6D = ("VECTOR6D", "6d", 6)
    VECTOR6INT32 = ("VECTOR6INT32", "6i", 6)

    def __init__(self, label: str, code: str, count: int) -> None:
        self.label = label
        self.code = code
        self.count = count


def _named(kind: RtdeType, names: str) -> dict[str, RtdeType]:
    return dict.fromkeys(names.split(), kind)


INT_REGISTERS = DOUBLE_REGISTERS = 48
"""General-purpose registers in each direction."""
BIT_REGISTERS = 128
"""Single bits; the lower 64 are read and written 32 at a time only."""


def _registers(direction: str) -> dict[str, RtdeType]:
    words = _named(RtdeType.UINT32, f"{direction}_bit_registers0_to_31 {direction}_bit_registers32_to_63")
    bits = {f"{direction}_bit_register_{i}": RtdeType.BOOL for i in range(64, BIT_REGISTERS)}
    integers = {f"{direction}_int_register_{i}": RtdeType.INT32 for i in range(INT_REGISTERS)}
    doubles = {f"{direction}_double_register_{i}": RtdeType.DOUBLE for i in range(DOUBLE_REGISTERS)}
    return words | bits | integers | doubles


OUTPUTS: dict[str, RtdeType] = {
    **_named(
        RtdeType.DOUBLE,
        "timestamp actual_execution_time speed_scaling target_speed_fraction actual_momentum actual_main_voltage "
        "actual_robot_voltage actual_robot_current standard_analog_input0 standard_analog_input1 "
        "standard_analog_output0 standard_analog_output1 tool_analog_input0 tool_analog_input1 tool_output_current "
        "tool_temperature tcp_force_scalar payload io_current euromap67_24V_voltage euromap67_24V_current "
        "joint_position_deviation_ratio collision_detection_ratio target_execution_time actual_robot_energy_consumed "
        "actual_robot_braking_energy_dissipated",
    ),
    **_named(
        RtdeType.VECTOR6D,
        "target_q target_qd target_qdd target_current target_moment actual_q actual_qd actual_qdd actual_current "
        "actual_current_as_torque joint_control_output actual_TCP_pose actual_TCP_speed actual_TCP_force "
        "target_TCP_pose target_TCP_speed joint_temperatures actual_joint_voltage ft_raw_wrench payload_inertia "
        "tcp_offset wrench_calc_from_currents actual_current_window",
    ),
    **_named(RtdeType.VECTOR3D, "actual_tool_accelerometer elbow_position elbow_velocity payload_cog"),
    **_named(RtdeType.UINT64, "actual_digital_input_bits actual_digital_output_bits"),
    **_named(
        RtdeType.UINT32,
        "runtime_state robot_status_bits safety_status_bits analog_io_types tool_analog_input_types tool_mode "
        "euromap67_input_bits euromap67_output_bits script_control_line",
    ),
    **_named(RtdeType.UINT8, "tool_output_mode tool_digital_output0_mode tool_digital_output1_mode"),
    **_named(
        RtdeType.INT32,
        "robot_mode safety_mode safety_status tool_output_voltage time_scale_source encoder0_raw encoder1_raw",
    ),
    **_named(RtdeType.VECTOR6INT32, "joint_mode"),
    **_registers("output"),
    **_registers("input"),
}
"""What a client may ask to be sent, input registers as they were written last among it."""

INPUTS: dict[str, RtdeType] = {
    **_named(RtdeType.UINT32, "speed_slider_mask"),
    **_named(RtdeType.DOUBLE, "speed_slider_fraction standard_analog_output_0 standard_analog_output_1"),
    **_named(
        RtdeType.UINT8,
        "standard_digital_output_mask standard_digital_output configurable_digital_output_mask "
        "configurable_digital_output tool_digital_output_mask tool_digital_output standard_analog_output_mask "
        "standard_analog_output_type",
    ),
    **_named(RtdeType.VECTOR6D, "external_force_torque"),
    **_registers("input"),
}
"""What a client may write."""

NOT_FOUND = "NOT_FOUND"
IN_USE = "IN_USE"
"""Answers in place of a type: there is no such variable; another client writes it."""
