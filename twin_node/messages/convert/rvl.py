"""RVL, by which compressed_depth_image_transport may compress depth of 16 bits.

Source: A. Wilson, Fast Lossless Depth Image Compression, ISS 2017; `rvl_codec.cpp` of compressed_depth_image_transport.
Numbers are written three bits at a time, the lowest first, each with a bit that says whether more follow: nibbles,
eight to a little-endian word, the first in its highest bits. In turn they say how many pixels are 0, how many are not,
and of each of those by how much it differs from the one before that was not 0.
"""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from twin_node.scene import UInt8

SIZES = struct.Struct("<II")
"""Before the words: columns and rows."""
MOST_NIBBLES = 11
"""Of a number of 32 bits."""
MOST_PIXELS = 1 << 26
"""Of any depth camera; what damaged bytes say must not take all memory."""


def decode_rvl(data: UInt8) -> NDArray[np.uint16]:
    """The image [H, W] in bytes of RVL, sizes first. Raises `ValueError` where they are none."""
    if len(data) < SIZES.size:
        raise ValueError(f"{len(data)} bytes are too few")
    width, height = SIZES.unpack(bytes(data[: SIZES.size]))
    pixels = width * height
    if not 0 < pixels <= MOST_PIXELS:
        raise ValueError(f"an image of {width}x{height} pixels")
    numbers = _numbers(data[SIZES.size :])
    is_step, is_measured = np.zeros(len(numbers), bool), np.zeros(pixels, bool)
    place, read, told = 0, 0, numbers.tolist()
    while place < pixels:
        if read + 2 > len(told):
            raise ValueError("the data end within the image")
        place, some, read = place + told[read], told[read + 1], read + 2
        if place + some > pixels or read + some > len(told):
            raise ValueError("the data lead beyond the image")
        is_measured[place : place + some] = is_step[read : read + some] = True
        place, read = place + some, read + some
    steps = numbers[is_step]
    image = np.zeros(pixels, np.uint16)
    image[is_measured] = np.cumsum((steps >> 1) ^ -(steps & 1)).astype(np.uint16)
    return image.reshape(height, width)


def _numbers(data: UInt8) -> NDArray[np.int64]:
    """All numbers in the words; of what is left over at the end, as many as there are."""
    words = np.frombuffer(bytes(data[: len(data) // 4 * 4]), "<u4")
    nibbles = (words[:, None] >> np.arange(28, -1, -4, dtype=np.uint32) & 0xF).reshape(-1).astype(np.int64)
    ends = np.flatnonzero(nibbles < 8)
    if not len(ends):
        return np.zeros(0, np.int64)
    starts = np.concatenate([[0], ends[:-1] + 1])
    nibbles = nibbles[: ends[-1] + 1]
    digit = np.arange(len(nibbles)) - np.repeat(starts, ends - starts + 1)
    if digit.max() >= MOST_NIBBLES:
        raise ValueError("a number of more than 32 bits")
    return np.asarray(np.add.reduceat((nibbles & 7) << 3 * digit, starts), np.int64)
