"""What the doctor says of a graph whose ends do not meet."""

from __future__ import annotations

from twin_node.nodes.live.doctor import graph_faults
from twin_node.nodes.topics import COMPRESSED, JOINT_STATES, RAW
from twin_node.runtime.qos import RELIABLE
from twin_node.runtime.rmw_zenoh import HUMBLE_HASH, Endpoint, EntityKind, NodeIdentity


def end(kind: EntityKind, node: str, topic: str, msgtype: str, type_hash: str = "RIHS01_aa") -> Endpoint:
    return Endpoint(kind, NodeIdentity("ab", 0, node), 1, topic, msgtype, type_hash, RELIABLE)


def publisher(node: str, topic: str, msgtype: str = RAW, type_hash: str = "RIHS01_aa") -> Endpoint:
    return end(EntityKind.PUBLISHER, node, topic, msgtype, type_hash)


def subscriber(node: str, topic: str, msgtype: str = RAW, type_hash: str = "RIHS01_aa") -> Endpoint:
    return end(EntityKind.SUBSCRIBER, node, topic, msgtype, type_hash)


def test_ends_that_meet_are_no_fault_and_extras_may_be_missing() -> None:
    ends = [publisher("cameras", "/a/image_raw"), subscriber("synchronizer", "/a/image_raw")]
    assert graph_faults([*ends, subscriber("arm", JOINT_STATES, "sensor_msgs/msg/JointState")]) == []


def test_an_image_that_is_waited_for_is_named_with_the_remap_that_brings_it() -> None:
    ends = [
        subscriber("synchronizer", "/front/image_raw"),
        publisher("cameras", "/front_camera/image_raw"),
        publisher("cameras", "/front/image_raw/compressed", COMPRESSED),
        publisher("cameras", "/left/image_raw"),
        subscriber("synchronizer", "/left/image_raw"),
    ]
    assert graph_faults(ends) == [
        "/front/image_raw: synchronizer waits for it, nobody publishes it; launch with --remap "
        "/front/image_raw:=/front_camera/image_raw?"
    ]
    assert graph_faults(ends[:1]) == [
        f"/front/image_raw: synchronizer waits for it, nobody publishes it; start who publishes {RAW}"
    ]


def test_ends_that_cannot_hear_each_other_are_told_what_to_set() -> None:
    humble = publisher("driver", "/a/image_raw", type_hash=HUMBLE_HASH)
    assert "ros_distro differs" in graph_faults([humble, subscriber("synchronizer", "/a/image_raw")])[0]
    other = publisher("driver", "/a/image_raw", COMPRESSED)
    assert "their types differ" in graph_faults([other, subscriber("synchronizer", "/a/image_raw")])[0]
