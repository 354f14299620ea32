"""Images: RGB and depth arrays to Image and CompressedImage, and back."""

from __future__ import annotations

import re
import struct
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from twin_node.messages.convert.camera import optical_frame
from twin_node.messages.convert.rvl import decode_rvl
from twin_node.messages.convert.zstd_transport import FORMAT as ZSTD
from twin_node.messages.convert.zstd_transport import packed_encoding, unpack_image
from twin_node.messages.stamps import header, header_stamp
from twin_node.messages.types import DamagedError, Message, MessageError, message_type
from twin_node.picture_files import JPEG_SIGNATURE, PNG_SIGNATURE, decode_picture, is_cut_jpeg
from twin_node.scene import Float32, UInt8

JPEG_QUALITY = 95
"""OpenCV's default and compressed_image_transport's: no visible loss."""

TO_RGB = {
    "bgr8": cv2.COLOR_BGR2RGB,
    "8UC3": cv2.COLOR_BGR2RGB,
    "rgba8": cv2.COLOR_RGBA2RGB,
    "bgra8": cv2.COLOR_BGRA2RGB,
    "8UC4": cv2.COLOR_BGRA2RGB,
    "mono8": cv2.COLOR_GRAY2RGB,
    "8UC1": cv2.COLOR_GRAY2RGB,
    "bayer_rggb8": cv2.COLOR_BayerRGGB2RGB,
    "bayer_bggr8": cv2.COLOR_BayerBGGR2RGB,
    "bayer_gbrg8": cv2.COLOR_BayerGBRG2RGB,
    "bayer_grbg8": cv2.COLOR_BayerGRBG2RGB,
    "yuv422": cv2.COLOR_YUV2RGB_UYVY,
    "uyvy": cv2.COLOR_YUV2RGB_UYVY,
    "yuv422_yuy2": cv2.COLOR_YUV2RGB_YUY2,
    "yuyv": cv2.COLOR_YUV2RGB_YUY2,
}
"""OpenCV conversion of each encoding of sensor_msgs/image_encodings.hpp that has 8 bits per value, rows of one length
and is not RGB already; two have had other names since Iron."""

PLANAR = {"nv12": cv2.COLOR_YUV2RGB_NV12, "nv21": cv2.COLOR_YUV2RGB_NV21}
"""The same of those whose colours, one for four pixels, lie in a plane below the rows, which are half as many again
(`getHeightScaling`); of hardware decoders and libcamera."""

PAIRED = ("yuv422", "uyvy", "yuv422_yuy2", "yuyv")
"""Encodings in which two neighbours share their colour."""

CHANNELS = {"rgb8": 3, "bgr8": 3, "8UC3": 3, "rgba8": 4, "bgra8": 4, "8UC4": 4, **dict.fromkeys(PAIRED, 2)}
"""Bytes per pixel where there is more than one."""

MOSAIC = re.compile(r"(bayer_(?:rggb|bggr|gbrg|grbg))(?:8|16)\b")
"""What a `format` begins with that says of which image the compressed one was made."""

COMPRESSED = "sensor_msgs/msg/CompressedImage"
MM_PER_M = 1000.0
TIFF_SIGNATURES = (b"II*\0", b"MM\0*")
COMPRESSED_DEPTH_HEADER = struct.Struct("<iff")
"""ConfigHeader of compressed_depth_image_transport: compression format, depth quantisation A and B."""


def raw_image(camera: str, stamp: int, rgb: UInt8) -> Message:
    """`sensor_msgs/msg/Image` (rgb8) of an image [H, W, 3]; raises `MessageError` for any other array."""
    _check_rgb(camera, rgb)
    height, width = rgb.shape[:2]
    return _image(camera, stamp, np.ascontiguousarray(rgb).reshape(height, -1), width, "rgb8")


