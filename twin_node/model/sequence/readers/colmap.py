"""COLMAP and images per time: a model in `sparse/` of one image per camera, and one folder of images per camera.

The registered image of a camera is called `<camera>.<ext>` or lies in `[...]/<camera>/`; the camera's images over time
lie in `[...]/<camera>/`, there or in `images/`, in order of their names (numbers in them by value), 30 per second.
Cameras must be undistorted.
"""

from __future__ import annotations

import re
import signal
import threading
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from twin_node.geometry import inverse_pose, pose, rotation_from_quat
from twin_node.model.parameters import ModelError
from twin_node.model.sequence.readers.colmap_files import check_whole
from twin_node.model.sequence.readers.options import NO_PINHOLE, ReadOptions, load_image, scaled_intrinsics, shrunk
from twin_node.model.sequence.recording import ColouredPoints, Recording, in_order, split, that_fit
from twin_node.picture_files import listed
from twin_node.scene import Camera, Float64, View

MODELS = ("sparse/0", "sparse_", "sparse")
"""Where the model may lie, the likeliest first."""
FRAME_NS = 1e9 / 30
"""Time between images, ns."""
IMAGES = (".png", ".jpg", ".jpeg")
MOST_SIGNS = 200
"""Of what pycolmap says of a model that it cannot read."""


def recognises(folder: Path) -> bool:
    """Whether a folder has this layout."""
    return bool(_model_folders(folder))


def read(folder: Path, options: ReadOptions) -> Recording:
    """Reads cameras, points and all images.

    Raises `ModelError` for a model that cannot be read, ends too early or is distorted, and for cameras without images
    or with images of different times.
    """
    model = _load_model(folder)
    files: dict[str, list[Path]] = {}
    images = sorted(model.images.values(), key=lambda image: str(image.name))
    for image in images:
        name = _camera_name(image)
        if name in files:
            raise ModelError(f"{folder}: expected one registered image per camera, found two of '{name}'; keep one")
        files[name] = _files(folder, image)
    _check_times(folder, files, options.frames)
    taken = {name: own[: options.frames] for name, own in files.items()}
    found = (view for image in images for view in _read_camera(folder, taken[_camera_name(image)], image, options))
    views = list(that_fit(str(folder), found))
    recording = Recording(str(folder), in_order(views), points=_points(model))
    return split(recording, options.hold_out or ())


def _model_folders(folder: Path) -> list[Path]:
    kinds = ("images.bin", "images.txt")
    return [folder / name for name in MODELS if any((folder / name / kind).is_file() for kind in kinds)]


def _load_model(folder: Path) -> Any:
    """A `pycolmap.Reconstruction`."""
    told_to_end = signal.getsignal(signal.SIGTERM)
    try:
        import pycolmap
    except ImportError:
        raise ModelError(f"{folder}: COLMAP's models are read by pycolmap: pip install twin-node[datasets]") from None
    if told_to_end is not None and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, told_to_end)  # which pycolmap takes over as it loads, to dump a trace and abort
    path = _model_folders(folder)[0]
    check_whole(path)
    try:
        model = pycolmap.Reconstruction(path)
        for image in model.images.values():
            _ = image.name  # which is no text in UTF-8 where another system gave it
        return model
    except (ValueError, RuntimeError, IndexError, MemoryError) as error:
        reason = str(error).strip().splitlines()[-1] if str(error).strip() else "damaged"
        raise ModelError(
            f"{path}: expected a model of COLMAP, found none that can be read ({reason[:MOST_SIGNS]}); export it again"
        ) from None


def _camera_name(image: Any) -> str:
    path = PurePosixPath(str(image.name))
    return path.parent.name or path.stem


def _files(folder: Path, image: Any) -> list[Path]:
    """All images of the camera of a registered one, in order of time."""
    path, name = PurePosixPath(str(image.name)), _camera_name(image)
    places = list(dict.fromkeys(root / own for own in (path.parent, name) for root in (folder / "images", folder)))
    for place in places:
        own = place.name == name and place.is_dir()
        files = [file for file in listed(place) if file.suffix.lower() in IMAGES] if own else []
        if files:
            return sorted(files, key=_in_time)
    looked = " or ".join(str(place) for place in places if place.name == name)
    raise ModelError(f"{folder}: expected images of camera '{name}' in {looked}, found none")


