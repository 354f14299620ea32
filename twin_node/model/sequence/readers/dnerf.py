"""D-NeRF (Pumarola et al., CVPR 2021): `transforms_train.json` and, to be scored on, `transforms_test.json`.

Every image has its own camera and a `time` from 0 to 1, which becomes one second. Transparent pixels are white, as
published. Fields of other tools that write this layout (`fl_x`, `cx`, ...) are taken where they are.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from twin_node.model.parameters import ModelError
from twin_node.model.sequence.readers.options import ReadOptions, load_image, scaled_intrinsics, shrunk
from twin_node.model.sequence.recording import Recording, in_order, split
from twin_node.scene import Camera, Float64, UInt8, View

TRAIN, TEST = "transforms_train.json", "transforms_test.json"
WHITE = (1.0, 1.0, 1.0)
DURATION_NS = 1_000_000_000
"""What the times 0 to 1 are taken for."""


def recognises(folder: Path) -> bool:
    """Whether a folder has this layout."""
    return (folder / TRAIN).is_file()


def read(folder: Path, options: ReadOptions) -> Recording:
    """Reads a scene: `transforms_test.json` is held out, where it is there.

    Raises `ModelError` for a file that is not JSON, lacks fields, or names images that are not there.
    """
    train = _read_split(folder, TRAIN, "train", options)
    test = _read_split(folder, TEST, "test", options) if (folder / TEST).is_file() else []
    recording = Recording(str(folder), in_order(train), in_order(test), background=WHITE, camera_moves=True)
    return split(recording, options.hold_out or ())


def _read_split(folder: Path, name: str, prefix: str, options: ReadOptions) -> list[View]:
    path = folder / name
    try:
        root: Any = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ModelError(f"{path}: expected JSON, found something else ({error}); copy the data set again") from None
    frames = root.get("frames") if isinstance(root, dict) else None
    if not isinstance(frames, list) or not frames:
        raise ModelError(f"{path}: expected a list 'frames' with entries, found none; copy the data set again")
    chosen = sorted(enumerate(frames), key=lambda item: _number(item[1], "time", path, item[0]))[: options.frames]
    return [_read_frame(folder, root, index, frame, path, prefix, options.width) for index, frame in chosen]


def _read_frame(
    folder: Path, root: dict[str, Any], index: int, frame: dict[str, Any], path: Path, prefix: str, width: int | None
) -> View:
    file = frame.get("file_path")
    if not isinstance(file, str):
        raise ModelError(f"{path}: expected a 'file_path' in frame {index}, found none; copy the data set again")
    image_path = folder / file
    image = load_image(image_path if image_path.suffix else image_path.with_suffix(".png"))
    K = _intrinsics(root, (image.shape[0], image.shape[1]), path)
    rgb = shrunk(_on_white(image), width)
    K = scaled_intrinsics(K, (image.shape[1], image.shape[0]), (rgb.shape[0], rgb.shape[1]))
    T_base_cam = _matrix(frame, path, index)
    T_base_cam[:, 1:3] *= -1
    time = _number(frame, "time", path, index)
    camera = Camera(f"{prefix}_{index:03d}", rgb.shape[1], rgb.shape[0], K, T_base_cam)
    return View(camera, round(time * DURATION_NS), rgb)


def _on_white(image: UInt8) -> UInt8:
    """[H, W, 3] colours over white where the image has alpha."""
    if image.shape[-1] == 3:
        return image
    alpha = image[..., 3:].astype(np.float32) / 255
    return (image[..., :3] * alpha + 255 * (1 - alpha) + 0.5).astype(np.uint8)


def _intrinsics(root: dict[str, Any], shape: tuple[int, int], path: Path) -> Float64:
    height, width = shape
    if "fl_x" in root:

        def given(name: str, default: float) -> float:
            return _number({name: root.get(name, default)}, name, path)

        fx, w, h = _number(root, "fl_x", path), given("w", width), given("h", height)
        K = np.array([[fx, 0, given("cx", w / 2)], [0, given("fl_y", fx), given("cy", h / 2)], [0, 0, 1]])
        if min(fx, K[1, 1], w, h) <= 0:
            raise ModelError(f"{path}: expected fl_x, fl_y, w and h above 0, found {fx}, {K[1, 1]}, {w} and {h}")
        return scaled_intrinsics(K, (w, h), shape)
    angle = _number(root, "camera_angle_x", path)
    if not 0 < angle < math.pi:
        raise ModelError(f"{path}: expected camera_angle_x between 0 and pi rad, found {angle}")
    focal = width / 2 / math.tan(angle / 2)
    return np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])


def _matrix(frame: dict[str, Any], path: Path, index: int) -> Float64:
    try:
        matrix = np.array(frame.get("transform_matrix"), dtype=np.float64)
    except (TypeError, ValueError):
        matrix = np.zeros(0)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        raise ModelError(f"{path}: expected a 'transform_matrix' of 4 x 4 numbers in frame {index}")
    if np.abs(matrix[:3, :3].T @ matrix[:3, :3] - np.eye(3)).max() > 1e-2:
        raise ModelError(f"{path}: the 'transform_matrix' of frame {index} holds no rotation; remove its scale")
    return matrix


def _number(fields: Any, name: str, path: Path, index: int | None = None) -> float:
    value = fields.get(name) if isinstance(fields, dict) else None
    if not isinstance(value, int | float) or isinstance(value, bool) or not math.isfinite(value):
        where = "" if index is None else f" in frame {index}"
        raise ModelError(f"{path}: expected a number '{name}'{where}, found {value!r}; is it a dynamic scene's file?")
    return float(value)
