"""COLMAP and images per time: a model in `sparse/` of one image per camera, and one folder of images per camera.

The registered image of a camera is called `<camera>.<ext>` or lies in `<camera>/`; the camera's images over time lie in
`<camera>/` or `images/<camera>/`, in order of their names (numbers in them by value), 30 per second. Cameras must be
undistorted.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from twin_node.geometry import inverse_pose
from twin_node.model.parameters import ModelError
from twin_node.model.sequence.readers.colmap_files import check_whole
from twin_node.model.sequence.readers.options import ReadOptions, load_image, scaled_intrinsics, shrunk
from twin_node.model.sequence.recording import ColouredPoints, Recording, in_order, split
from twin_node.scene import Camera, Float64, View

MODELS = ("sparse/0", "sparse_", "sparse")
"""Where the model may lie, the likeliest first."""
FRAME_NS = 1e9 / 30
"""Time between images, ns."""
IMAGES = (".png", ".jpg", ".jpeg")


def recognises(folder: Path) -> bool:
    """Whether a folder has this layout."""
    return bool(_model_folders(folder))


def read(folder: Path, options: ReadOptions) -> Recording:
    """Reads cameras, points and all images.

    Raises `ModelError` for a model that cannot be read, ends too early or is distorted, and for cameras without images
    or with different numbers of them.
    """
    model = _load_model(folder)
    views: list[View] = []
    counts: dict[str, int] = {}
    for image in sorted(model.images.values(), key=lambda image: str(image.name)):
        name = _camera_name(str(image.name))
        if name in counts:
            raise ModelError(f"{folder}: expected one registered image per camera, found two of '{name}'; keep one")
        own = _read_camera(folder, name, image, options)
        counts[name] = len(own)
        views += own
    if len(set(counts.values())) != 1:
        found = ", ".join(f"{count} of {name}" for name, count in sorted(counts.items())[:6]) or "no registered image"
        raise ModelError(f"{folder}: expected as many images of every camera, found {found}; complete the data set")
    recording = Recording(str(folder), in_order(views), points=_points(model))
    return split(recording, options.hold_out or ())


def _model_folders(folder: Path) -> list[Path]:
    kinds = ("images.bin", "images.txt")
    return [folder / name for name in MODELS if any((folder / name / kind).is_file() for kind in kinds)]


def _load_model(folder: Path) -> Any:
    """A `pycolmap.Reconstruction`."""
    try:
        import pycolmap
    except ImportError:
        raise ModelError(f"{folder}: COLMAP's models are read by pycolmap: pip install twin-node[datasets]") from None
    path = _model_folders(folder)[0]
    check_whole(path)
    try:
        return pycolmap.Reconstruction(path)
    except (ValueError, RuntimeError, IndexError, MemoryError) as error:
        reason = str(error).strip().splitlines()[-1] if str(error).strip() else "damaged"
        raise ModelError(f"{path}: expected a model of COLMAP, found none that can be read ({reason})") from None


def _camera_name(image: str) -> str:
    path = Path(image)
    return path.parent.name or path.stem


def _read_camera(folder: Path, name: str, image: Any, options: ReadOptions) -> list[View]:
    seen_by = image.camera
    if not seen_by.is_undistorted():
        raise ModelError(
            f"{folder}: expected undistorted cameras, found {seen_by.model_name} for '{name}'; "
            "run colmap image_undistorter"
        )
    places = [folder / "images" / name, folder / name]
    place = next((place for place in places if place.is_dir()), None)
    files = sorted((path for path in place.iterdir() if path.suffix.lower() in IMAGES), key=_in_time) if place else []
    if not files:
        raise ModelError(f"{folder}: expected images of camera '{name}' in {places[0]} or {places[1]}, found none")
    camera: Camera | None = None
    views = []
    for index, file in enumerate(files[: options.frames]):
        full = load_image(file)[..., :3]
        if full.shape[:2] != (seen_by.height, seen_by.width):
            raise ModelError(
                f"{file}: expected {seen_by.width}x{seen_by.height} as the model has it, found "
                f"{full.shape[1]}x{full.shape[0]}; undistort all images alike"
            )
        rgb = shrunk(full, options.width)
        if camera is None:
            K = scaled_intrinsics(
                seen_by.calibration_matrix(), (seen_by.width, seen_by.height), (rgb.shape[0], rgb.shape[1])
            )
            camera = Camera(name, rgb.shape[1], rgb.shape[0], K, _pose(image))
        views.append(View(camera, round(index * FRAME_NS), rgb))
    return views


def _in_time(file: Path) -> list[tuple[bool, int, str]]:
    """What images of one camera are ordered by: `frame_2.png` comes before `frame_10.png`."""
    parts = re.split(r"([0-9]+)", file.name)
    return [(part[:1].isdigit(), int(part) if part[:1].isdigit() else 0, part) for part in parts]


def _pose(image: Any) -> Float64:
    viewmat = np.eye(4)
    viewmat[:3] = image.cam_from_world().matrix()
    return inverse_pose(viewmat)


def _points(model: Any) -> ColouredPoints | None:
    points = [model.points3D[number] for number in sorted(model.points3D)]
    if not points:
        return None
    rgb = np.stack([np.asarray(point.color) for point in points]).astype(np.float32) / np.float32(255)
    return ColouredPoints(np.stack([np.asarray(point.xyz) for point in points]), rgb)
