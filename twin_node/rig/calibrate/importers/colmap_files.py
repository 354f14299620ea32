"""The cameras and images of a COLMAP model, from its text or its binary files (colmap.github.io/format.html)."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from twin_node.errors import reason
from twin_node.ranges import is_number
from twin_node.rig.errors import RigError
from twin_node.scene import Float64

MODEL_NAMES = (
    "SIMPLE_PINHOLE",
    "PINHOLE",
    "SIMPLE_RADIAL",
    "RADIAL",
    "OPENCV",
    "OPENCV_FISHEYE",
    "FULL_OPENCV",
    "FOV",
    "SIMPLE_RADIAL_FISHEYE",
    "RADIAL_FISHEYE",
    "THIN_PRISM_FISHEYE",
    "RAD_TAN_THIN_PRISM_FISHEYE",
    "SIMPLE_DIVISION",
    "DIVISION",
    "SIMPLE_FISHEYE",
    "FISHEYE",
    "EUCM",
    "EQUIRECTANGULAR",
)
"""By COLMAP's number of the model (4.2: colmap/sensor/models.h)."""
MODEL_PARAMETERS = (3, 4, 4, 5, 8, 8, 12, 5, 4, 5, 12, 16, 4, 5, 3, 4, 6, 2)
"""How many parameters each has: needed to find the next camera in a binary file."""
POINT_BYTES = 24
"""Of a point in an image: x, y, and the number of the point in space."""
MOST_SIGNS = 60
"""Of what a model cannot hold: what is repeated to the user."""
MOST_DIGITS = 10
"""Of a number of a camera or an image, which COLMAP holds in 32 bits."""


@dataclass(frozen=True)
class ColmapCamera:
    """A lens."""

    where: str
    """File and number, for error lines."""
    number: int
    model: str
    size: tuple[float, float]
    parameters: Float64


@dataclass(frozen=True)
class ColmapImage:
    """A pose."""

    where: str
    number: int
    name: str
    camera: int
    pose: Float64
    """[7] quaternion w, x, y, z and translation, world to camera."""


@dataclass(frozen=True)
class ColmapModel:
    """What a folder holds."""

    cameras: tuple[ColmapCamera, ...]
    images: tuple[ColmapImage, ...]


def read_model(folder: Path) -> ColmapModel:
    """The model of a folder: `cameras.txt` and `images.txt`, else `cameras.bin` and `images.bin`.

    Raises `RigError` naming the file that is missing, cut short or no such file, or the number that stands twice.
    """
    binary = folder / "cameras.bin"
    if binary.is_file() and not (folder / "cameras.txt").is_file():
        model = ColmapModel(_binary_cameras(binary), _binary_images(folder / "images.bin"))
    else:
        model = ColmapModel(_text_cameras(folder / "cameras.txt"), _text_images(folder / "images.txt"))
    for entries in (model.cameras, model.images):
        known: set[int] = set()
        for entry in entries:
            if entry.number in known:
                raise RigError(f"{entry.where}: expected number {entry.number} once, found it again; remove one")
            known.add(entry.number)
    return model


def _text_cameras(path: Path) -> tuple[ColmapCamera, ...]:
    cameras = []
    for line in filter(None, _lines(path)):
        number = _whole(str(path), "camera", line[0])
        where = f"{path}: camera {number}"
        numbers = _numbers(where, line[2:])
        if len(numbers) < 3:
            raise RigError(f"{where}: expected a model, a width, a height and parameters, found {_told(line)}")
        size = (float(numbers[0]), float(numbers[1]))
        cameras.append(ColmapCamera(where, number, line[1], size, numbers[2:]))
    return tuple(cameras)


def _text_images(path: Path) -> tuple[ColmapImage, ...]:
    """The line below each image lists its points, three numbers each; before images may be empty lines.

    Raises `RigError` for others.
    """
    lines, images = iter(_lines(path)), []
    for line in filter(None, lines):
        if len(line) < 10:
            raise RigError(
                f"{path}: expected lines of a number, a quaternion, a translation, a camera and a name, found "
                f"{_told(line)!r}; export the model again"
            )
        where = f"{path}: {line[9]}"
        points = next(lines, [])
        if len(points) % 3 or not is_number(points[-1] if points else "0"):
            raise RigError(
                f"{where}: expected a line of points below it, empty where there are none, found {_told(points)!r}"
            )
        number, camera = _whole(where, "image", line[0]), _whole(where, "camera", line[8])
        images.append(ColmapImage(where, number, " ".join(line[9:]), camera, _numbers(where, line[1:8])))
    return tuple(images)


