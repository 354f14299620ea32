"""Images through messages and back; depth never lets anything through but finite metres."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from twin_node.messages import Message, MessageError, deserialize, header, message_type, serialize
from twin_node.messages.convert import (
    compressed_depth_image,
    compressed_image,
    depth_from_message,
    depth_image,
    raw_image,
    rgb_from_message,
)

STAMP = 1_700_000_000_123_456_789


def sent(message: Message) -> Message:
    return deserialize(bytes(serialize(message)), message.__msgtype__)


def gradient() -> np.ndarray:
    y, x = np.mgrid[0:48, 0:64]
    return np.stack([x * 4, y * 5, 255 - x * 2], axis=-1).astype(np.uint8)


def image(encoding: str, data: np.ndarray, **fields: Any) -> Message:
    height, width = data.shape[:2]
    rows = np.ascontiguousarray(data).view(np.uint8).reshape(height, -1)
    base = raw_image("cam", STAMP, np.zeros((height, width, 3), dtype=np.uint8))
    return replace(base, **{"encoding": encoding, "step": rows.shape[1], "data": rows.reshape(-1), **fields})


def claiming(side: int) -> np.ndarray:
    """A JPEG whose head says that it is `side` pixels wide and high, as one flipped bit makes of a sound one."""
    data = compressed_image("cam", STAMP, gradient()).data.tobytes()
    frame = data.index(b"\xff\xc0") + 5
    return np.frombuffer(data[:frame] + 2 * side.to_bytes(2, "big") + data[frame + 4 :], dtype=np.uint8)


def test_raw_image_is_exact_and_named_after_its_camera() -> None:
    message = sent(raw_image("front", STAMP, gradient()))
    assert message.header.frame_id == "front_optical_frame"
    assert message.header.stamp.nanosec == 123_456_789
    np.testing.assert_array_equal(rgb_from_message(message), gradient())


def test_jpeg_keeps_colours_in_their_channels() -> None:
    decoded = rgb_from_message(sent(compressed_image("front", STAMP, gradient())))
    assert np.abs(decoded.astype(int) - gradient()).mean() < 2


def upright(jpeg: bytes) -> np.ndarray:
    """A JPEG with a note (EXIF) that its camera was turned by 90 degrees."""
    tiff = b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0"  # one entry: orientation 6
    note = b"Exif\0\0" + tiff
    return np.frombuffer(jpeg[:2] + b"\xff\xe1" + (len(note) + 2).to_bytes(2, "big") + note + jpeg[2:], np.uint8)


def test_a_jpeg_stays_as_its_sensor_saw_it_whatever_its_exif_says() -> None:
    """It is the sensor's pixels that are calibrated."""
    message = compressed_image("cam", STAMP, gradient())
    turned = upright(message.data.tobytes())
    assert cv2.imdecode(turned, cv2.IMREAD_COLOR).shape == (64, 48, 3)
    assert rgb_from_message(replace(message, data=turned)).shape == (48, 64, 3)


@pytest.mark.parametrize(
    ("encoding", "conversion"),
    [
        ("bgr8", cv2.COLOR_RGB2BGR),
        ("8UC3", cv2.COLOR_RGB2BGR),
        ("rgba8", cv2.COLOR_RGB2RGBA),
        ("bgra8", cv2.COLOR_RGB2BGRA),
        ("8UC4", cv2.COLOR_RGB2BGRA),
    ],
)
def test_other_colour_orders(encoding: str, conversion: int) -> None:
    message = image(encoding, cv2.cvtColor(gradient(), conversion))
    np.testing.assert_array_equal(rgb_from_message(sent(message)), gradient())


def test_grey_is_repeated_and_row_padding_dropped() -> None:
    grey = gradient()[..., 0]
    padded = np.pad(grey, ((0, 0), (0, 8)), constant_values=99)
    message = replace(image("mono8", padded), width=grey.shape[1])
    np.testing.assert_array_equal(rgb_from_message(sent(message)), np.repeat(grey[..., None], 3, axis=-1))


@pytest.mark.parametrize(
    ("pattern", "red_at"), [("rggb", (0, 0)), ("bggr", (1, 1)), ("gbrg", (1, 0)), ("grbg", (0, 1))]
)
def test_bayer_patterns_put_red_into_the_first_channel(pattern: str, red_at: tuple[int, int]) -> None:
    mosaic = np.zeros((16, 16), dtype=np.uint8)
    mosaic[red_at[0] :: 2, red_at[1] :: 2] = 200
    decoded = rgb_from_message(image(f"bayer_{pattern}8", mosaic))[4:-4, 4:-4]
    assert decoded[..., 0].min() == 200
    assert decoded[..., 1:].max() == 0


