"""The cameras and images of a COLMAP model, from its text or its binary files (colmap.github.io/format.html)."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from twin_node.errors import reason
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
)
"""By COLMAP's number of the model."""
MODEL_PARAMETERS = (3, 4, 4, 5, 8, 8, 12, 5, 4, 5, 12)
"""How many parameters each has: needed to find the next camera in a binary file."""
POINT_BYTES = 24
"""Of a point in an image: x, y, and the number of the point in space."""
MOST_SIGNS = 60
"""Of a line that is no line of points: what is repeated to the user."""


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

    Raises `RigError` naming the file that is missing, cut short or no such file.
    """
    binary = folder / "cameras.bin"
    if binary.is_file() and not (folder / "cameras.txt").is_file():
        return ColmapModel(_binary_cameras(binary), _binary_images(folder / "images.bin"))
    return ColmapModel(_text_cameras(folder / "cameras.txt"), _text_images(folder / "images.txt"))


def _text_cameras(path: Path) -> tuple[ColmapCamera, ...]:
    cameras = []
    for line in _lines(path):
        if not line:
            continue
        where = f"{path}: camera {line[0]}"
        numbers = _numbers(where, [line[0], *line[2:]])
        if len(numbers) < 4:
            raise RigError(f"{where}: expected a model, a width, a height and parameters, found {' '.join(line)}")
        size = (float(numbers[1]), float(numbers[2]))
        cameras.append(ColmapCamera(where, int(numbers[0]), line[1], size, numbers[3:]))
    return tuple(cameras)


def _text_images(path: Path) -> tuple[ColmapImage, ...]:
    """Every second line lists the points of the image above it, three numbers each. Raises `RigError` for others."""
    lines, images = _lines(path), []
    for line, points in zip(lines[::2], [*lines[1::2], []], strict=False):
        if not line:
            continue
        if len(line) < 10:
            raise RigError(
                f"{path}: expected lines of a number, a quaternion, a translation, a camera and a name, found "
                f"{' '.join(line)[:MOST_SIGNS]!r}; export the model again"
            )
        where = f"{path}: {line[9]}"
        if len(points) % 3:
            raise RigError(
                f"{where}: expected a line of points below it, empty where there are none, found "
                f"{' '.join(points)[:MOST_SIGNS]!r}"
            )
        numbers = _numbers(where, line[1:9])
        images.append(ColmapImage(where, " ".join(line[9:]), int(numbers[7]), numbers[:7]))
    return tuple(images)


def _lines(path: Path) -> list[list[str]]:
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise RigError(
            f"{path}: expected a model of COLMAP (cameras and images, .txt or .bin), found: {reason(error)}; give "
            "the folder that holds them"
        ) from error
    return [line.split() for line in text.splitlines() if not line.startswith("#")]


def _numbers(where: str, parts: list[str]) -> Float64:
    try:
        numbers = np.array([float(part) for part in parts])
    except ValueError as error:
        raise RigError(f"{where}: expected numbers, found {error}") from error
    if not np.isfinite(numbers).all():
        raise RigError(f"{where}: expected finite numbers, found {' '.join(parts)}")
    return numbers


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
        except struct.error as error:
            raise self.damaged(str(error)) from error
        self._at += struct.calcsize(f"<{form}")
        return values

    def text(self) -> str:
        """The text up to the next zero byte."""
        end = self._data.find(b"\0", self._at)
        if end < 0:
            raise self.damaged("a name without an end")
        text = self._data[self._at : end].decode("utf-8", errors="replace")
        self._at = end + 1
        return text

    def skip(self, count: int) -> None:
        """Leaves out bytes that must be there."""
        self._at += count
        if self._at > len(self._data):
            raise self.damaged(f"{self._at - len(self._data)} bytes too few")

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
            raise data.damaged(f"a camera of the unknown model {kind}")
        parameters = np.array(data.take(f"{MODEL_PARAMETERS[kind]}d"))
        where = f"{path}: camera {number}"
        cameras.append(ColmapCamera(where, number, MODEL_NAMES[kind], (width, height), parameters))
    return tuple(cameras)


def _binary_images(path: Path) -> tuple[ColmapImage, ...]:
    data = _Bytes(path)
    (count,) = data.take("Q")
    images = []
    for _ in range(int(count)):
        data.take("i")
        pose = np.array(data.take("7d"))
        (camera,) = data.take("i")
        name = data.text()
        (points,) = data.take("Q")
        data.skip(POINT_BYTES * int(points))
        images.append(ColmapImage(f"{path}: {name}", name, int(camera), pose))
    return tuple(images)
