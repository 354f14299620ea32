"""COLMAP's text models (`cameras.txt`, `images.txt`; colmap.github.io/format.html)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from twin_node.geometry import rotation_from_quat
from twin_node.rig.calibrate.importers.foreign_camera import (
    foreign_camera,
    foreign_rig,
    from_world_to_camera,
    pinhole,
)
from twin_node.rig.errors import RigError
from twin_node.rig.rig_file import RigFile
from twin_node.scene import Float64


@dataclass(frozen=True)
class _Model:
    """How the parameters of a camera model are read."""

    focals: int
    """One focal length for both axes, or two."""
    distortion: str
    coefficients: tuple[int, ...]
    """Places, in the model of `distortion`, of the parameters after the principal point."""
    length: int


MODELS = {
    "SIMPLE_PINHOLE": _Model(1, "plumb_bob", (), 5),
    "PINHOLE": _Model(2, "plumb_bob", (), 5),
    "SIMPLE_RADIAL": _Model(1, "plumb_bob", (0,), 5),
    "RADIAL": _Model(1, "plumb_bob", (0, 1), 5),
    "OPENCV": _Model(2, "plumb_bob", (0, 1, 2, 3), 5),
    "OPENCV_FISHEYE": _Model(2, "equidistant", (0, 1, 2, 3), 4),
    "FULL_OPENCV": _Model(2, "rational_polynomial", (0, 1, 2, 3, 4, 5, 6, 7), 8),
}


@dataclass(frozen=True)
class _Lens:
    size: tuple[int, int]
    K: Float64
    model: str
    D: Float64


def import_colmap(path: Path, unit: float = 1.0) -> RigFile:
    """Every image of a model becomes a camera; `unit`: metres per unit of COLMAP, whose scale is arbitrary."""
    folder = path if path.is_dir() else path.parent
    lenses = {line[0]: _lens(folder, line) for line in _lines(folder / "cameras.txt")}
    # Every second line lists the points of the image above it.
    images = [line for line in _lines(folder / "images.txt", keep_empty=True)[::2] if len(line) >= 10]
    cameras = []
    for line in images:
        where, name = f"{folder / 'images.txt'}: {line[9]}", Path(line[9]).stem
        numbers = _numbers(where, line[1:8])
        if line[8] not in lenses:
            raise RigError(f"{where}: expected a camera of cameras.txt, found {line[8]}; export both files together")
        lens = lenses[line[8]]
        T = from_world_to_camera(rotation_from_quat(numbers[:4]), numbers[4:] * unit)
        cameras.append(foreign_camera(where, name, lens.size, lens.K, T, lens.model, lens.D))
    notes = f"From COLMAP, whose scale is arbitrary: one unit is taken for {unit:g} m."
    return foreign_rig(str(folder), cameras, "world", notes)


def _lens(folder: Path, line: list[str]) -> _Lens:
    where = f"{folder / 'cameras.txt'}: camera {line[0]}"
    if len(line) < 5 or line[1] not in MODELS:
        raise RigError(f"{where}: expected one of {', '.join(MODELS)}, found {' '.join(line[1:2]) or 'nothing'}")
    model, values = MODELS[line[1]], _numbers(where, line[2:])
    expected = 2 + model.focals + 2 + len(model.coefficients)
    if len(values) != expected:
        raise RigError(f"{where}: expected {expected} numbers of {line[1]}, found {len(values)}")
    focal, rest = values[2 : 2 + model.focals], values[2 + model.focals :]
    D = np.zeros(model.length)
    D[list(model.coefficients)] = rest[2:]
    # COLMAP's top-left pixel has its centre at (0.5, 0.5).
    K = pinhole(focal[0], focal[-1], rest[0] - 0.5, rest[1] - 0.5)
    return _Lens((int(values[0]), int(values[1])), K, model.distortion, D)


def _lines(path: Path, keep_empty: bool = False) -> list[list[str]]:
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise RigError(
            f"{path}: expected COLMAP's model as text, found {error}; convert it with "
            "`colmap model_converter --output_type TXT`"
        ) from error
    lines = [line.split() for line in text.splitlines() if not line.startswith("#")]
    return lines if keep_empty else [line for line in lines if line]


def _numbers(where: str, parts: list[str]) -> Float64:
    try:
        return np.array([float(part) for part in parts])
    except ValueError as error:
        raise RigError(f"{where}: expected numbers, found {error}") from error
