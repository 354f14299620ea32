"""RTDE packages: whole from any pieces, right to the byte, and refused where they are none."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin_node.cell.ur_sim.controller import Controller, ControllerParameters
from twin_node.cell.ur_sim.registers import Inputs, Outputs
from twin_node.cell.ur_sim.rtde_types import INPUTS, OUTPUTS
from twin_node.cell.ur_sim.rtde_wire import InputRecipe, Kind, OutputRecipe, Package, PackageReader, encode, names_of


@given(st.lists(st.tuples(st.sampled_from(list(Kind)), st.binary(max_size=60)), max_size=8), st.data())
def test_packages_come_whole_from_any_pieces(sent: list[tuple[Kind, bytes]], data: st.DataObject) -> None:
    stream = b"".join(encode(kind, payload) for kind, payload in sent)
    reader, found = PackageReader(), []
    while stream:
        size = data.draw(st.integers(1, len(stream)))
        found += reader.feed(stream[:size])
        stream = stream[size:]
    assert found == [Package(kind, payload) for kind, payload in sent]


def test_a_size_smaller_than_its_header_is_refused() -> None:
    with pytest.raises(ValueError, match="package of 2 bytes"):
        PackageReader().feed(b"\x00\x02V")


def test_names_may_end_with_a_comma() -> None:
    assert names_of(b"timestamp,actual_q,") == ("timestamp", "actual_q")


def test_a_data_package_is_laid_out_as_its_recipe() -> None:
    outputs = Outputs(lambda offset: np.arange(6) + offset)
    outputs.timestamp, outputs.actual_q = 1.5, np.arange(6) / 10
    outputs.int_registers[2] = -7
    recipe = OutputRecipe(
        ["timestamp", "actual_q", "runtime_state", "output_int_register_2", "actual_TCP_pose", "payload_cog"], 125.0
    )
    assert recipe.types == ("DOUBLE", "VECTOR6D", "UINT32", "INT32", "VECTOR6D", "VECTOR3D")
    layout = struct.Struct(">Bd6dIi6d3d")
    expected = (1, 1.5, *(np.arange(6) / 10), 1, -7, *range(6), 0, 0, 0)
    assert layout.unpack(recipe.pack(outputs)) == expected


@given(st.lists(st.sampled_from(sorted(OUTPUTS)), min_size=1, max_size=20))
def test_every_output_can_be_sent(names: list[str]) -> None:
    recipe = OutputRecipe(names, 125.0)
    assert recipe.is_complete
    size = sum(struct.calcsize(">" + OUTPUTS[name].code) for name in names)
    assert len(recipe.pack(Outputs(lambda offset: offset))) == 1 + size


def test_what_clients_have_written_can_be_read_back() -> None:
    """A monitor that looks at the heartbeat was told NOT_FOUND, and was not let start."""
    outputs = Outputs(lambda offset: offset)
    outputs.inputs.write("input_int_register_20", 41, 1.0)
    outputs.inputs.write("input_bit_register_64", True, 1.0)
    recipe = OutputRecipe(["input_int_register_20", "input_bit_register_64", "input_double_register_24"], 125.0)
    assert recipe.types == ("INT32", "BOOL", "DOUBLE")
    assert struct.Struct(">Bi?d").unpack(recipe.pack(outputs)) == (1, 41, True, 0.0)
    machine = Controller(ControllerParameters())
    assert machine.outputs.inputs is machine.inputs


def test_a_monitor_of_all_that_a_controller_tells_is_let_start() -> None:
    names = ["tool_output_mode", "script_control_line", "time_scale_source", "wrench_calc_from_currents", "io_current"]
    assert OutputRecipe(names, 125.0).types == ("UINT8", "UINT32", "INT32", "VECTOR6D", "DOUBLE")


def test_registers_alone_of_all_inputs_are_read_back() -> None:
    assert OutputRecipe(["speed_slider_mask"], 125.0).types == ("NOT_FOUND",)


def test_a_package_of_five_joints_is_short_by_one_value_per_vector() -> None:
    recipe = OutputRecipe(["timestamp", "actual_q", "target_q", "actual_qd"], 125.0)
    outputs = Outputs(lambda offset: offset)
    assert len(recipe.pack_short(outputs)) == len(recipe.pack(outputs)) - 2 * 8


def test_a_recipe_holds_as_much_as_a_package_and_no_more() -> None:
    """A longer one ended the controller with the first package that was due."""
    recipe = OutputRecipe(["target_q"] * 1365, 125.0)
    assert len(encode(Kind.DATA_PACKAGE, recipe.pack(Outputs(lambda offset: offset)))) == 65524
    with pytest.raises(ValueError, match="65572 bytes"):
        OutputRecipe(["target_q"] * 1366, 125.0)


def test_variables_that_do_not_exist_are_named() -> None:
    recipe = OutputRecipe(["timestamp", "no_such_thing"], 125.0)
    assert recipe.types == ("DOUBLE", "NOT_FOUND")
    assert not recipe.is_complete


@given(st.lists(st.sampled_from(sorted(INPUTS)), min_size=1, max_size=10), st.data())
def test_inputs_are_unpacked_as_they_were_packed(names: list[str], data: st.DataObject) -> None:
    recipe = InputRecipe(tuple(names))
    values = [data.draw(st.integers(0, 1)) for kind in recipe.kinds for _ in range(kind.count)]
    payload = struct.pack(">" + "".join(kind.code for kind in recipe.kinds), *values)
    found = np.concatenate([np.atleast_1d(value) for value in recipe.unpack(payload)])
    np.testing.assert_array_equal(found, values)
    with pytest.raises(ValueError, match="expected"):
        recipe.unpack(payload + b"\x00")


def test_a_variable_belongs_to_one_client_until_it_goes() -> None:
    inputs, one, other = Inputs(), object(), object()
    assert inputs.claim("speed_slider_mask", one)
    assert inputs.claim("speed_slider_mask", one)
    assert not inputs.claim("speed_slider_mask", other)
    inputs.release(one)
    assert inputs.claim("speed_slider_mask", other)
    assert inputs.claim("input_int_register_20", other)
    inputs.release(other, "speed_slider_mask")
    assert inputs.claim("speed_slider_mask", one)
    assert not inputs.claim("input_int_register_20", one)