@pytest.mark.parametrize("depth", [8, 16])
@pytest.mark.parametrize(("pattern", "red_at"), [("rggb", (0, 0)), ("gbrg", (1, 0))])
def test_a_bayer_mosaic_that_was_compressed_has_its_colours(pattern: str, red_at: tuple[int, int], depth: int) -> None:
    """As compressed_image_transport sends it: a grey image, which was taken for one."""
    mosaic = np.zeros((32, 32), np.uint8 if depth == 8 else np.uint16)
    mosaic[red_at[0] :: 2, red_at[1] :: 2] = 200 if depth == 8 else 200 * 257
    png = cv2.imencode(".png", mosaic)[1].reshape(-1)
    base = compressed_image("cam", STAMP, gradient())
    message = replace(base, format=f"bayer_{pattern}{depth}; png compressed ", data=png)
    decoded = rgb_from_message(message)[4:-4, 4:-4]
    np.testing.assert_array_equal(decoded.reshape(-1, 3).mean(axis=0), [200, 0, 0])
    colour = replace(base, format=f"bayer_{pattern}{depth}; jpeg compressed bgr8")
    np.testing.assert_array_equal(rgb_from_message(colour), rgb_from_message(base))


def test_yuv422_in_both_orders() -> None:
    uyvy = np.tile(np.array([90, 81, 240, 81], dtype=np.uint8), (4, 2)).reshape(4, 4, 2)  # BT.601 red
    yuyv = uyvy[..., ::-1]
    for encoding, data in (("yuv422", uyvy), ("uyvy", uyvy), ("yuv422_yuy2", yuyv), ("yuyv", yuyv)):
        decoded = rgb_from_message(image(encoding, data))
        assert decoded.shape == (4, 4, 3)
        assert np.abs(decoded.astype(int) - [254, 0, 0]).max() <= 2


def planes(encoding: str, **fields: Any) -> Message:
    """Red of BT.601 in 4x6 pixels, rows padded by two bytes."""
    rows = np.full((6, 8), 81, np.uint8)
    rows[4:, :6:2], rows[4:, 1:6:2] = (90, 240) if encoding == "nv12" else (240, 90)
    rows[:, 6:] = 17
    return image(encoding, rows, **{"height": 4, "width": 6, **fields})


@pytest.mark.parametrize("encoding", ["nv12", "nv21"])
def test_colours_in_a_plane_below_the_rows(encoding: str) -> None:
    """In sensor_msgs since 2024; `rviz2` shows them. They were refused."""
    decoded = rgb_from_message(sent(planes(encoding)))
    assert decoded.shape == (4, 6, 3)
    assert np.abs(decoded.astype(int) - [254, 0, 0]).max() <= 2


