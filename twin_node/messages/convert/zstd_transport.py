"""Raw images as zstd_image_transport sends them: their data compressed, behind what else they say.

Source: `zstd_publisher.cpp`, `zlib_cpp.cpp` and `zstd_wrapper.cpp` of ros-perception/image_transport_plugins. Whatever
its name says, the data are gzip's up to Lyrical's first releases, and zstd's later.
"""

from __future__ import annotations

import struct
import zlib

import numpy as np
from zstandard import ZstdDecompressor, ZstdError

from twin_node.messages.types import Message, message_type

FORMAT = "zstd"
"""`format` of such a message."""
HEAD = struct.Struct("<IIBII")
"""Before the encoding's name and the data: rows, columns, whether big-endian, bytes per row, length of the name."""
LONGEST_NAME = 64
"""Of an encoding; those of ROS have 15 letters at most."""
MOST_BYTES = 1 << 29
"""Of any image; what damaged bytes say must not take all memory."""
GZIP_OR_ZLIB = 32 + zlib.MAX_WBITS


def unpack_image(message: Message) -> Message:
    """The `sensor_msgs/msg/Image` in a message of `FORMAT`. Raises `ValueError` where there is none."""
    height, width, is_bigendian, step, _ = _head(message)
    name = packed_encoding(message)
    longest = 2 * height * step  # planes of colour lie below the rows
    if not 0 < longest <= MOST_BYTES:
        raise ValueError(f"an image of {height} rows of {step} bytes")
    return message_type("sensor_msgs/msg/Image")(
        header=message.header,
        height=height,
        width=width,
        encoding=name,
        is_bigendian=is_bigendian,
        step=step,
        data=np.frombuffer(_unpacked(bytes(message.data[HEAD.size + len(name) :]), longest), np.uint8),
    )


def packed_encoding(message: Message) -> str:
    """The encoding of the image in a message of `FORMAT`. Raises `ValueError` where there is none."""
    length = _head(message)[-1]
    name = bytes(message.data[HEAD.size : HEAD.size + min(length, LONGEST_NAME)])
    if len(name) < length or not name.isascii():
        raise ValueError(f"an encoding of {length} letters, {name!r}")
    return name.decode("ascii")


def _head(message: Message) -> tuple[int, ...]:
    if len(message.data) < HEAD.size:
        raise ValueError(f"{len(message.data)} bytes, too few")
    return HEAD.unpack(bytes(message.data[: HEAD.size]))


def _unpacked(data: bytes, longest: int) -> bytes:
    try:
        if data.startswith(b"\x28\xb5\x2f\xfd"):
            return ZstdDecompressor().stream_reader(data).read(longest)
        return zlib.decompressobj(GZIP_OR_ZLIB).decompress(data, longest)
    except (ZstdError, zlib.error, MemoryError) as error:
        raise ValueError(f"data that are neither zstd nor gzip ({error})") from None
