"""JPEGs without their end, with and without what lies before it."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from twin_node.picture_files import END_OF_IMAGE, decode_picture, is_cut_jpeg, lacks_end
from twin_node.scene import UInt8

SAMPLINGS = (0x411111, 0x221111, 0x211111, 0x111111)
RGB, GREY = cv2.IMREAD_COLOR, cv2.IMREAD_GRAYSCALE


def scene(seed: int, shape: tuple[int, ...] = (90, 160, 3)) -> UInt8:
    """Some smooth picture, with noise as a sensor's."""
    rng = np.random.default_rng(seed)
    coarse = rng.integers(0, 255, (5, 7, *shape[2:])).astype(np.uint8)
    smooth = cv2.resize(coarse, shape[1::-1], interpolation=cv2.INTER_CUBIC)
    return np.clip(smooth + rng.normal(0, 3, shape), 0, 255).astype(np.uint8)


def jpeg(picture: UInt8, *options: int) -> bytes:
    return cv2.imencode(".jpg", picture, list(options))[1].tobytes()


def ways(seed: int) -> tuple[int, ...]:
    """How cameras differ: quality, how much coarser colours are, whether there are intervals that can be begun anew."""
    sampling = SAMPLINGS[seed % len(SAMPLINGS)]
    interval = (0, 8)[seed // len(SAMPLINGS) % 2]
    factor, restart = cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_RST_INTERVAL
    return cv2.IMWRITE_JPEG_QUALITY, 40 + 10 * (seed % 6), factor, sampling, restart, interval


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("shape", [(90, 160, 3), (91, 163, 3), (90, 160)])
def test_a_jpeg_is_whole_without_its_end_marker(seed: int, shape: tuple[int, ...]) -> None:
    """Some cameras never send one: OpenCV gives nothing for it."""
    data, flags = jpeg(scene(seed, shape), *ways(seed)), RGB if len(shape) == 3 else GREY
    whole = decode_picture(data, flags)
    assert whole is not None and data.endswith(END_OF_IMAGE) and not lacks_end(data)
    for sent in (data, data[:-1], data[:-2], data[:-2] + bytes(500), data + bytes(500)):
        picture = decode_picture(sent, flags)
        assert picture is not None and np.array_equal(picture, whole)
        assert not is_cut_jpeg(sent, picture)
        assert lacks_end(sent) is (END_OF_IMAGE not in sent)


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("flags", [RGB, GREY])
@pytest.mark.parametrize("end", [b"", END_OF_IMAGE])
def test_a_jpeg_that_draws_its_upper_part_is_cut(seed: int, flags: int, end: bytes) -> None:
    """Also where bytes were lost before the marker, of which OpenCV says nothing."""
    shape = (90, 160, 3) if flags == RGB else (90, 160)
    data = jpeg(scene(seed, shape), *ways(seed))
    for share in (0.4, 0.5, 0.6, 0.7):  # blocks are up to 16 pixels high, and the last row of them is not told
        sent = data[: int(share * len(data))] + end
        picture = decode_picture(sent, flags)
        assert picture is not None and (picture[-8:] == 128).all()
        assert is_cut_jpeg(sent, picture)


def test_a_whole_picture_with_a_grey_corner_is_not_decoded_again(capfd: pytest.CaptureFixture[str]) -> None:
    """libjpeg wrote of corrupt data to the terminal, of one in a few hundred images of the demo."""
    picture = scene(3)
    picture[-24:, -48:] = 128
    data = jpeg(picture)
    drawn = decode_picture(data, RGB)
    assert drawn is not None and (drawn[-8:, -8:] == 128).all() and not is_cut_jpeg(data, drawn)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("interval", [0, 4])
@pytest.mark.parametrize("value", [126, 128, 130])
def test_a_grey_picture_is_whole(value: int, interval: int) -> None:
    """All of it, or its lower half, is as grey as what is not there."""
    for rows in (0, 45):
        picture = scene(1)
        picture[rows:] = value
        data = jpeg(picture, cv2.IMWRITE_JPEG_RST_INTERVAL, interval)
        drawn = decode_picture(data, RGB)
        assert drawn is not None and not is_cut_jpeg(data, drawn)


def test_a_progressive_jpeg_is_whole_or_no_picture() -> None:
    data = jpeg(scene(2), cv2.IMWRITE_JPEG_PROGRESSIVE, 1)
    whole = decode_picture(data, RGB)
    assert whole is not None and not is_cut_jpeg(data, whole)
    assert decode_picture(data[: len(data) // 2], RGB) is None


@pytest.mark.parametrize(
    "data", [b"", b"\xff\xd8\xff", b"\xff\xd8\xff\xe1", b"\xff\xd8\xff\xda", b"\xff\xd8\xff" * 9, b"GIF"]
)
def test_what_is_no_picture_is_none(data: bytes) -> None:
    assert decode_picture(data, RGB) is None
    assert lacks_end(data) is data.startswith(b"\xff\xd8\xff")
    assert not is_cut_jpeg(data, np.full((2, 2, 3), 128, np.uint8))
