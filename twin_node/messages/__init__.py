"""Messages: types made from `msgs/` and the ROS 2 set, CDR without copies, and stamps.

`twin_node.messages.convert` turns the records of `twin_node.scene` into messages and back.
"""

from twin_node.messages.stamps import from_duration, from_time, header, header_stamp, to_duration, to_time
from twin_node.messages.types import (
    DamagedError,
    Message,
    MessageError,
    MessageTypes,
    builtin_types,
    definition,
    deserialize,
    message_type,
    serialize,
    type_hash,
)

__all__ = [
    "DamagedError",
    "Message",
    "MessageError",
    "MessageTypes",
    "builtin_types",
    "definition",
    "deserialize",
    "from_duration",
    "from_time",
    "header",
    "header_stamp",
    "message_type",
    "serialize",
    "to_duration",
    "to_time",
    "type_hash",
]
