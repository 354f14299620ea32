"""D-NeRF (Pumarola et al., CVPR 2021): `transforms_train.json` and, to be scored on, `transforms_test.json`.

Every image has its own camera and a `time` from 0 to 1, which becomes one second. Transparent pixels are white, as
published. Fields of other tools that write this layout (`fl_x`, `camera_angle_y`, `cx`, ...) are taken where they are,
of the file or of a frame. Images must be undistorted.
"""

from __future__ import annotations

import json
import math
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from twin_node.errors import reason
from twin_node.model.parameters import ModelError
from twin_node.model.sequence.readers.options import (
    NO_PINHOLE,
    ReadOptions,
    load_image,
    refuse_other_shape,
    scaled_intrinsics,
    shrunk,
)
from twin_node.model.sequence.recording import Recording, in_order, split, that_fit
from twin_node.scene import Camera, Float64, UInt8, View

TRAIN, TEST = "transforms_train.json", "transforms_test.json"
WHITE = (1.0, 1.0, 1.0)
DISTORTION = ("k1", "k2", "k3", "k4", "p1", "p2")
"""What other tools call coefficients of a lens."""
DURATION_NS = 1_000_000_000
"""What the times 0 to 1 are taken for."""
LATEST = 2e9
"""Of times: the logs that models become tell seconds by 32 bits."""


def recognises(folder: Path) -> bool:
    """Whether a folder has this layout."""
    return (folder / TRAIN).is_file()


def read(folder: Path, options: ReadOptions) -> Recording:
    """Reads a scene: `transforms_test.json` is held out, where it is there.

    Raises `ModelError` for a file that is not JSON, lacks fields, or names images that are not there.
    """
    train = _load_split(folder / TRAIN, "train")
    test = _load_split(folder / TEST, "test") if (folder / TEST).is_file() else None
    last = None
    if options.frames is not None:
        last = sorted({frame.stamp for frame in train.frames})[: options.frames][-1]
    held_out = () if test is None else test.read(options.width, last)
    recording = Recording(str(folder), train.read(options.width, last), held_out, background=WHITE, camera_moves=True)
    return split(recording, options.hold_out or ())


@dataclass(frozen=True)
class _Frame:
    """An entry of a file's `frames`."""

    index: int
    stamp: int
    fields: dict[str, Any]


@dataclass(frozen=True)
class _Split:
    """A file of the layout, its images not yet read."""

    path: Path
    prefix: str
    """What its cameras' names begin with."""
    root: dict[str, Any]
    frames: tuple[_Frame, ...]

    def read(self, width: int | None, last: int | None) -> tuple[View, ...]:
        """The images up to the stamp `last`, in rising order of stamps: of later ones a model learns nothing."""
        chosen = [frame for frame in self.frames if last is None or frame.stamp <= last]
        return in_order(that_fit(str(self.path), (_read_frame(self, frame, width) for frame in chosen)))


def _load_split(path: Path, prefix: str) -> _Split:
    try:
        root: Any = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise ModelError(
            f"{path}: expected JSON, found something else ({reason(error)}); copy the data set again"
        ) from None
    entries = root.get("frames") if isinstance(root, dict) else None
    if not isinstance(entries, list) or not entries:
        raise ModelError(f"{path}: expected a list 'frames' with entries, found none; copy the data set again")
    frames = (_Frame(index, _stamp(fields, path, index), fields) for index, fields in enumerate(entries))
    return _Split(path, prefix, root, tuple(frames))


def _stamp(frame: Any, path: Path, index: int) -> int:
    time = _number(frame, "time", path, index)
    if abs(time) > LATEST:
        raise ModelError(
            f"{path}: expected a 'time' from -{LATEST:g} to {LATEST:g} in frame {index}, found {time:g}; give times "
            "from 0 to 1"
        )
    return round(time * DURATION_NS)