def _lines(path: Path) -> list[list[str]]:
    """The words of each line but comments."""
    try:
        text = path.read_text(encoding="utf-8-sig")  # editors of Windows begin with a mark
    except (OSError, UnicodeDecodeError) as error:
        raise RigError(
            f"{path}: expected a model of COLMAP (cameras and images, .txt or .bin), found: {reason(error)}; give "
            "the folder that holds them"
        ) from error
    return [line.split() for line in text.split("\n") if not line.lstrip().startswith("#")]


def _whole(where: str, of: str, word: str) -> int:
    if not (word.isdecimal() and len(word) <= MOST_DIGITS):
        raise RigError(f"{where}: expected the number of a {of}, found {_told([word])!r}; export the model again")
    return int(word)


def _numbers(where: str, parts: list[str]) -> Float64:
    wrong = [part for part in parts if not is_number(part)]
    if wrong:
        raise RigError(f"{where}: expected numbers, found {_told(wrong)!r}")
    numbers = np.array([float(part) for part in parts])
    if not np.isfinite(numbers).all():
        raise RigError(f"{where}: expected finite numbers, found {_told(parts)}")
    return numbers


def _told(words: list[str]) -> str:
    return " ".join(words)[:MOST_SIGNS]


class _Bytes:
    """A binary file, read from front to back; little-endian, without padding."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._at = 0
        try:
            self._data = path.read_bytes()
        except OSError as error:
            raise RigError(f"{path}: expected a binary file of COLMAP's model, found: {reason(error)}") from error

    def take(self, form: str) -> tuple[int | float, ...]:
        """The next values, as `struct` describes them."""
        try:
            values = struct.unpack_from(f"<{form}", self._data, self._at)
        except struct.error:
            raise self._cut() from None
        self._at += struct.calcsize(f"<{form}")
        return values

    def text(self) -> str:
        """The text up to the next zero byte."""
        end = self._data.find(b"\0", self._at)
        if end < 0:
            raise self._cut()
        text = self._data[self._at : end].decode("utf-8", errors="replace")
        self._at = end + 1
        return text

    def skip(self, count: int) -> None:
        """Leaves out bytes that must be there."""
        self._at += count
        if self._at > len(self._data):
            raise self._cut()

    def end(self, count: int) -> None:
        """Nothing may come any more, of a file that told of `count` entries."""
        if self._at < len(self._data):
            raise self.damaged(f"{len(self._data) - self._at} bytes behind the {count} that it counts")

    def _cut(self) -> RigError:
        return self.damaged(f"one that ends after {len(self._data)} bytes")

    def damaged(self, found: str) -> RigError:
        """The error for a file that is cut short or none of COLMAP's."""
        return RigError(f"{self._path}: expected a whole binary file of COLMAP, found {found}; export the model again")


def _binary_cameras(path: Path) -> tuple[ColmapCamera, ...]:
    data = _Bytes(path)
    (count,) = data.take("Q")
    cameras = []
    for _ in range(int(count)):
        number, kind, width, height = (int(value) for value in data.take("iiQQ"))
        if not 0 <= kind < len(MODEL_NAMES):
            raise RigError(
                f"{path}: camera {number}: expected a model from 0 to {len(MODEL_NAMES) - 1} ({MODEL_NAMES[-1]}), "
                f"found {kind}; export the model again, as text if it is of a newer COLMAP (colmap model_converter)"
            )
        parameters = np.array(data.take(f"{MODEL_PARAMETERS[kind]}d"))
        where = f"{path}: camera {number}"
        cameras.append(ColmapCamera(where, number, MODEL_NAMES[kind], (width, height), parameters))
    data.end(int(count))
    return tuple(cameras)


def _binary_images(path: Path) -> tuple[ColmapImage, ...]:
    data = _Bytes(path)
    (count,) = data.take("Q")
    images = []
    for _ in range(int(count)):
        (number,) = data.take("i")
        pose = np.array(data.take("7d"))
        (camera,) = data.take("i")
        name = data.text()
        (points,) = data.take("Q")
        data.skip(POINT_BYTES * int(points))
        images.append(ColmapImage(f"{path}: {name}", int(number), name, int(camera), pose))
    data.end(int(count))
    return tuple(images)
