"""COLMAP's files walked through to their ends: behind those of a cut one pycolmap reads on, some for ever.

In text it takes every second line about images for points, whatever stands there.

Layouts: colmap/scene/reconstruction_io_binary.cc; rigs and frames since COLMAP 3.12.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from struct import Struct, error

from twin_node.model.parameters import ModelError
from twin_node.ranges import is_number

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
MOST_SIGNS = 60
"""Of a line that is no line of points: what is repeated to the user."""


class _File:
    """A file's bytes, taken one after another; `struct.error` or `ValueError` where it has ended."""

    def __init__(self, path: Path) -> None:
        self.path = path
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
    """Raises `ModelError` for a file of a model in binary that ends elsewhere than where it says that it does.

    Also for one in text whose images have no lines of points below them: every second would be lost.
    """
    if not all((model / f"{name}.bin").is_file() for name in ("cameras", "images", "points3D")):
        if (model / "images.txt").is_file():
            _check_lines(model / "images.txt")
        return
    for name, skip in _SKIPS.items():
        path = model / f"{name}.bin"
        if path.is_file():
            _check_file(path, skip)


def _check_lines(path: Path) -> None:
    lines = (line.split() for line in _read(path).data.split(b"\n"))
    for image in lines:
        if not image or image[0].startswith(b"#"):
            continue
        points = next(lines, [])
        if len(points) % 3 or not is_number(points[-1] if points else b"0"):
            name, found = (b" ".join(words).decode(errors="replace")[:MOST_SIGNS] for words in (image[9:], points))
            raise ModelError(
                f"{path}: expected a line of points below that of image '{name}', empty where there are none, found "
                f"'{found}'; export the model again"
            )


def _read(path: Path) -> _File:
    try:
        return _File(path)
    except OSError as problem:
        raise ModelError(f"{path}: cannot be read ({problem.strerror}); check its permissions") from None


def _check_file(path: Path, skip: Callable[[_File], None]) -> None:
    file = _read(path)
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
    if file.at < len(file.data):
        raise ModelError(
            f"{path}: expected the end after {count} {path.stem}, found {len(file.data) - file.at} bytes more; copy it "
            "again, or export the model again"
        )


def _skip_camera(file: _File) -> None:
    file.skip(_LENGTH.size)
    kind = file.number(_INT)
    parameters = _parameters(kind)
    if not parameters:
        raise ModelError(
            f"{file.path}: expected camera models that pycolmap knows, found number {kind}; run colmap "
            "image_undistorter, or export the model again"
        )
    file.skip(CAMERA_BYTES + 8 * parameters)


def _parameters(kind: int) -> int:
    """How many numbers a camera model has; none for one that pycolmap does not know."""
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