def _read_frame(of: _Split, frame: _Frame, width: int | None) -> View:
    path, index = of.path, frame.index
    file = frame.fields.get("file_path")
    if not isinstance(file, str):
        raise ModelError(f"{path}: expected a 'file_path' in frame {index}, found none; copy the data set again")
    named = path.parent / file
    image = load_image(named if named.is_file() else Path(f"{named}.png"))
    K = _intrinsics(of.root | frame.fields, (image.shape[0], image.shape[1]), path)
    rgb = shrunk(_on_white(image), width)
    K = scaled_intrinsics(K, (image.shape[1], image.shape[0]), (rgb.shape[0], rgb.shape[1]))
    T_base_cam = _matrix(frame.fields, path, index)
    T_base_cam[:, 1:3] *= -1
    camera = Camera(f"{of.prefix}_{index:03d}", rgb.shape[1], rgb.shape[0], K, T_base_cam)
    return View(camera, frame.stamp, rgb)


def _on_white(image: UInt8) -> UInt8:
    """[H, W, 3] colours over white where the image has alpha."""
    if image.shape[-1] == 3:
        return image
    alpha = image[..., 3:].astype(np.float32) / 255
    return (image[..., :3] * alpha + 255 * (1 - alpha) + 0.5).astype(np.uint8)


def _intrinsics(root: dict[str, Any], shape: tuple[int, int], path: Path) -> Float64:
    height, width = shape
    bent = [name for name in DISTORTION if _number({name: root.get(name, 0)}, name, path)]
    if bent:
        raise ModelError(f"{path}: expected undistorted images, found {', '.join(bent)} other than 0; undistort them")
    model = str(root.get("camera_model", "PINHOLE")).upper()
    if root.get("is_fisheye") or any(kind in model for kind in NO_PINHOLE):
        raise ModelError(f"{path}: expected images of a pinhole camera, found those of another kind; undistort them")

    def given(name: str, default: float) -> float:
        return _number({name: root.get(name, default)}, name, path)

    w, h = given("w", width), given("h", height)
    fx = _number(root, "fl_x", path) if "fl_x" in root else _focal(root, "camera_angle_x", w, path)
    fy = _focal(root, "camera_angle_y", h, path) if "camera_angle_y" in root and "fl_x" not in root else fx
    K = np.array([[fx, 0, given("cx", w / 2)], [0, given("fl_y", fy), given("cy", h / 2)], [0, 0, 1]])
    if min(fx, K[1, 1], w, h) <= 0:
        raise ModelError(f"{path}: expected fl_x, fl_y, w and h above 0, found {fx}, {K[1, 1]}, {w} and {h}")
    refuse_other_shape(str(path), (w, h), shape)
    return scaled_intrinsics(K, (w, h), shape)


def _focal(root: dict[str, Any], name: str, side: float, path: Path) -> float:
    """Focal length in pixels of an image `side` pixels long that is seen under the angle `name`."""
    angle = _number(root, name, path)
    if not 0 < angle < math.pi:
        raise ModelError(f"{path}: expected {name} between 0 and pi rad, found {angle}")
    return side / 2 / math.tan(angle / 2)


def _matrix(frame: dict[str, Any], path: Path, index: int) -> Float64:
    try:
        matrix = np.array(frame.get("transform_matrix"), dtype=np.float64)
    except (OverflowError, TypeError, ValueError):
        matrix = np.zeros(0)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        raise ModelError(f"{path}: expected a 'transform_matrix' of 4 x 4 numbers in frame {index}")
    with np.errstate(over="ignore", invalid="ignore"):
        off = np.abs(matrix[:3, :3].T @ matrix[:3, :3] - np.eye(3)).max()
    if not off <= 1e-2:
        raise ModelError(f"{path}: the 'transform_matrix' of frame {index} holds no rotation; remove its scale")
    if np.linalg.det(matrix[:3, :3]) < 0:
        raise ModelError(f"{path}: the 'transform_matrix' of frame {index} is mirrored; turn one of its axes about")
    if np.abs(matrix[3] - [0, 0, 0, 1]).max() > 1e-6:
        raise ModelError(
            f"{path}: expected 0, 0, 0, 1 as the last row of the 'transform_matrix' of frame {index}, found "
            f"{', '.join(f'{value:g}' for value in matrix[3])}; is it transposed?"
        )
    return matrix


def _number(fields: Any, name: str, path: Path, index: int | None = None) -> float:
    value = fields.get(name) if isinstance(fields, dict) else None
    if not isinstance(value, int | float) or isinstance(value, bool) or not abs(value) <= sys.float_info.max:
        where = "" if index is None else f" in frame {index}"
        raise ModelError(f"{path}: expected a number '{name}'{where}, found {value!r}; is it a dynamic scene's file?")
    return float(value)
