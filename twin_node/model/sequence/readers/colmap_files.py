"""COLMAP's binary files walked through to their ends: behind those of a cut one pycolmap reads on, some for ever.

Layouts: colmap/scene/reconstruction_io_binary.cc; rigs and frames since COLMAP 3.12.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from struct import Struct, error

from twin_node.model.parameters import ModelError

_COUNT, _LENGTH, _INT = Struct("<Q"), Struct("<I"), Struct("<i")
CAMERA_BYTES = 8 + 8
"""Of a camera between its model and its parameters: width, height."""
POSE_BYTES = 7 * 8
"""A quaternion and a translation."""
SENSOR_BYTES = 4 + 4
"""Type and number."""
POINT_2D_BYTES = 8 + 8 + 8
"""Place in the image, number of its point."""
POINT_BYTES = 8 + 3 * 8 + 3 + 8
"""Of a point before its track: number, place, colour, error."""
SEEN_BYTES = 4 + 4
"""One entry of a track: image, point of it."""


class _File:
    """A file's bytes, taken one after another; `struct.error` or `ValueError` where it has ended."""

    def __init__(self, path: Path) -> None:
        self.data = path.read_bytes()
        self.at = 0

    def skip(self, size: int) -> None:
        if size > len(self.data) - self.at:
            raise ValueError
        self.at += size

    def number(self, kind: Struct) -> int:
        value: int = kind.unpack_from(self.data, self.at)[0]
        self.at += kind.size
        return value

    def skip_name(self) -> None:
        self.at = self.data.index(b"\0", self.at) + 1


def check_whole(model: Path) -> None:
    """Raises `ModelError` for a file of a model in binary that ends before what it says it holds."""
    if not all((model / f"{name}.bin").is_file() for name in ("cameras", "images", "points3D")):
        return  # it is read as text
    for name, skip in _SKIPS.items():
        path = model / f"{name}.bin"
        if path.is_file():
            _check_file(path, skip)


def _check_file(path: Path, skip: Callable[[_File], None]) -> None:
    try:
        file = _File(path)
    except OSError as problem:
        raise ModelError(f"{path}: cannot be read ({problem.strerror}); check its permissions") from None
    count, whole = 0, 0
    try:
        count = file.number(_COUNT)
        while whole < count:
            skip(file)
            whole += 1
    except (error, ValueError):
        raise ModelError(
            f"{path}: expected {count or 'the number of'} {path.stem}, found a file that ends after {whole}, "
            f"{len(file.data)} bytes; copy it again, or export the model again"
        ) from None


def _skip_camera(file: _File) -> None:
    file.skip(_LENGTH.size)
    parameters = _parameters(file.number(_INT))
    file.skip(CAMERA_BYTES + 8 * parameters)


def _parameters(kind: int) -> int:
    """How many numbers a camera model has; none for one that pycolmap does not know, which it says itself."""
    import pycolmap

    try:
        names: str = pycolmap.Camera(model=pycolmap.CameraModelId(kind)).params_info
    except ValueError:
        return 0
    return len(names.split(","))


def _skip_rig(file: _File) -> None:
    file.skip(_LENGTH.size)
    sensors = file.number(_LENGTH)
    if sensors:
        file.skip(SENSOR_BYTES)  # of reference
    for _ in range(sensors - 1):
        file.skip(SENSOR_BYTES)
        has_pose = file.data[file.at : file.at + 1] == b"\1"
        file.skip(1 + POSE_BYTES * has_pose)


def _skip_frame(file: _File) -> None:
    file.skip(2 * _LENGTH.size + POSE_BYTES)
    file.skip(file.number(_LENGTH) * (SENSOR_BYTES + _COUNT.size))


def _skip_image(file: _File) -> None:
    file.skip(_LENGTH.size + POSE_BYTES + _LENGTH.size)
    file.skip_name()
    file.skip(file.number(_COUNT) * POINT_2D_BYTES)


def _skip_point(file: _File) -> None:
    file.skip(POINT_BYTES)
    file.skip(file.number(_COUNT) * SEEN_BYTES)


_SKIPS = {
    "cameras": _skip_camera,
    "rigs": _skip_rig,
    "frames": _skip_frame,
    "images": _skip_image,
    "points3D": _skip_point,
}
