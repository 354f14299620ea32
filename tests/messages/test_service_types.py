"""Service types against published hashes, and their requests and responses as bytes."""

from __future__ import annotations

import pytest

from twin_node.messages import MessageError, builtin_types, message_type
from twin_node.messages.services import DEFINITIONS, defined_service, service_type

ANNOUNCED = {
    "lifecycle_msgs/srv/ChangeState": "356fe34f0475a43acf54542013af4167b0e729f77ea22ffb045c6ad8e20668e5",
    "lifecycle_msgs/srv/GetAvailableStates": "00a07d79d2207d71e81a8cbc1880e5d924cc16d4688ea8e8e06e443dc8f8aa1d",
    "lifecycle_msgs/srv/GetAvailableTransitions": "59b7ecefce0982a8a844b9f2c4f14764c1c4543cc55e72924e2aa4adad83e9bc",
    "lifecycle_msgs/srv/GetState": "800a0a5aae599782b02932de0caf563f6dc4e7e94b794eadde075ba2cbef9795",
    "rcl_interfaces/srv/DescribeParameters": "845b484d71eb0673dae682f2e3ba3c4851a65a3dcfb97bddd82c5b57e91e4cff",
    "rcl_interfaces/srv/GetParameterTypes": "da199c878688b3e530bdfe3ca8f74cb9fa0c303101e980a9e8f260e25e1c80ca",
    "rcl_interfaces/srv/GetParameters": "bf9803d5c74cf989a5de3e0c2e99444599a627c7ff75f97b8c05b01003675cbc",
    "rcl_interfaces/srv/ListParameters": "3e6062bfbb27bfb8730d4cef2558221f51a11646d78e7bb30a1e83afac3aad9d",
    "rcl_interfaces/srv/SetParameters": "56eed9a67e169f9cb6c1f987bc88f868c14a8fc9f743a263bc734c154015d7e0",
    "rcl_interfaces/srv/SetParametersAtomically": "0e192ef259c07fc3c07a13191d27002222e65e00ccec653ca05e856f79285fcd",
    "std_srvs/srv/Trigger": "eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f",
}
"""As nodes of ROS 2 announce them, by tables of hashes in several public clients of ROS 2 (2024 to 2026)."""


@pytest.mark.parametrize("name", DEFINITIONS)
def test_service_hashes_are_those_that_ros_announces(name: str) -> None:
    assert service_type(name).type_hash == f"RIHS01_{ANNOUNCED[name]}"


def test_a_service_of_ones_own_has_the_hash_that_rmw_zenoh_documents() -> None:
    """`docs/design.md` of ros2/rmw_zenoh names that of `add_two_ints`."""
    added = defined_service("example_interfaces/srv/AddTwoInts", "int64 a\nint64 b", "int64 sum")
    assert added.type_hash == "RIHS01_e118de6bf5eeb66a2491b5bda11202e7b68f198d6f67922cf30364858239c81a"


def test_a_char_is_hashed_as_rosidl_makes_idl_of_it() -> None:
    """Messages with one had a hash that no node of ROS 2 announces, and were heard by nobody."""
    types = builtin_types().extended(
        {f"a_msgs/msg/{kind}": f"{kind} one\n{kind}[4] four" for kind in ("char", "uint8")}
    )
    chars, numbers = (types.type_hash(f"a_msgs/msg/{kind}") for kind in ("char", "uint8"))
    assert chars != numbers, "the name counts, too"
    renamed = builtin_types().extended({"a_msgs/msg/char": "uint8 one\nuint8[4] four"})
    assert chars == renamed.type_hash("a_msgs/msg/char")


def test_requests_and_responses_survive_their_bytes() -> None:
    states = service_type("lifecycle_msgs/srv/GetAvailableStates")
    state = message_type("lifecycle_msgs/msg/State")(id=3, label="active")
    data = bytes(states.types.serialize(states.answer(available_states=[state])))
    [back] = states.types.deserialize(data, states.response).available_states
    assert (back.id, back.label) == (3, "active")
    assert bytes(states.types.serialize(states.ask())) == bytes.fromhex("0001000000"), "an empty struct is one byte"


def test_a_service_that_is_not_spoken_is_refused_by_name() -> None:
    with pytest.raises(MessageError, match="std_srvs/srv/SetBool: unknown service type; expected one of "):
        service_type("std_srvs/srv/SetBool")