def compressed_image(camera: str, stamp: int, rgb: UInt8, quality: int = JPEG_QUALITY) -> Message:
    """`sensor_msgs/msg/CompressedImage` (JPEG of the given quality, 0 to 100) of an image [H, W, 3].

    Raises `MessageError` for any other array.
    """
    _check_rgb(camera, rgb)
    bgr = cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR)
    jpeg = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return _compressed(camera, stamp, "bgr8; jpeg compressed bgr8", jpeg)


def depth_image(camera: str, stamp: int, depth: Float32, encoding: Literal["16UC1", "32FC1"] = "32FC1") -> Message:
    """`sensor_msgs/msg/Image` of depth [H, W] in metres, 0 where unknown: millimetres (16UC1) or metres (32FC1).

    Raises `MessageError` for whole numbers, which are a camera's millimetres, and for an array of another shape.
    """
    _check_depth(camera, depth)
    known = np.ascontiguousarray(_known(depth))
    values: NDArray[np.generic] = _millimetres(known) if encoding == "16UC1" else known
    return _image(camera, stamp, values.view(np.uint8), depth.shape[1], encoding)


def compressed_depth_image(camera: str, stamp: int, depth: Float32) -> Message:
    """`sensor_msgs/msg/CompressedImage` of depth [H, W] in metres: PNG in mm (compressed_depth_image_transport).

    Raises `MessageError` as `depth_image` does.
    """
    _check_depth(camera, depth)
    png = cv2.imencode(".png", _millimetres(_known(depth)), [cv2.IMWRITE_PNG_COMPRESSION, 1])[1]
    config = np.frombuffer(COMPRESSED_DEPTH_HEADER.pack(0, 0.0, 0.0), dtype=np.uint8)
    return _compressed(camera, stamp, "16UC1; compressedDepth png", np.concatenate([config, png]))


def _check_rgb(camera: str, rgb: UInt8) -> None:
    if rgb.dtype != np.uint8 or rgb.ndim != 3 or rgb.shape[2] != 3 or rgb.size == 0:
        raise MessageError(
            f"camera {camera}: expected an RGB image [H, W, 3] of uint8, found {list(rgb.shape)} of {rgb.dtype}; "
            "convert it"
        )


def _check_depth(camera: str, depth: Float32) -> None:
    if not np.issubdtype(depth.dtype, np.floating) or depth.ndim != 2 or depth.size == 0:
        raise MessageError(
            f"camera {camera}: expected depth [H, W] in metres, of a floating-point type, found {list(depth.shape)} of "
            f"{depth.dtype}; divide millimetres by 1000"
        )


def rgb_from_message(message: Message) -> UInt8:
    """RGB image [H, W, 3] of an Image or a CompressedImage; grey images are repeated over the channels.

    Raises `MessageError` for an encoding that is not an 8-bit colour or grey one, and for data that cannot be decoded.
    """
    message = _plain(message)
    if message.__msgtype__ == COMPRESSED:
        return _decode_compressed_rgb(message)
    encoding = message.encoding
    if encoding in PLANAR:
        return _of_planes(message)
    if encoding != "rgb8" and encoding not in TO_RGB:
        known = ", ".join(("rgb8", *TO_RGB, *PLANAR))
        raise MessageError(f"{_name(message)}: image encoding {encoding!r}; expected {known}; convert the topic")
    channels = CHANNELS.get(encoding, 1)
    pixels = _rows(message, np.dtype(np.uint8), channels)
    if encoding == "rgb8":
        return pixels
    if encoding in PAIRED and pixels.shape[1] % 2:
        raise DamagedError(
            f"{_name(message)}: {encoding} holds its pixels in pairs, found rows of {pixels.shape[1]}; the frame is "
            "damaged"
        )
    return np.asarray(cv2.cvtColor(pixels, TO_RGB[encoding]), dtype=np.uint8)


