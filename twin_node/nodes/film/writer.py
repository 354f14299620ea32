"""Pictures into files: H.264 in MP4, PNG or JPEG; whole, or not at all."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np

from twin_node.errors import TwinError
from twin_node.scene import UInt8
from twin_node.unfinished import whole_file

QUALITY = "20"
"""Constant rate factor of x264: 18 is visually lossless, 23 its default."""
PRESET = "veryfast"
"""Of x264: at our sizes slower ones save a tenth of the bytes for three times the time."""
COLOURS = (6, 1, 13, 1)
"""A film's matrix, primaries and transfer as ITU-T H.273 numbers them, and that its range is limited.

sRGB by the matrix of BT.601, as PyAV makes it: of large films that say nothing players think that it is BT.709's, and
show other reds and greens.
"""

PICTURES = (".png", ".jpg")
"""What names of pictures end in."""


class FilmError(TwinError):
    """A film or picture cannot be made as asked."""


def write_film(pictures: Iterable[UInt8], rate_hz: float, path: Path) -> int:
    """Writes pictures [H, W, 3], all of one size, as a film; returns how many. Raises `FilmError` where it cannot.

    `rate_hz`: pictures per second, 0.001 to 1000, to three digits of a fraction.
    """
    try:
        import av
        from av.error import FFmpegError
    except ImportError:
        raise FilmError("render: expected the package av; install it with pip install 'twin-node[render]'") from None
    count, size = 0, "none"
    try:
        with whole_file(path, FilmError) as partial, av.open(str(partial), "w", format="mp4") as container:
            stream = container.add_stream("libx264", rate=Fraction(rate_hz).limit_denominator(1000))
            stream.pix_fmt = "yuv420p"
            stream.options = {"crf": QUALITY, "preset": PRESET}
            said = stream.codec_context
            said.colorspace, said.color_primaries, said.color_trc, said.color_range = COLOURS
            for picture in pictures:
                even = _even(picture)
                if not count:
                    stream.height, stream.width = even.shape[:2]
                    size = f"{stream.width}x{stream.height}"
                container.mux(stream.encode(av.VideoFrame.from_ndarray(even, format="rgb24")))
                count += 1
            container.mux(stream.encode())
    except FFmpegError as error:
        raise FilmError(
            f"-o {path}: expected pictures that H.264 takes, found {size} ({error.strerror}); give a smaller --width, "
            "or one --camera"
        ) from None
    return count


def write_picture(picture: UInt8, path: Path) -> None:
    """Writes a picture [H, W, 3] as its name says, PNG or JPEG. Raises `FilmError` where it cannot."""
    is_made, data = cv2.imencode(path.suffix, cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
    if not is_made:
        size = f"{picture.shape[1]}x{picture.shape[0]}"
        raise FilmError(
            f"-o {path}: expected a picture that {path.suffix} can hold, found {size}; give a smaller --width"
        )
    with whole_file(path, FilmError) as partial:
        partial.write_bytes(data.tobytes())


def _even(picture: UInt8) -> UInt8:
    """The picture without an odd last row or column: H.264 halves the colours' resolution."""
    height, width = picture.shape[0] // 2 * 2, picture.shape[1] // 2 * 2
    return np.ascontiguousarray(picture[:height, :width])
