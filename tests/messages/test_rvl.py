"""Depth in RVL, against an encoder that follows the paper number by number."""

from __future__ import annotations

import struct
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from twin_node.messages import MessageError, header, message_type
from twin_node.messages.convert import depth_from_message
from twin_node.messages.convert.rvl import decode_rvl

IMAGES = hnp.arrays(
    np.uint16,
    hnp.array_shapes(min_dims=2, max_dims=2, max_side=9),
    elements=st.sampled_from([0, 0, 1, 900, 901, 65535]),
)


def nibbles_of(number: int) -> Iterator[int]:
    while number > 7:
        yield number & 7 | 8
        number >>= 3
    yield number


def encoded(image: np.ndarray) -> np.ndarray:
    """As `RvlCodec::CompressRVL`."""
    pixels, nibbles, place, previous = [int(p) for p in image.flat], list[int](), 0, 0
    while place < len(pixels):
        for is_zero in (True, False):
            end = place
            while end < len(pixels) and (pixels[end] == 0) == is_zero:
                end += 1
            nibbles += nibbles_of(end - place)
            for pixel in () if is_zero else pixels[place:end]:
                step, previous = pixel - previous, pixel
                nibbles += nibbles_of(2 * step if step >= 0 else -2 * step - 1)
            place = end
    nibbles += [0] * (-len(nibbles) % 8)
    words = [int("".join(f"{nibble:x}" for nibble in nibbles[at : at + 8]), 16) for at in range(0, len(nibbles), 8)]
    head = struct.pack("<II", image.shape[1], image.shape[0])
    return np.frombuffer(head + struct.pack(f"<{len(words)}I", *words), np.uint8)


@given(IMAGES)
def test_images_come_back(image: np.ndarray) -> None:
    np.testing.assert_array_equal(decode_rvl(encoded(image)), image)


@given(IMAGES, st.integers(0, 60), st.integers(0, 255))
def test_damage_is_told_or_leaves_an_image(image: np.ndarray, at: int, byte: int) -> None:
    data = encoded(image).copy()
    data[8 + at % (len(data) - 8)] = byte
    for damaged in (data, data[:-4]):
        try:
            assert decode_rvl(damaged).shape == image.shape
        except ValueError as error:
            assert str(error)


@pytest.mark.parametrize("form", ["16UC1; compressedDepth rvl", "32FC1; compressedDepth rvl"])
def test_messages_of_compressed_depth_may_hold_it(form: str) -> None:
    image = np.array([[0, 1500, 1501], [0, 0, 900]], np.uint16)
    head = struct.pack("<iff", 1, 30_000.0, 5.0)

    def message(data: bytes) -> object:
        kind = message_type("sensor_msgs/msg/CompressedImage")
        return kind(header=header(5, "front"), format=form, data=np.frombuffer(data, np.uint8))

    found = depth_from_message(message(head + encoded(image).tobytes()))
    metres = image / 1000 if form.startswith("16UC1") else np.where(image, 30_000.0 / (image - 5.0), 0)
    np.testing.assert_allclose(found, metres, rtol=1e-6)
    with pytest.raises(MessageError, match=r"image of front .*: expected depth in RVL, found an image of 0x0 pixels"):
        depth_from_message(message(head + bytes(8)))
    with pytest.raises(MessageError, match=r"expected depth in RVL, found the data end within the image"):
        depth_from_message(message(head + struct.pack("<II", 2, 2)))