def depth_from_message(message: Message) -> Float32:
    """Depth [H, W] in metres of a depth image; 0 where unknown: NaN, infinite and negative values never pass.

    Takes Image as 16UC1 or mono16 (mm) and 32FC1 (m), CompressedImage as PNG in mm, as TIFF in mm or m, or in the
    forms of compressedDepth (PNG or RVL) and zstd. All are 0 where nothing was measured, as with a covered lens. Raises
    `MessageError` for any other encoding and undecodable data.
    """
    message = _plain(message)
    if message.__msgtype__ == COMPRESSED:
        return _decode_compressed_depth(message)
    order = ">" if message.is_bigendian else "<"
    if message.encoding in ("16UC1", "mono16"):
        return _metres(_rows(message, np.dtype(f"{order}u2"), 1))
    if message.encoding == "32FC1":
        return _known(_rows(message, np.dtype(f"{order}f4"), 1))
    raise MessageError(
        f"{_name(message)}: depth encoding {message.encoding!r}; expected 16UC1 (mm) or 32FC1 (m); convert the topic"
    )


def _of_planes(message: Message) -> UInt8:
    if message.width % 2 or message.height % 2:
        raise DamagedError(
            f"{_name(message)}: {message.encoding} has one colour for 2x2 pixels, found an image of "
            f"{message.width}x{message.height}; the frame is damaged"
        )
    planes = _rows(message, np.dtype(np.uint8), 1, int(message.height) * 3 // 2)
    return np.asarray(cv2.cvtColor(planes, PLANAR[message.encoding]), dtype=np.uint8)


def source_encoding(message: Message) -> str:
    """Encoding of an Image, or of the one that image_transport made a CompressedImage of; empty where nothing tells.

    Raises `MessageError` for what is no image of its format.
    """
    if message.__msgtype__ != COMPRESSED:
        return str(message.encoding)
    if message.format != ZSTD:
        return str(message.format).partition(";")[0].strip()
    try:
        return packed_encoding(message)
    except ValueError as error:
        raise _not_packed(message, error) from None


def is_jpeg(message: Message) -> bool:
    """Whether an image is compressed as JPEG, which keeps 8 bits of what has more."""
    return message.__msgtype__ == COMPRESSED and bytes(message.data[: len(JPEG_SIGNATURE)]) == JPEG_SIGNATURE


def _plain(message: Message) -> Message:
    """The Image that zstd_image_transport packed; what others send as it is."""
    if message.__msgtype__ != COMPRESSED or message.format != ZSTD:
        return message
    try:
        return unpack_image(message)
    except ValueError as error:
        raise _not_packed(message, error) from None


def _not_packed(message: Message, error: ValueError) -> DamagedError:
    return DamagedError(
        f"{_name(message)}: expected an image of zstd_image_transport, found {error}; the frame is damaged"
    )


def _decode_compressed_rgb(message: Message) -> UInt8:
    """compressed_image_transport sends the mosaic of a Bayer sensor as a grey image and names its pattern."""
    pattern = MOSAIC.match(message.format)
    if pattern is not None:
        mosaic = _decode(message, message.data, cv2.IMREAD_ANYCOLOR | cv2.IMREAD_IGNORE_ORIENTATION)
        if mosaic.ndim == 2:
            return np.asarray(cv2.cvtColor(mosaic, TO_RGB[f"{pattern[1]}8"]), dtype=np.uint8)
    bgr = _decode(message, message.data, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), dtype=np.uint8)


def _decode_compressed_depth(message: Message) -> Float32:
    data = message.data
    if bytes(data[:4]) in (PNG_SIGNATURE, *TIFF_SIGNATURES):
        found = _decode_depth(message, data, np.uint16, np.float32)
        return _known(found) if found.dtype == np.float32 else _metres(found)
    if len(data) <= COMPRESSED_DEPTH_HEADER.size:
        raise DamagedError(f"{_name(message)}: {len(data)} bytes are no compressedDepth image; the frame is damaged")
    _, a, b = COMPRESSED_DEPTH_HEADER.unpack(bytes(data[: COMPRESSED_DEPTH_HEADER.size]))
    packed = data[COMPRESSED_DEPTH_HEADER.size :]
    values = _rvl(message, packed) if message.format.endswith("rvl") else _decode_depth(message, packed, np.uint16)
    if not message.format.startswith("32FC1"):
        return _metres(values)
    with np.errstate(divide="ignore"):
        depth = np.float32(a) / (values.astype(np.float32) - np.float32(b))
    return _known(np.where(values > 0, depth, np.float32(0)))


