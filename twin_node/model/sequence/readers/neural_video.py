"""Neural 3D Video (Li et al., CVPR 2022): `poses_bounds.npy` in LLFF's convention beside `cam00.mp4`, `cam01.mp4`, ...

The first camera is held out unless told otherwise, as published. Stamps count frames at the videos' own rate from 0;
what comes after the first of the videos has ended is left out.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from tokenize import TokenError

import cv2
import numpy as np

from twin_node.geometry import pose
from twin_node.model.parameters import ModelError
from twin_node.model.sequence.readers.options import ReadOptions, refuse_other_shape, scaled_intrinsics, shrunk
from twin_node.model.sequence.recording import Recording, in_order, split, that_fit
from twin_node.scene import Camera, Float64, View

POSES = "poses_bounds.npy"
SPARE_FRAMES = 1
"""Frames that a video may announce and not have: containers round its length."""


def recognises(folder: Path) -> bool:
    """Whether a folder has this layout."""
    return (folder / POSES).is_file()


def read(folder: Path, options: ReadOptions) -> Recording:
    """Reads all videos of a scene.

    Raises `ModelError` for poses that are not [cameras, 17], that are as many as the videos are not, or that are no
    poses, and for videos that cannot be decoded to their end or have another shape than the images of their pose.
    """
    videos = sorted(folder.glob("cam*.mp4"))
    rows = _load_poses(folder / POSES)
    if len(videos) != len(rows):
        raise ModelError(
            f"{folder / POSES}: expected one row per video, found {len(rows)} rows and {len(videos)} videos cam*.mp4; "
            "complete the data set"
        )
    found = (view for video, row in zip(videos, rows, strict=True) for view in _read_video(video, row, options))
    views = list(that_fit(str(folder), found))
    end = min(_end([view.stamp for view in views if view.camera.name == video.stem]) for video in videos)
    recording = Recording(str(folder), in_order(view for view in views if view.stamp <= end))
    return split(recording, (videos[0].stem,) if options.hold_out is None else options.hold_out)


def _load_poses(path: Path) -> Float64:
    try:
        with path.open("rb") as file:
            rows: Float64 = np.lib.format.read_array(file, allow_pickle=False)
    except (OSError, ValueError, MemoryError, OverflowError, TokenError):  # the last three of damaged headers
        raise ModelError(f"{path}: expected a NumPy array, found another kind of file; take it from LLFF") from None
    if rows.ndim != 2 or rows.shape[1] != 17 or rows.dtype.kind != "f" or not len(rows) or not np.isfinite(rows).all():
        raise ModelError(
            f"{path}: expected finite numbers [cameras, 17], found {rows.dtype} {list(rows.shape)}; take it from LLFF"
        )
    return rows.astype(np.float64)


def _end(stamps: Sequence[int]) -> float:
    """Until when a video with frames at such stamps (rising, ns) shows anything: half a frame after its last.

    Videos of one length whose rates differ a little end together so.
    """
    return stamps[-1] + (stamps[-1] - stamps[0]) / max(len(stamps) - 1, 1) / 2


def _read_video(path: Path, row: Float64, options: ReadOptions) -> Iterator[View]:
    """The frames of one camera; `row` [17] holds [3, 5] of axes down, right, back, position, (height, width, focal)."""
    matrix = row[:15].reshape(3, 5)
    rotation = np.stack([matrix[:, 1], matrix[:, 0], -matrix[:, 2]], axis=1)
    with np.errstate(over="ignore", invalid="ignore"):
        turns = np.abs(rotation.T @ rotation - np.eye(3)).max() < 1e-3 and np.linalg.det(rotation) > 0
    if not turns or (matrix[:, 4] <= 0).any():
        raise ModelError(f"{path.parent / POSES}: the row of {path.name} is no pose with a focal length; rerun LLFF")
    height, width, focal = matrix[:, 4]
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    capture = cv2.VideoCapture(str(path))
    rate, claimed = capture.get(cv2.CAP_PROP_FPS), int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
    camera: Camera | None = None
    count = 0
    try:
        while options.frames is None or count < options.frames:
            ok, image = capture.read()
            if not ok:
                break
            rgb = shrunk(cv2.cvtColor(image, cv2.COLOR_BGR2RGB).astype(np.uint8), options.width)
            if camera is None:
                refuse_other_shape(
                    f"{path.parent / POSES}: {path.name}", (width, height), (image.shape[0], image.shape[1])
                )
                scaled = scaled_intrinsics(K, (width, height), (rgb.shape[0], rgb.shape[1]))
                camera = Camera(path.stem, rgb.shape[1], rgb.shape[0], scaled, pose(rotation, matrix[:, 3]))
            yield View(camera, round(count * 1e9 / rate) if rate > 0 else 0, rgb)
            count += 1
    finally:
        capture.release()
    if not count or not math.isfinite(rate) or rate <= 0:
        raise ModelError(f"{path}: expected frames at a known rate, found {count} at {rate} Hz; copy the video again")
    wanted = claimed if options.frames is None else min(claimed, options.frames)
    if count < wanted - SPARE_FRAMES:  # or all other videos would be cut down to it
        raise ModelError(
            f"{path}: expected {claimed} frames, as it says, only the first {count} can be decoded; copy it "
            "again, or take fewer with --frames"
        )