def cut(message: Message) -> Message:
    """The upper part of a JPEG, and its end marker."""
    return replace(message, data=np.append(message.data[: len(message.data) * 3 // 4], message.data[-2:]))


@pytest.mark.parametrize(
    ("message", "words"),
    [
        (planes("nv12", height=6, width=8), "needs rows of at least 8 bytes, found a step of 8 and 48 bytes"),
        (planes("nv21", width=5), "one colour for 2x2 pixels, found an image of 5x4"),
        (image("32FC1", np.zeros((4, 4), dtype=np.float32)), "image encoding '32FC1'"),
        (replace(raw_image("cam", STAMP, gradient()), step=10), "damaged"),
        (replace(raw_image("cam", STAMP, gradient()), data=np.zeros(5, dtype=np.uint8)), "damaged"),
        (replace(compressed_image("cam", STAMP, gradient()), data=np.arange(50, dtype=np.uint8)), "cannot be decoded"),
        (replace(compressed_image("cam", STAMP, gradient()), data=np.zeros(0, dtype=np.uint8)), "0 bytes"),
        (replace(compressed_image("cam", STAMP, gradient()), data=claiming(65_500)), "cannot be decoded"),
        (cut(compressed_image("cam", STAMP, gradient())), "expected a whole image, found a JPEG whose"),
        (image("yuv422", np.zeros((4, 5, 2), dtype=np.uint8)), "in pairs, found rows of 5"),
        (image("yuv422_yuy2", np.zeros((4, 5, 2), dtype=np.uint8)), "in pairs, found rows of 5"),
    ],
)
def test_images_that_cannot_be_are_refused_in_one_line(message: Message, words: str) -> None:
    with pytest.raises(MessageError, match=words) as caught:
        rgb_from_message(message)
    assert "cam_optical_frame" in str(caught.value)
    assert "\n" not in str(caught.value)


DEPTHS = hnp.arrays(np.float32, (6, 8), elements=st.floats(width=32))


def known(depth: np.ndarray) -> np.ndarray:
    return np.where(np.isfinite(depth) & (depth > 0), depth, 0)


@given(DEPTHS)
def test_depth_in_metres_is_exact_where_known_and_zero_elsewhere(depth: np.ndarray) -> None:
    message = sent(depth_image("cam", STAMP, depth))
    np.testing.assert_array_equal(depth_from_message(message), known(depth))


@given(DEPTHS)
def test_float_depth_of_foreign_drivers_never_passes_what_is_not_finite(depth: np.ndarray) -> None:
    message = sent(image("32FC1", depth))
    np.testing.assert_array_equal(depth_from_message(message), known(depth))


@given(hnp.arrays(np.float32, (6, 8), elements=st.floats(0, 100, width=32)))
def test_depth_in_millimetres_is_rounded_and_never_wraps(depth: np.ndarray) -> None:
    millimetres = np.rint(depth * np.float32(1000))
    expected = np.where(millimetres <= 65535, millimetres, 0) / np.float32(1000)
    for message in (depth_image("cam", STAMP, depth, "16UC1"), compressed_depth_image("cam", STAMP, depth)):
        np.testing.assert_array_equal(depth_from_message(sent(message)), expected.astype(np.float32))


def test_depth_of_nan_alone_is_unknown_throughout() -> None:
    """A stereo camera whose lens is covered, or that has just begun, is not at fault; drivers of 16UC1 send zeros."""
    assert not depth_from_message(image("32FC1", np.full((4, 4), np.nan, dtype=np.float32))).any()


def test_depth_in_tiff_is_that_of_the_image() -> None:
    """compressed_image_transport's only form for 32FC1."""
    depth = np.array([[np.nan, 1.25], [0.5, np.inf]], np.float32)
    for values, metres in ((depth, known(depth)), (np.array([[0, 1250]], np.uint16), [[0, 1.25]])):
        tiff = cv2.imencode(".tiff", values)[1]
        kind = message_type("sensor_msgs/msg/CompressedImage")
        found = depth_from_message(
            kind(header=header(STAMP, "cam"), format="32FC1; tiff compressed", data=tiff.reshape(-1))
        )
        np.testing.assert_allclose(found, metres)


def test_big_endian_and_plain_png_depth() -> None:
    millimetres = np.arange(48, dtype=np.uint16).reshape(6, 8) * 100
    expected = millimetres.astype(np.float32) / np.float32(1000)
    swapped = image("16UC1", millimetres.byteswap(), is_bigendian=1)
    np.testing.assert_array_equal(depth_from_message(swapped), expected)
    plain = replace(
        compressed_depth_image("cam", STAMP, expected),
        format="16UC1; png compressed",
        data=cv2.imencode(".png", millimetres)[1].reshape(-1),
    )
    np.testing.assert_array_equal(depth_from_message(sent(plain)), expected)


def test_quantised_inverse_depth_of_compressed_depth_transport() -> None:
    depth = np.linspace(0.5, 8, 48, dtype=np.float32).reshape(6, 8)
    a, b = 100.0 * 101.0, 1 - 100.0 * 101.0 / 10.0  # depth_quantization 100, depth_max 10 (codec.cpp of the transport)
    levels = np.rint(a / depth + b).astype(np.uint16)
    levels[0, 0] = 0
    config = np.frombuffer(np.int32(0).tobytes() + np.float32([a, b]).tobytes(), dtype=np.uint8)
    data = np.concatenate([config, cv2.imencode(".png", levels)[1].reshape(-1)])
    message = replace(compressed_depth_image("cam", STAMP, depth), format="32FC1; compressedDepth png", data=data)
    decoded = depth_from_message(sent(message))
    assert decoded[0, 0] == 0
    np.testing.assert_allclose(decoded.flat[1:], depth.flat[1:], atol=0.01)


@pytest.mark.parametrize(
    ("message", "words"),
    [
        (raw_image("cam", STAMP, gradient()), "depth encoding 'rgb8'"),
        (compressed_image("cam", STAMP, gradient()), "cannot be decoded"),
        (
            replace(compressed_depth_image("cam", STAMP, np.ones((4, 4), np.float32)), data=np.zeros(3, np.uint8)),
            "3 bytes",
        ),
        (
            replace(
                compressed_depth_image("cam", STAMP, np.ones((4, 4), np.float32)),
                data=cv2.imencode(".png", gradient())[1].reshape(-1),
            ),
            "one 16-bit channel",
        ),
        (
            replace(
                compressed_depth_image("cam", STAMP, np.ones((4, 4), np.float32)),
                data=np.append(np.zeros(12, np.uint8), cv2.imencode(".tiff", -np.ones((4, 4), np.float32))[1]),
            ),
            "one 16-bit channel, found float32",
        ),
    ],
)
def test_depth_that_is_none_is_refused(message: Message, words: str) -> None:
    with pytest.raises(MessageError, match=words):
        depth_from_message(message)


@pytest.mark.parametrize("form", ["16UC1; png", "16UC1; compressedDepth png", "rgb8; png compressed"])
@pytest.mark.parametrize("more", [True, False])
def test_a_png_whose_chunk_leads_beyond_its_end_is_not_begun_with(
    monkeypatch: pytest.MonkeyPatch, form: str, more: bool
) -> None:
    """One flipped bit of a length: OpenCV took seconds, and up to 4 GB, before it found that so much was not there."""
    is_depth = form.startswith("16UC1")
    pixels = gradient()[..., 0].astype(np.uint16) * 100 if is_depth else gradient()
    data = bytearray(cv2.imencode(".png", pixels)[1].tobytes())
    at = data.index(b"IDAT") - 4
    whole = np.frombuffer(bytes(12 if "compressedDepth" in form else 0) + bytes(data) + bytes(20), np.uint8)
    data[at] |= 0x40 if more else 0
    data[at + 2] += 0 if more else 0x10
    message = replace(compressed_depth_image("cam", STAMP, np.ones((4, 4), np.float32)), format=form, data=whole)
    read = depth_from_message if is_depth else rgb_from_message
    assert read(message).shape[:2] == (48, 64), "what comes behind an image is none of it"
    damaged = np.frombuffer(bytes(len(whole) - len(data) - 20) + bytes(data), np.uint8)
    monkeypatch.setattr(cv2, "imdecode", lambda *_: pytest.fail("OpenCV was asked"))
    with pytest.raises(MessageError, match="cannot be decoded as an image; the frame is damaged"):
        read(replace(message, data=damaged))


@pytest.mark.parametrize("make", [raw_image, compressed_image])
@pytest.mark.parametrize(
    "rgb",
    [
        np.zeros((4, 6, 3), np.float32),
        np.zeros((4, 6), np.uint8),
        np.zeros((4, 6, 4), np.uint8),
        np.zeros((0, 6, 3), np.uint8),
    ],
)
def test_what_is_no_rgb_image_is_refused(make: Callable[..., Message], rgb: np.ndarray) -> None:
    """It would be written, and black or torn when it is read."""
    with pytest.raises(MessageError, match=r"camera front: expected an RGB image \[H, W, 3\] of uint8, found \["):
        make("front", 0, rgb)


@pytest.mark.parametrize("make", [depth_image, compressed_depth_image])
@pytest.mark.parametrize("depth", [np.full((4, 6), 1500, np.uint16), np.ones((4, 6, 1), np.float32)])
def test_depth_in_millimetres_is_not_taken_for_metres(make: Callable[..., Message], depth: np.ndarray) -> None:
    """As a RealSense's driver gives it."""
    with pytest.raises(MessageError, match=r"camera front: expected depth \[H, W\] in metres.*divide millimetres by"):
        make("front", 0, depth)


@pytest.mark.parametrize("make", [depth_image, compressed_depth_image])
def test_depth_may_lie_in_memory_in_any_order(make: Callable[..., Message]) -> None:
    turned = np.arange(24, dtype=np.float64).reshape(6, 4).T
    np.testing.assert_array_equal(depth_from_message(make("front", 0, turned)), turned)