def _check_times(folder: Path, files: Mapping[str, list[Path]], frames: int | None) -> None:
    """Raises `ModelError` where, of the first `frames` images, those of one place in the order are of different times.

    Names that count images tell which is missing; of others, such as stamps, there must be as many of every camera.
    """
    numbers = {name: _counts(own)[:frames] for name, own in files.items()}
    counted = sorted({number for own in numbers.values() for number in own})
    steps = np.diff(counted)
    every = int(np.gcd.reduce(steps)) if len(steps) else 1
    are_counted = bool(counted) and counted[0] >= 0 and 2 * every * len(steps) >= counted[-1] - counted[0]
    for name, own in numbers.items():
        missing = sorted(set(counted) - set(own)) if are_counted else []
        if missing:
            raise ModelError(
                f"{folder}: expected images of the same numbers of every camera, found none of {name} with the number "
                f"{missing[0]}, which another camera has; complete the data set"
            )
    if len({len(own) for own in numbers.values()}) != 1:
        found = ", ".join(f"{len(own)} of {name}" for name, own in sorted(numbers.items())[:6]) or "no registered image"
        raise ModelError(f"{folder}: expected as many images of every camera, found {found}; complete the data set")


def _counts(files: Sequence[Path]) -> tuple[int, ...]:
    """The last number in the names of a camera's images that is not the same in all of them; -1 each for none.

    Behind it the name of the camera may stand, or a size.
    """
    numbers = ([int(number) for number in reversed(re.findall("[0-9]+", file.stem))] for file in files)
    columns = zip(*numbers, strict=False)  # from the last; not all names need have as many
    return next((column for column in columns if len(set(column)) > 1), (-1,) * len(files))


def _read_camera(folder: Path, files: list[Path], image: Any, options: ReadOptions) -> Iterator[View]:
    seen_by, name = image.camera, _camera_name(image)
    if not seen_by.is_undistorted() or any(kind in seen_by.model_name for kind in NO_PINHOLE):
        raise ModelError(
            f"{folder}: expected undistorted cameras, found {seen_by.model_name} for '{name}'; "
            "run colmap image_undistorter"
        )
    full_K = seen_by.calibration_matrix()
    if not (np.isfinite(full_K).all() and full_K[0, 0] > 0 and full_K[1, 1] > 0):
        raise ModelError(
            f"{folder}: expected a camera of '{name}' with a focal length above 0, found "
            f"{seen_by.params_info} = {np.asarray(seen_by.params).tolist()}; export the model again"
        )
    camera: Camera | None = None
    for index, file in enumerate(files):
        full = load_image(file)[..., :3]
        if full.shape[:2] != (seen_by.height, seen_by.width):
            raise ModelError(
                f"{file}: expected {seen_by.width}x{seen_by.height} as the model has it, found "
                f"{full.shape[1]}x{full.shape[0]}; undistort all images alike"
            )
        rgb = shrunk(full, options.width)
        if camera is None:
            K = scaled_intrinsics(full_K, (seen_by.width, seen_by.height), (rgb.shape[0], rgb.shape[1]))
            camera = Camera(name, rgb.shape[1], rgb.shape[0], K, _pose(image))
        yield View(camera, round(index * FRAME_NS), rgb)


def _in_time(file: Path) -> list[tuple[bool, int, str]]:
    """What images of one camera are ordered by: `frame_2.png` comes before `frame_10.png`."""
    parts = re.split(r"([0-9]+)", file.name)
    return [(part[:1].isdigit(), int(part) if part[:1].isdigit() else 0, part) for part in parts]


def _pose(image: Any) -> Float64:
    """[4, 4] camera to world; a quaternion of any length, as scripts write them, is a rotation."""
    moved = image.cam_from_world()
    quat = np.roll(np.asarray(moved.rotation.quat), 1)  # pycolmap has w last
    if not (0 < np.linalg.norm(quat) < np.inf and np.isfinite(moved.translation).all()):
        raise ModelError(f"{image.name}: expected a finite pose in the model's images, found none; export it again")
    return inverse_pose(pose(rotation_from_quat(quat), np.asarray(moved.translation)))


def _points(model: Any) -> ColouredPoints | None:
    points = [model.points3D[number] for number in sorted(model.points3D)]
    if not points:
        return None
    rgb = np.stack([np.asarray(point.color) for point in points]).astype(np.float32) / np.float32(255)
    return ColouredPoints(np.stack([np.asarray(point.xyz) for point in points]), rgb)
