"""A made-up recording of a board before three cameras, the truth beside it: to try a calibration without a cell."""

from __future__ import annotations

import errno
import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from twin_node.geometry import inverse_pose, looking_at, pose
from twin_node.rig.calibrate.board_prints import BoardPrint, draw_board
from twin_node.rig.calibrate.boards import CharucoBoard
from twin_node.rig.calibrate.lenses import camera_matrix, pixel_rays
from twin_node.rig.errors import RigError
from twin_node.rig.rig_file import RigFile, save_rig
from twin_node.scene import Float32, Float64, Rig, RigCamera, UInt8
from twin_node.unfinished import partial_of, taken

BOARD = CharucoBoard(6, 5, 0.06, 0.045)
"""A sheet of A2: seen well from one and a half metres by small images."""
PIXELS_PER_M = 2000.0
"""Of the drawing that images are taken from."""
WIDTH, HEIGHT, FOCAL_PX = 640, 480, 560.0
DISTORTION = (0.06, -0.12, 0.001, -0.0005, 0.0)
"""Of all lenses, plumb bob: those of small colour cameras."""
DISTANCE_M, SIDES_DEG, HEIGHTS_M = 1.3, (-50.0, 0.0, 50.0), (0.7, 1.1, 0.8)
"""Where the cameras stand about the middle of the board at rest, and how high."""
OFFSETS_S = (0.0, 0.018, -0.011)
"""Of the cameras' clocks."""
RATE_HZ, MOVES_S, RESTS_S = 10.0, 18.0, 2.0
"""The board is moved about, and then lies on the base."""
PREVIEW, PREVIEW_AT_S = "preview.jpg", 5.0
NOISE = 2.0
"""1 sigma of the images' noise, 8-bit levels."""
GRAIN_PX = 64
"""Each image takes its noise from another place of one field, up to so many pixels away: drawing it anew is slow."""
GREY = 120
"""What is behind the board."""

Progress = Callable[[int], object]


@dataclass(frozen=True)
class Rehearsal:
    """What was written."""

    cameras: int
    images: int
    rests_at_s: float
    """When the board lies still on the base, s after the start."""


def rehearse(folder: Path, progress: Progress = lambda images: None) -> Rehearsal:
    """Writes videos, their stamps, `board.yaml`, a preview and the truth, `truth.yaml`, to a new folder.

    The truth's base is the board at rest: x along its rows, z up. The folder gets its name when all is in it. Raises
    `RigError` where it, or NAME.partial, which it is until then, exists already or cannot be made.
    """
    if folder.exists():
        raise RigError(f"{folder}: cannot be made (it is there); give a folder that does not exist yet")
    partial = partial_of(folder)
    try:
        partial.mkdir(parents=True)
    except FileExistsError:
        raise RigError(taken(folder)) from None
    except OSError as error:
        raise _refused(folder, error) from None
    try:
        made = _written(partial, progress)
        partial.rename(folder)
    except OSError as error:
        shutil.rmtree(partial, ignore_errors=True)
        raise _refused(folder, error) from None
    except BaseException:  # whatever ended it: half of a recording is none
        shutil.rmtree(partial, ignore_errors=True)
        raise
    return made


def _refused(folder: Path, error: OSError) -> RigError:
    return RigError(f"{folder}: cannot be made ({error.strerror}); free space or choose another place")


def _written(folder: Path, progress: Progress) -> Rehearsal:
    drawing = draw_board(BOARD)
    sheet = _sheet(drawing)
    cameras = _cameras()
    times = np.arange(round((MOVES_S + RESTS_S) * RATE_HZ)) / RATE_HZ
    previews = []
    for camera, offset in zip(cameras, OFFSETS_S, strict=True):
        previews.append(_film(folder, camera, times + offset, sheet, drawing, progress))
        stamps = {"timestamps": (times + 1.0).tolist()}  # what the camera's own clock says
        (folder / f"{camera.name}.json").write_text(json.dumps(stamps), encoding="utf-8")
    board = {"kind": "charuco", "columns": BOARD.columns, "rows": BOARD.rows, "square": BOARD.square}
    board |= {"marker": BOARD.marker, "dictionary": BOARD.dictionary}
    (folder / "board.yaml").write_text(yaml.safe_dump(board, sort_keys=False), encoding="utf-8")
    (folder / PREVIEW).write_bytes(cv2.imencode(Path(PREVIEW).suffix, np.hstack(previews))[1].tobytes())
    truth = RigFile(Rig(cameras), notes="What the rehearsal was made with.", board=str(BOARD))
    save_rig(truth, folder / "truth.yaml")
    return Rehearsal(len(cameras), len(cameras) * len(times), MOVES_S + RESTS_S / 2)


def _cameras() -> tuple[RigCamera, ...]:
    K = camera_matrix(FOCAL_PX, FOCAL_PX, (WIDTH - 1) / 2, (HEIGHT - 1) / 2)
    cameras = []
    for name, side, height, offset in zip(("left", "middle", "right"), SIDES_DEG, HEIGHTS_M, OFFSETS_S, strict=True):
        angle = np.radians(side - 90)
        centre = _middle() + np.array([DISTANCE_M * np.cos(angle), DISTANCE_M * np.sin(angle), height])
        T = looking_at(centre, _middle() + np.array([0, 0, 0.25]))
        cameras.append(
            RigCamera(name, WIDTH, HEIGHT, K, T, "plumb_bob", np.array(DISTORTION), 0.0, round(offset * 1e9))
        )
    return tuple(cameras)


