"""COLMAP's models, text or binary: every image becomes a camera."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from twin_node.geometry import rotation_from_quat
from twin_node.rig.calibrate.importers.colmap_files import MOST_SIGNS, ColmapCamera, ColmapImage, read_model
from twin_node.rig.calibrate.importers.foreign_camera import (
    foreign_camera,
    foreign_rig,
    from_world_to_camera,
)
from twin_node.rig.calibrate.lenses import camera_matrix
from twin_node.rig.errors import RigError
from twin_node.rig.rig_file import RigFile
from twin_node.scene import RigCamera


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
    "SIMPLE_FISHEYE": _Model(1, "equidistant", (), 4),
    "FISHEYE": _Model(2, "equidistant", (), 4),
    "SIMPLE_RADIAL_FISHEYE": _Model(1, "equidistant", (0,), 4),
    "RADIAL_FISHEYE": _Model(1, "equidistant", (0, 1), 4),
    "OPENCV_FISHEYE": _Model(2, "equidistant", (0, 1, 2, 3), 4),
    "FULL_OPENCV": _Model(2, "rational_polynomial", (0, 1, 2, 3, 4, 5, 6, 7), 8),
}
"""COLMAP's models that the twin's lenses cover."""


def import_colmap(path: Path, unit: float = 1.0) -> RigFile:
    """Every image of a model becomes a camera; `unit`: metres per unit of COLMAP, whose scale is arbitrary."""
    folder = path.parent if path.is_file() else path
    model = read_model(folder)
    lenses = {camera.number: camera for camera in model.cameras}
    cameras, names = [], _names([image.name for image in model.images])
    for image, name in zip(model.images, names, strict=True):
        if image.camera not in lenses:
            raise RigError(
                f"{image.where}: expected a camera of the model, found number {image.camera}; export both files "
                "together"
            )
        cameras.append(_camera(lenses[image.camera], image, name, unit))
    notes = f"From COLMAP, whose scale is arbitrary: one unit is taken for {unit:g} m."
    return foreign_rig(str(folder), cameras, "world", notes)


def _names(images: list[str]) -> list[str]:
    """Of cameras: images' names, with their folders where each camera has one and its images are numbered alike."""
    names = [Path(image).stem for image in images]
    if len(set(names)) == len(names):
        return names
    return [(Path(image).parent / Path(image).stem).as_posix().replace("/", "_") for image in images]


def _camera(lens: ColmapCamera, image: ColmapImage, name: str, unit: float) -> RigCamera:
    if lens.model not in MODELS:
        raise RigError(
            f"{lens.where}: expected one of {', '.join(MODELS)}, found {lens.model[:MOST_SIGNS]}; undistort the model "
            "with COLMAP"
        )
    model = MODELS[lens.model]
    expected = model.focals + 2 + len(model.coefficients)
    if len(lens.parameters) != expected:
        raise RigError(f"{lens.where}: expected {expected} numbers of {lens.model}, found {len(lens.parameters)}")
    focal, rest = lens.parameters[: model.focals], lens.parameters[model.focals :]
    D = np.zeros(model.length)
    D[list(model.coefficients)] = rest[2:]
    # COLMAP's top-left pixel has its centre at (0.5, 0.5).
    K = camera_matrix(focal[0], focal[-1], rest[0] - 0.5, rest[1] - 0.5)
    quat, longest = image.pose[:4], np.abs(image.pose[:4]).max()
    if not 0 < longest < np.inf:
        raise RigError(f"{image.where}: expected a quaternion, found {quat.tolist()}; export the model again")
    # Divided first: squares of large numbers have no end.
    T = from_world_to_camera(rotation_from_quat(quat / longest), image.pose[4:] * unit)
    return foreign_camera(image.where, name, lens.size, K, T, model.distortion, D)
