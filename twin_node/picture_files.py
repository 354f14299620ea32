"""Pictures in files, folders and messages, whoever made them."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

JPEG_SIGNATURE, START_OF_SCAN, END_OF_IMAGE = b"\xff\xd8\xff", b"\xff\xda", b"\xff\xd9"
"""Markers of a JPEG (ITU T.81, section B.1.1); the data of a scan hold none of them."""
PROGRESSIVE = (b"\xff\xc2", b"\xff\xc6", b"\xff\xca", b"\xff\xce")
"""Markers of those whose every scan draws the whole picture, sharper than the one before."""
PNG_SIGNATURE, PNG_HEAD_BYTES = b"\x89PNG", 8
"""What a PNG begins with, and all that is before its first chunk."""
PNG_CHUNK = struct.Struct(">I4s")
"""Before a chunk's data: their length and its name. Behind them are four bytes of checksum."""
NOTHING_LEFT, BLOCK_PX = 128, 8
"""All channels of the pixels for which a JPEG has no data, and the side of the blocks that these come in: libjpeg takes
their coefficients to be zero."""
MORE_DATA = b"".join(bytes(range(1, 65)) + bytes((0xFF, 0xD0 + interval)) for interval in range(8))
"""Data of a scan, each followed by the marker that begins another interval, that draw pixels where some are still to be
drawn, and are not read where none are."""


def read_picture(path: Path, flags: int) -> NDArray[Any] | None:
    """Pixels as OpenCV's `imread` has them with these flags; None for a file that is no picture of a kind it reads."""
    try:
        return cv2.imread(str(path), flags)
    except cv2.error:  # a kind that is switched off (EXR), or more pixels than any image has
        return None


def decode_picture(data: bytes, flags: int) -> NDArray[Any] | None:
    """Pixels as OpenCV's `imdecode` has them with these flags; None for what is no picture of a kind it reads.

    Of a JPEG whose end marker alone is missing, as some cameras leave it out, the picture.
    """
    if not data or _is_cut_png(data):
        return None
    if lacks_end(data) and _one_scan(data):
        data += END_OF_IMAGE
    try:
        return cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error:  # what its head says of its size is beyond all images
        return None


def lacks_end(data: bytes) -> bool:
    """Whether a picture's data are a JPEG without an end marker, which only some cameras leave out."""
    return data.startswith(JPEG_SIGNATURE) and data.rfind(END_OF_IMAGE, _head(data)) < 0


def is_cut_jpeg(data: bytes, picture: NDArray[Any]) -> bool:
    """Whether a picture's data are a JPEG that holds only its upper part, with an end marker or without.

    OpenCV draws the rest grey. Bytes that a camera or its cable lost leave one, too. `picture`: [H, W] or [H, W, C] as
    decoded, not turned. Of a progressive JPEG it does not tell: its picture is whole, and less sharp. Nor does it where
    a part of the last row of blocks is all that is lost: single grey blocks are no rare sight, and of each picture that
    is whole after all libjpeg writes a line to stderr.
    """
    last_row = picture[-((len(picture) - 1) % BLOCK_PX + 1) :]
    if (last_row != NOTHING_LEFT).any() or not _one_scan(data):
        return False
    end = data.find(END_OF_IMAGE, _head(data))
    longer = (data if end < 0 else data[:end]) + MORE_DATA
    flags = cv2.IMREAD_COLOR if picture.ndim == 3 else cv2.IMREAD_GRAYSCALE
    drawn = decode_picture(longer, flags | cv2.IMREAD_IGNORE_ORIENTATION)
    return drawn is not None and not np.array_equal(drawn, picture)


def listed(folder: Path) -> list[Path]:
    """What a folder holds in order of names, but for what is hidden: macOS leaves a `._NAME` beside what it copies."""
    return sorted(path for path in folder.iterdir() if not path.name.startswith("."))


def _is_cut_png(data: bytes) -> bool:
    """Whether data are a PNG one of whose chunks goes on beyond their end: OpenCV takes as much memory first, 4 GB."""
    if not data.startswith(PNG_SIGNATURE):
        return False
    place, name = PNG_HEAD_BYTES, b""
    while name != b"IEND" and place + PNG_CHUNK.size <= len(data):
        length, name = PNG_CHUNK.unpack(data[place : place + PNG_CHUNK.size])
        place += PNG_CHUNK.size + length + 4
    return place > len(data)


def _one_scan(data: bytes) -> bool:
    """Whether data are a JPEG whose one scan draws its picture from top to bottom."""
    if not data.startswith(JPEG_SIGNATURE):
        return False
    segments = [data[at : at + 2] for at in _segments(data)]
    return segments[-1] == START_OF_SCAN and not any(marker in PROGRESSIVE for marker in segments)


def _head(data: bytes) -> int:
    """Where a JPEG's first scan begins."""
    *_, last = _segments(data)
    return last


def _segments(data: bytes) -> Iterator[int]:
    """Where each segment of a JPEG's head begins; the last is its first scan, or what comes in place of one."""
    at = 2
    while data[at : at + 1] == b"\xff" and data[at : at + 2] != START_OF_SCAN:
        if data[at + 1 : at + 2] == b"\xff":  # a fill byte
            at += 1
        else:
            yield at
            at += 2 + int.from_bytes(data[at + 2 : at + 4], "big")  # a segment may hold a thumbnail
    yield at
