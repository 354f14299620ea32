"""Finds a board in folders of videos and images, one camera each, with their stamps."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from twin_node.picture_files import listed, read_picture
from twin_node.rig.calibrate.boards import Board, Corners
from twin_node.rig.calibrate.intrinsics import BoardView
from twin_node.rig.calibrate.lenses import lens_of
from twin_node.rig.calibrate.tracks import CameraRecording
from twin_node.rig.errors import RigError
from twin_node.rig.stamps import StampsFile, read_shared_stamps, read_stamps
from twin_node.scene import Rig, UInt8, as_camera_name

IMAGE_SUFFIXES = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm"}
VIDEO_SUFFIXES = {".mp4", ".avi", ".mkv", ".mov", ".webm", ".m4v"}
STAMP_SUFFIXES = (".json", ".csv", ".txt")
"""Of a file beside a video that has the video's name: the capture times of its frames."""

SHARED_STAMPS = "timestamps.csv"
"""One file for all cameras, as caliscope writes it: columns cam_id, frame_time (s) and, in any order, others."""

LONGEST_PERIOD_S = 5.0
"""No video of a board that is moved has fewer frames: such stamps are not in seconds."""

STILL_PERIOD_NS = 1_000_000_000
"""Made-up time between stills, which have numbers and no stamps."""

LARGEST_NUMBER = 1_000_000_000
"""Larger numbers in names of stills count no images: they are times, of which nothing but the order is taken."""

SECONDS = r"\d{9,}\.\d+"
"""A time in a name of stills: seconds since 1970, with a fraction."""


@dataclass(frozen=True)
class Picture:
    """One image of a recording."""

    name: str
    grey: UInt8
    """[H, W]."""


@dataclass(frozen=True)
class BoardSearch:
    """What looking for a board in a camera's pictures gave."""

    size: tuple[int, int]
    """Width and height, pixels."""
    images: tuple[str, ...]
    found: tuple[Corners | None, ...]

    @property
    def views(self) -> tuple[BoardView, ...]:
        """The pictures with a board."""
        pairs = zip(self.images, self.found, strict=True)
        return tuple(BoardView(name, corners) for name, corners in pairs if corners is not None)


Progress = Callable[[], object]
"""Called after each picture."""


def find_in_pictures(board: Board, pictures: Iterator[Picture], source: str, progress: Progress | None) -> BoardSearch:
    """Looks for the board in every picture.

    `source` is named in errors. Raises `RigError` where there is no picture or their sizes differ.
    """
    size: tuple[int, int] | None = None
    images, found = [], []
    for picture in pictures:
        height, width = picture.grey.shape
        size = size or (width, height)
        if size != (width, height):
            raise RigError(
                f"{source}: expected pictures of one size, found {picture.name} of {width}x{height} after "
                f"{size[0]}x{size[1]}; calibrate each size by itself"
            )
        images.append(picture.name)
        found.append(board.detect(picture.grey))
        if progress is not None:
            progress()
    if size is None:
        raise RigError(f"{source}: expected at least one picture, found none")
    return BoardSearch(size, tuple(images), tuple(found))


def pictures_of(paths: Sequence[Path], every: int) -> Iterator[Picture]:
    """The pictures of images, videos and folders of them, every so many.

    Raises `RigError` for what is none of these or cannot be read.
    """
    for path in paths:
        if path.is_dir():
            inside = [p for p in listed(path) if p.suffix.lower() in IMAGE_SUFFIXES | VIDEO_SUFFIXES]
            yield from pictures_of(inside, every)
        elif path.suffix.lower() in VIDEO_SUFFIXES:
            yield from _Frames(path, every)
        else:
            yield _image(path)


def load_cameras(folder: Path, board: Board, every: int = 1, progress: Progress | None = None) -> list[CameraRecording]:
    """Looks for the board in a folder of recordings of one rig.

    Either one video per camera, with stamps in `timestamps.csv` or in a file of the video's name; or one folder of
    images per camera; or images whose names end in a number (`left01.png`) or a time: equal ones were taken at once.

    Raises `RigError` where the folder holds nothing of the kind, stamps are missing, or cameras would share a name.
    """
    if not folder.is_dir():
        raise RigError(f"{folder}: expected a folder of videos or images, found none; check the path")
    videos = [p for p in listed(folder) if p.suffix.lower() in VIDEO_SUFFIXES]
    if videos:
        _check_names(folder, [path.stem for path in videos])
        return [_video_camera(path, number, board, every, progress) for number, path in enumerate(videos)]
    stills = _stills(folder)
    if not stills:
        raise RigError(
            f"{folder}: expected one video per camera, one folder of images per camera, or images named like "
            "left01.png and right01.png; found none of these"
        )
    _check_names(folder, list(stills))
    return [_still_camera(name, numbered, board, progress) for name, numbered in stills.items()]


def with_lenses(cameras: Sequence[CameraRecording], rig: Rig) -> list[CameraRecording]:
    """The recordings with the lenses of a rig's cameras of the same names.

    Raises `RigError` where the rig has no such camera or its images are of another size.
    """
    known = {camera.name: camera for camera in rig.cameras}
    out = []
    for camera in cameras:
        if camera.name not in known:
            raise RigError(f"camera {camera.name}: expected its lens, found only those of {', '.join(known)}")
        lens = lens_of(known[camera.name])
        if (lens.width, lens.height) != camera.size:
            raise RigError(
                f"camera {camera.name}: expected a lens for {camera.size[0]}x{camera.size[1]}, found one for "
                f"{lens.width}x{lens.height}; use the calibration of this resolution"
            )
        out.append(replace(camera, lens=lens))
    return out