def _middle() -> Float64:
    """[3] the middle of the board at rest, in the base, whose y runs against the board's rows."""
    return np.asarray(BOARD.points.mean(axis=0) * [1.0, -1.0, 1.0])


def _course(second: float) -> Float64:
    """`T_base_board` [4, 4]: waved about above the base, tilted to all sides, then laid down."""
    left = float(np.clip((MOVES_S - second) / 1.5, 0, 1))  # the last second and a half lay it down
    lifted = left**2 * (3 - 2 * left)
    middle = np.diag([1.0, -1.0, -1.0])
    wave = 2 * np.pi * second * np.array([0.11, 0.07, 0.13])
    tilt = lifted * np.array([0.75 + 0.45 * np.sin(wave[1]), 0.5 * np.sin(wave[0]), 0.5 * np.sin(wave[2])])
    R = Rotation.from_rotvec(tilt).as_matrix() @ middle
    shift = lifted * np.array([0.25 * np.sin(wave[0]), 0.2 * np.sin(wave[2]), 0.35 + 0.15 * np.sin(wave[1])])
    return pose(R, _middle() + shift - R @ BOARD.points.mean(axis=0))


def _film(
    folder: Path, camera: RigCamera, times: Float64, sheet: UInt8, drawing: BoardPrint, progress: Progress
) -> UInt8:
    """Writes the camera's video; `times` [T]: when its images are taken, s. Returns one image at half size."""
    path, fourcc = folder / f"{camera.name}.mp4", cv2.VideoWriter.fourcc(*"mp4v")
    video = cv2.VideoWriter(str(path), fourcc, RATE_HZ, (WIDTH, HEIGHT))
    rng = np.random.default_rng(len(camera.name))
    grain = rng.normal(0, NOISE, (HEIGHT + GRAIN_PX, WIDTH + GRAIN_PX)).astype(np.float32)
    preview: UInt8 = np.zeros((HEIGHT // 2, WIDTH // 2), np.uint8)
    v, u = np.mgrid[:HEIGHT, :WIDTH].astype(np.float64)
    flat = pixel_rays(camera, np.column_stack([u.ravel(), v.ravel()]))
    rays: Float32 = flat.reshape(HEIGHT, WIDTH, 2).astype(np.float32)
    for second in times:
        image = _picture(rays, inverse_pose(camera.T_base_cam) @ _course(float(second)), sheet, drawing)
        x, y = rng.integers(0, GRAIN_PX, 2)
        noisy = cv2.add(image, grain[y : y + HEIGHT, x : x + WIDTH], dtype=cv2.CV_8U)
        video.write(cv2.cvtColor(noisy, cv2.COLOR_GRAY2BGR))
        progress(1)
        if abs(second - PREVIEW_AT_S) < 0.5 / RATE_HZ:
            preview = np.asarray(cv2.resize(noisy, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), np.uint8)
    video.release()
    _check_whole(path, len(times))
    return preview


def _check_whole(video: Path, images: int) -> None:
    """Raises `OSError` where a video lacks images, as on a full disk: who wrote it does not tell."""
    written = cv2.VideoCapture(str(video))
    found = int(written.get(cv2.CAP_PROP_FRAME_COUNT)) if written.isOpened() else 0
    written.release()
    if found != images:
        raise OSError(errno.ENOSPC, f"{video.name} took {found} of {images} images")


def _picture(rays: Float32, T_cam_board: Float64, sheet: UInt8, drawing: BoardPrint) -> UInt8:
    """[H, W] what rays [H, W, 2] (x/z, y/z) see of the board: they and its plane are a homography apart."""
    T = inverse_pose(T_cam_board)
    # A ray (x, y, 1) meets the plane z = 0 after -T[2, 3] / (its z on the board's axes).
    on_board = -T[2, 3] * T[:2, :3] + (T[:2, 3] + drawing.margin)[:, None] * T[2, :3]
    to_sheet = np.vstack([on_board * PIXELS_PER_M - 0.5 * T[2, :3], T[2, :3]])
    places = np.asarray(cv2.perspectiveTransform(rays, to_sheet), np.float32)
    away = (rays @ T[2, :2].astype(np.float32) + np.float32(T[2, 2])) * np.float32(T[2, 3]) >= 0
    places[away] = -1e4
    x, y = cv2.split(places)
    seen = cv2.remap(sheet, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=(GREY,))
    return np.asarray(seen, np.uint8)


def _sheet(drawing: BoardPrint) -> UInt8:
    """The board and its margin as an image, blurred as far as a pixel of the cameras is wide."""
    scale = PIXELS_PER_M
    size = np.array([drawing.height, drawing.width]) + 2 * drawing.margin
    image = np.full(np.round(size * scale).astype(int), 255, np.uint8)
    for x, y, edge in drawing.squares:
        a, b = np.round((np.array([[x, y], [x + edge, y + edge]]) + drawing.margin) * scale).astype(int)
        image[a[1] : b[1], a[0] : b[0]] = 0
    for tile in drawing.tiles:
        x, y = np.round((np.array(tile.corner) + drawing.margin) * scale).astype(int)
        side = round(tile.edge * scale)
        image[y : y + side, x : x + side] = cv2.resize(tile.modules, (side, side), interpolation=cv2.INTER_NEAREST)
    blur = 0.5 * scale * DISTANCE_M / FOCAL_PX
    return np.asarray(cv2.GaussianBlur(image, (0, 0), blur), np.uint8)
