"""Images as zstd_image_transport sends them, by gzip as it did and by zstd as it does."""

from __future__ import annotations

import gzip
import zlib
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from zstandard import ZstdCompressor
from zstd_images import packed

from twin_node.messages import MessageError
from twin_node.messages.convert import (
    depth_from_message,
    depth_image,
    raw_image,
    rgb_from_message,
    source_encoding,
)

RGB = np.arange(4 * 6 * 3, dtype=np.uint8).reshape(4, 6, 3)
DEPTH = np.linspace(0, 3, 24, dtype=np.float32).reshape(4, 6)
PACKERS = (gzip.compress, zlib.compress, ZstdCompressor().compress)


@pytest.mark.parametrize("pack", PACKERS)
def test_colour_and_depth_are_those_of_the_raw_image(pack: Callable[[bytes], bytes]) -> None:
    """They could not be decoded: "the frame is damaged or the format unknown"."""
    np.testing.assert_array_equal(rgb_from_message(packed(raw_image("cam", 5, RGB), pack)), RGB)
    for encoding in ("16UC1", "32FC1"):
        image = depth_image("cam", 5, DEPTH, encoding)
        assert source_encoding(packed(image, pack)) == encoding
        np.testing.assert_array_equal(depth_from_message(packed(image, pack)), depth_from_message(image))


@pytest.mark.parametrize("pack", PACKERS)
@given(data=st.data())
def test_damaged_ones_are_one_error(pack: Callable[[bytes], bytes], data: st.DataObject) -> None:
    whole = packed(raw_image("cam", 5, RGB), pack)
    cut = data.draw(st.integers(0, len(whole.data)))
    noise = data.draw(st.binary(max_size=40))
    message = replace(whole, data=np.concatenate([whole.data[:cut], np.frombuffer(noise, np.uint8)]))
    try:
        found = rgb_from_message(message)
    except MessageError as error:
        assert "cam_optical_frame" in str(error)
    else:
        assert found.shape == RGB.shape


def test_what_unpacks_to_more_than_its_head_says_costs_no_memory() -> None:
    """Ten megabytes of zeros are ten kilobytes; of a head that wants half a gigabyte nothing is unpacked."""
    for pack in PACKERS:
        image = replace(raw_image("cam", 5, RGB), data=np.zeros(10_000_000, np.uint8))
        assert rgb_from_message(packed(image, pack)).max() == 0
        with pytest.raises(MessageError, match="an image of 4 rows of 4000000000 bytes; the frame is damaged"):
            rgb_from_message(packed(image, pack, step=4_000_000_000))
