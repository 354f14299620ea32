"""Keys, tokens and attachments of rmw_zenoh against published examples, and back from text."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin_node.messages import type_hash
from twin_node.runtime.qos import LATCHED, RELIABLE, SENSOR_DATA, Qos
from twin_node.runtime.rmw_zenoh import (
    Attachment,
    Endpoint,
    EntityKind,
    NodeIdentity,
    dds_type,
    endpoint_token,
    gid_of,
    node_token,
    parse_token,
    qos_text,
    ros_type,
    topic_key,
    unpack_attachment,
)

STRING_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
NAMES = st.from_regex(r"[a-z][a-z0-9_]{0,8}", fullmatch=True)


@pytest.mark.parametrize(
    ("name", "digest"),
    [
        ("std_msgs/msg/String", STRING_HASH),
        ("sensor_msgs/msg/PointCloud2", "RIHS01_9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5"),
        ("sensor_msgs/msg/Image", "RIHS01_d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47"),
    ],
)
def test_type_hashes_are_those_that_ros_2_announces(name: str, digest: str) -> None:
    assert type_hash(name) == digest


def test_the_chatter_of_rmw_zenoh_s_own_design_page() -> None:
    assert topic_key(0, "/chatter", "std_msgs/msg/String", STRING_HASH) == (
        f"0/chatter/std_msgs::msg::dds_::String_/{STRING_HASH}"
    )
    node = NodeIdentity("aac3178e146ba6f1fc6e6a4085e77f21", 0, "talker", domain=2)
    assert node_token(node) == "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/0/NN/%/%/talker"
    talker = Endpoint(EntityKind.PUBLISHER, node, 10, "/chatter", "std_msgs/msg/String", STRING_HASH, Qos(depth=7))
    assert endpoint_token(talker) == (
        "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/10/MP/%/%/talker/%chatter/std_msgs::msg::dds_::String_/"
        f"{STRING_HASH}/::,7:,:,:,,"
    )


def test_profiles_as_tokens_carry_them() -> None:
    assert qos_text(RELIABLE) == "::,10:,:,:,,"
    assert qos_text(SENSOR_DATA) == "2::,5:,:,:,,"
    assert qos_text(LATCHED) == ":1:,1:,:,:,,"


@given(
    NAMES,
    st.lists(NAMES, min_size=1, max_size=3),
    st.integers(0, 232),
    st.sampled_from([RELIABLE, SENSOR_DATA, LATCHED]),
)
def test_a_token_says_who_offers_what(node: str, topic: list[str], domain: int, qos: Qos) -> None:
    identity = NodeIdentity("ab12", 3, node, domain=domain)
    endpoint = Endpoint(
        EntityKind.SUBSCRIBER, identity, 4, "/" + "/".join(topic), "twin_msgs/msg/Obstacle", STRING_HASH, qos
    )
    assert parse_token(endpoint_token(endpoint)) == endpoint


@given(st.text(max_size=60))
def test_other_tokens_are_nobody_s(text: str) -> None:
    assert parse_token(text) is None
    assert ros_type(dds_type("a/msg/B")) == "a/msg/B"


@given(st.integers(0, 2**63 - 1), st.integers(0, 2**63 - 1))
def test_attachments_come_back(sequence: int, source_ns: int) -> None:
    packed = Attachment(sequence, source_ns, gid_of("token")).pack()
    assert len(packed) == 33
    assert packed[16] == 16
    assert unpack_attachment(packed) == Attachment(sequence, source_ns, gid_of("token"))
    assert unpack_attachment(packed[:-1]) is None