def _check_names(folder: Path, names: Sequence[str]) -> None:
    """Raises `RigError` where cameras whose recordings have these names would have one between them."""
    first: dict[str, str] = {}
    for name in names:
        camera = as_camera_name(name)
        if camera in first:
            raise RigError(
                f"{folder}: expected recordings that give each camera a name of its own, of letters, digits and _, "
                f"found {first[camera]} and {name}, both {camera}; rename one"
            )
        first[camera] = name


def _video_camera(path: Path, number: int, board: Board, every: int, progress: Progress | None) -> CameraRecording:
    stamps, frames = _video_stamps(path, number), _Frames(path, every)
    search = find_in_pictures(board, iter(frames), str(path), progress)
    if len(stamps) != frames.count:
        raise RigError(
            f"{path}: expected one stamp for each of its {frames.count} frames, found {len(stamps)}; "
            "these are the stamps of another video"
        )
    stamps = stamps[::every]
    if (np.diff(stamps) <= 0).any():
        raise RigError(f"{path}: expected rising stamps, found some that go back; sort them with their frames")
    if len(stamps) > 1 and (period_s := float(np.median(np.diff(stamps))) / 1e9 / every) > LONGEST_PERIOD_S:
        raise RigError(
            f"{path}: expected stamps in seconds, found {period_s:g} s from frame to frame; write them in seconds "
            "(milliseconds divided by 1000)"
        )
    return CameraRecording(as_camera_name(path.stem), search.size, stamps, search.images, search.found)


def _video_stamps(path: Path, number: int) -> NDArray[np.int64]:
    """Stamps, ns, of a video's frames; `number`: its place among the folder's videos."""
    for suffix in STAMP_SUFFIXES:
        beside = path.with_suffix(suffix)
        if beside.is_file():
            return read_stamps(StampsFile(beside, key="timestamps" if suffix == ".json" else None))
    shared = path.parent / SHARED_STAMPS
    if not shared.is_file():
        raise RigError(
            f"{path}: expected stamps in {path.stem}{{{','.join(STAMP_SUFFIXES)}}} or {SHARED_STAMPS}, found neither; "
            "cameras that run free cannot be paired without"
        )
    ending = re.search(r"\d+$", path.stem)
    return read_shared_stamps(shared, str(int(ending.group()) if ending else number))


def _stills(folder: Path) -> dict[str, dict[int, Path]]:
    """Images by camera and number, or place among all times that images are named by."""
    cameras: dict[str, dict[int, Path]] = {}
    inner = [path for path in listed(folder) if path.is_dir()]
    for path in listed(folder):
        match = re.fullmatch(rf"(.*?)[_-]?({SECONDS}|\d+)", path.stem)
        if path.suffix.lower() in IMAGE_SUFFIXES and match and match.group(1):
            _add_still(cameras.setdefault(match.group(1), {}), match.group(2), path)
    for directory in inner:
        for path in listed(directory):
            number = re.search(rf"({SECONDS}|\d+)$", path.stem)
            if path.suffix.lower() in IMAGE_SUFFIXES and number:
                _add_still(cameras.setdefault(directory.name, {}), number.group(), path)
    numbers = sorted({number for numbered in cameras.values() for number in numbered})
    if not numbers or numbers[-1] <= LARGEST_NUMBER:
        return cameras
    places = {number: place for place, number in enumerate(numbers)}
    return {name: {places[n]: path for n, path in numbered.items()} for name, numbered in cameras.items()}


def _add_still(numbered: dict[int, Path], number: str, path: Path) -> None:
    """Raises `RigError` where another image of the camera has the number: one of them would be lost."""
    other = numbered.setdefault(_number(number), path)
    if other != path:
        raise RigError(
            f"{path}: expected images of one camera with distinct numbers, found that of {other.name} too; number them "
            "anew, or put each camera's into a folder of its own"
        )


def _number(text: str) -> int:
    """A still's number; of a time in seconds with a fraction nanoseconds."""
    whole, _, fraction = text.partition(".")
    return int(whole + fraction.ljust(9, "0")[:9]) if fraction else int(whole)


def _still_camera(name: str, numbered: dict[int, Path], board: Board, progress: Progress | None) -> CameraRecording:
    numbers = sorted(numbered)
    pictures = (_image(numbered[number]) for number in numbers)
    search = find_in_pictures(board, pictures, f"camera {name}", progress)
    stamps = np.array(numbers, dtype=np.int64) * STILL_PERIOD_NS
    return CameraRecording(as_camera_name(name), search.size, stamps, search.images, search.found, moving=False)


class _Frames:
    """Every so many frames of a video. Raises `RigError` where it, or one of these, cannot be read."""

    def __init__(self, path: Path, every: int) -> None:
        self._path, self._every = path, every
        self.count = 0
        """Of all frames, those left out too, up to where reading has come."""

    def __iter__(self) -> Iterator[Picture]:
        path, video = self._path, cv2.VideoCapture(str(self._path))
        if not video.isOpened():
            raise RigError(f"{path}: expected a video, found nothing that can be read; check the file")
        while video.grab():
            number, self.count = self.count, self.count + 1
            if number % self._every:
                continue
            decoded, image = video.retrieve()
            if not decoded:
                raise RigError(f"{path}: expected frames that can be decoded, found none at {number}; copy it again")
            yield Picture(f"{path.name} frame {number}", np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8))
        video.release()


def _image(path: Path) -> Picture:
    image = read_picture(path, cv2.IMREAD_GRAYSCALE) if path.is_file() else None
    if image is None:
        raise RigError(f"{path}: expected an image or a video, found nothing that can be read; check the path")
    return Picture(path.name, np.asarray(image, np.uint8))