def _image(camera: str, stamp: int, rows: NDArray[np.uint8], width: int, encoding: str) -> Message:
    return message_type("sensor_msgs/msg/Image")(
        header=header(stamp, optical_frame(camera)),
        height=rows.shape[0],
        width=width,
        encoding=encoding,
        is_bigendian=0,
        step=rows.shape[1],
        data=rows.reshape(-1),
    )


def _compressed(camera: str, stamp: int, form: str, data: NDArray[np.uint8]) -> Message:
    return message_type(COMPRESSED)(header=header(stamp, optical_frame(camera)), format=form, data=data.reshape(-1))


def _known(depth: Float32) -> Float32:
    return np.where(np.isfinite(depth) & (depth > 0), depth, 0).astype(np.float32)


def _millimetres(depth: Float32) -> NDArray[np.uint16]:
    """Rounded millimetres; what does not fit into 16 bits is unknown, not wrapped."""
    rounded = np.rint(depth * MM_PER_M)
    return np.where(rounded <= np.iinfo(np.uint16).max, rounded, 0).astype(np.uint16)


def _metres(millimetres: NDArray[np.generic]) -> Float32:
    return millimetres.astype(np.float32) / np.float32(MM_PER_M)


def _rvl(message: Message, data: UInt8) -> NDArray[np.uint16]:
    try:
        return decode_rvl(data)
    except ValueError as error:
        raise DamagedError(f"{_name(message)}: expected depth in RVL, found {error}; the frame is damaged") from None


def _decode_depth(message: Message, data: UInt8, *kinds: type[np.generic]) -> NDArray[Any]:
    """Depth [H, W] of numbers of one of these kinds: 16 bits, or floating-point ones."""
    decoded = _decode(message, data, cv2.IMREAD_UNCHANGED)
    if decoded.ndim != 2 or decoded.dtype not in kinds:
        raise MessageError(
            f"{_name(message)}: expected a depth image of one 16-bit channel, found {decoded.dtype} of shape "
            f"{decoded.shape}; give the depth topic"
        )
    return decoded


def _decode(message: Message, data: UInt8, flags: int) -> NDArray[Any]:
    packed = data.tobytes()
    decoded = decode_picture(packed, flags)
    if decoded is None:
        raise DamagedError(
            f"{_name(message)}: {len(data)} bytes of format {message.format!r} cannot be decoded as an image; the "
            "frame is damaged or the format unknown"
        )
    if is_cut_jpeg(packed, decoded):
        raise DamagedError(
            f"{_name(message)}: expected a whole image, found a JPEG whose {len(data)} bytes are not all of it; the "
            "frame is damaged"
        )
    return decoded


def _rows(message: Message, dtype: np.dtype[Any], channels: int, rows_held: int | None = None) -> NDArray[Any]:
    """Pixels [H, W] or [H, W, C] without the padding at the end of each row; `rows_held`: H, if not the image's."""
    height, width, step = rows_held or int(message.height), int(message.width), int(message.step)
    row = width * channels * dtype.itemsize
    if not (height > 0 and width > 0 and step >= row and len(message.data) >= height * step):
        raise DamagedError(
            f"{_name(message)}: {width}x{height} {message.encoding} needs rows of at least {row} bytes, found a step "
            f"of {step} and {len(message.data)} bytes in all; the frame is damaged"
        )
    rows = np.asarray(message.data)[: height * step].reshape(height, step)[:, :row]
    pixels = np.ascontiguousarray(rows).view(dtype)
    return pixels.reshape(height, width, channels) if channels > 1 else pixels


def _name(message: Message) -> str:
    return f"image of {message.header.frame_id or 'an unnamed frame'} at {header_stamp(message)} ns"
