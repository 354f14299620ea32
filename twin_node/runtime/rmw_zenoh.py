"""Names and headers by which ROS 2 nodes on rmw_zenoh know each other.

Source: `docs/design.md` and `attachment_helpers.cpp` of ros2/rmw_zenoh; QoS policies as in `rmw/types.h`.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import Enum

from twin_node.runtime.names import ROOT, full_name
from twin_node.runtime.qos import Qos

ADMIN_SPACE = "@ros2_lv"
"""First part of every liveliness token."""
HUMBLE_HASH = "TypeHashNotSupported"
"""What Humble, which knows no type hashes, puts in their place."""
ATTACHMENT = struct.Struct("<qqB16s")
"""Sequence number, source time in ns, length of the identifier, identifier."""

_RELIABILITY = {True: "", False: "2"}
_DURABILITY = {True: "1", False: ""}


class EntityKind(Enum):
    """What a liveliness token stands for."""

    NODE = "NN"
    PUBLISHER = "MP"
    SUBSCRIBER = "MS"
    SERVICE = "SS"
    CLIENT = "SC"


@dataclass(frozen=True)
class NodeIdentity:
    """One node of one session."""

    session: str
    """Zenoh identifier of the session, in hex."""
    number: int
    """Counts the session's nodes."""
    name: str
    namespace: str = ROOT
    domain: int = 0


@dataclass(frozen=True)
class Endpoint:
    """A publisher, a subscriber, or a server or a client of a service, of a node."""

    kind: EntityKind
    node: NodeIdentity
    number: int
    """Counts the session's entities."""
    topic: str
    """Of a service: its name."""
    msgtype: str
    """Full ROS 2 name; of a service: its type's."""
    type_hash: str
    """RIHS01 hash, or `HUMBLE_HASH`."""
    qos: Qos


@dataclass(frozen=True)
class Attachment:
    """What goes with every sample, request and response."""

    sequence: int
    """Rises by one with every sample of a publisher and every request of a client; of a response its request's."""
    source_ns: int
    """When it was sent, by the sender's clock."""
    gid: bytes
    """[16] the identifier of the publisher, or of the client that asked."""

    def pack(self) -> bytes:
        """[33] bytes of the attachment."""
        return ATTACHMENT.pack(self.sequence, self.source_ns, len(self.gid), self.gid)


def unpack_attachment(data: bytes) -> Attachment | None:
    """The attachment in `data`; None where it is not one."""
    if len(data) != ATTACHMENT.size:
        return None
    sequence, source_ns, length, gid = ATTACHMENT.unpack(data)
    return Attachment(sequence, source_ns, gid) if length == len(gid) else None


def dds_type(msgtype: str) -> str:
    """`std_msgs/msg/String` as DDS names it: `std_msgs::msg::dds_::String_`."""
    package, kind, name = msgtype.split("/")
    return f"{package}::{kind}::dds_::{name}_"


def ros_type(dds_name: str) -> str:
    """The inverse of `dds_type`; names of another form are returned as they are."""
    parts = dds_name.split("::")
    if len(parts) != 4 or parts[2] != "dds_":
        return dds_name
    return f"{parts[0]}/{parts[1]}/{parts[3].removesuffix('_')}"


def topic_key(domain: int, topic: str, msgtype: str, type_hash: str) -> str:
    """Key expression that a topic's samples are published under."""
    return f"{domain}/{topic.strip('/')}/{dds_type(msgtype)}/{type_hash}"


def qos_text(qos: Qos) -> str:
    """QoS as tokens carry it; what equals the default profile is left empty, except for the depth."""
    return f"{_RELIABILITY[qos.reliable]}:{_DURABILITY[qos.latched]}:,{qos.depth}:,:,:,,"


def node_token(node: NodeIdentity) -> str:
    """Liveliness token of a node."""
    return f"{_prefix(node, node.number, EntityKind.NODE)}/{mangled(node.namespace)}/{node.name}"


def endpoint_token(endpoint: Endpoint) -> str:
    """Liveliness token of what a node sends, hears, serves or asks."""
    node = endpoint.node
    prefix = f"{_prefix(node, endpoint.number, endpoint.kind)}/{mangled(node.namespace)}/{node.name}"
    kind = f"{dds_type(endpoint.msgtype)}/{endpoint.type_hash}"
    return f"{prefix}/{mangled(endpoint.topic)}/{kind}/{qos_text(endpoint.qos)}"


def parse_token(token: str) -> Endpoint | None:
    """What a liveliness token says that a node sends, hears, serves or asks; None for a node's own and any other."""
    parts = token.split("/")
    if len(parts) != 13 or parts[0] != ADMIN_SPACE:
        return None
    try:
        kind = EntityKind(parts[5])
        node = NodeIdentity(parts[2], int(parts[3]), parts[8], _plain(parts[7]), int(parts[1]))
        qos = _parse_qos(parts[12])
        return Endpoint(kind, node, int(parts[4]), _plain(parts[9]), ros_type(parts[10]), parts[11], qos)
    except (ValueError, IndexError):
        return None


def node_of_token(token: str) -> str | None:
    """Full name of the node that a liveliness token announces (`/twin`); None for a token of anything else."""
    parts = token.split("/")
    is_node = len(parts) == 9 and parts[0] == ADMIN_SPACE and parts[5] == EntityKind.NODE.value
    return full_name(parts[8], _plain(parts[7])) if is_node else None


def gid_of(token: str) -> bytes:
    """[16] a publisher's identifier: XXH3-128 of its token, low half first."""
    import xxhash

    number = xxhash.xxh3_128(token.encode()).intdigest()
    return struct.pack("<QQ", number & 0xFFFF_FFFF_FFFF_FFFF, number >> 64)


def _prefix(node: NodeIdentity, entity: int, kind: EntityKind) -> str:
    return f"{ADMIN_SPACE}/{node.domain}/{node.session}/{node.number}/{entity}/{kind.value}/%"


def mangled(name: str) -> str:
    """A name as one part of a token."""
    return name.replace("/", "%")


def _plain(name: str) -> str:
    return name.replace("%", "/")


def _parse_qos(text: str) -> Qos:
    reliability, durability, history = text.split(":")[:3]
    depth = history.split(",")[1]
    return Qos(int(depth or 10), reliability != "2", durability == "1")
