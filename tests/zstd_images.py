"""Images as zstd_image_transport sends them, for tests of several rooms."""

from __future__ import annotations

import gzip
import struct
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from twin_node.messages import Message
from twin_node.messages.convert import compressed_image


def packed(image: Message, pack: Callable[[bytes], bytes] = gzip.compress, step: int | None = None) -> Message:
    """A raw image packed; `step`: bytes per row that its head claims, if not the image's own."""
    name = str(image.encoding).encode()
    head = struct.pack("<IIBII", image.height, image.width, image.is_bigendian, step or image.step, len(name))
    data = np.frombuffer(head + name + pack(image.data.tobytes()), np.uint8)
    return replace(compressed_image("cam", 5, np.zeros((2, 2, 3), np.uint8)), format="zstd", data=data)
