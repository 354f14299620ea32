"""Boards seen by made-up cameras: as pictures, and as corners with noise."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from twin_node.geometry import inverse_pose, looking_at, pose, transform
from twin_node.rig.calibrate.april_grid import AprilGrid
from twin_node.rig.calibrate.boards import Board, CharucoBoard, Chessboard, CircleGrid, Corners
from twin_node.rig.calibrate.lenses import Lens, pixel_rays, project
from twin_node.rig.calibrate.tracks import CameraRecording
from twin_node.scene import Float64, UInt8

CELL = 84
"""Texture pixels per square, tag cell row or dot distance."""


@dataclass(frozen=True)
class Texture:
    """A board's picture; texture pixel = scale * (board point - origin)."""

    image: UInt8
    scale: Float64
    """[2] pixels per metre; y is negative where the board's y runs up."""
    origin: Float64
    """[2] board point of the top-left pixel's centre, m."""


def texture_of(board: Board) -> Texture:
    if isinstance(board, Chessboard):
        i, j = np.mgrid[: board.rows + 1, : board.columns + 1]
        squares = np.where((i + j) % 2 == 0, 0, 255).astype(np.uint8)
        image = np.pad(np.kron(squares, np.ones((CELL, CELL), np.uint8)), CELL, constant_values=255)
        scale = CELL / board.square
        return Texture(image, np.array([scale, scale]), np.full(2, (-2 * CELL + 0.5) / scale))
    if isinstance(board, CharucoBoard):
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
        drawn = cv2.aruco.CharucoBoard((board.columns, board.rows), board.square, board.marker, dictionary)
        image = drawn.generateImage((board.columns * CELL, board.rows * CELL))
        image = np.pad(255 - image if board.inverted else image, CELL, constant_values=0 if board.inverted else 255)
        scale = CELL / board.square
        return Texture(image, np.array([scale, scale]), np.full(2, (-CELL + 0.5) / scale))
    if isinstance(board, CircleGrid):
        scale = CELL / board.spacing
        points = np.rint((board.points[:, :2] * scale + CELL) * 16).astype(int)
        size = (board.points[:, :2].max(axis=0) * scale + 2 * CELL).astype(int)
        image = np.full(size[::-1], 255, np.uint8)
        for point in points:
            cv2.circle(image, point.tolist(), 16 * CELL // 4, 0, -1, cv2.LINE_AA, 4)
        return Texture(image, np.array([scale, scale]), np.full(2, -CELL / scale))
    assert isinstance(board, AprilGrid)
    return _aprilgrid(board)


def _aprilgrid(board: AprilGrid, border: int = 2) -> Texture:
    """As Kalibr prints it: frames two cells wide, black squares between the tags' corners."""
    edge = (6 + 2 * border) * 8
    gap = round(edge * board.spacing)
    width, height = (count * (edge + gap) + 3 * gap for count in (board.columns, board.rows))
    image = np.full((height, width), 255, np.uint8)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    for number in range(board.columns * board.rows):
        row, column = divmod(number, board.columns)
        x, y = 2 * gap + column * (edge + gap), height - 2 * gap - row * (edge + gap) - edge
        image[y : y + edge, x : x + edge] = cv2.aruco.generateImageMarker(dictionary, number, edge, borderBits=border)
        for dx in (-gap, edge):
            for dy in (-gap, edge):
                image[y + dy : y + dy + gap, x + dx : x + dx + gap] = 0
    scale = edge / board.tag
    origin = np.array([(-2 * gap + 0.5) / scale, (height - 2 * gap - 0.5) / scale])
    return Texture(image, np.array([scale, -scale]), origin)


@cache
def blurred_texture_of(board: Board) -> Texture:
    """A board's picture as blurred as lenses leave it."""
    texture = texture_of(board)
    return replace(texture, image=cv2.GaussianBlur(texture.image, (0, 0), 1.5))


@cache
def rays_of_all_pixels(width: int, height: int, model: str, parameters: tuple[float, ...]) -> Float64:
    """[width * height, 3] rays (x/z, y/z, 1), row by row, of a lens."""
    lens = Lens(width, height, np.eye(3), model, np.zeros(0)).with_parameters(np.array(parameters))
    v, u = np.mgrid[:height, :width].astype(np.float64)
    rays = pixel_rays(lens, np.stack([u.ravel(), v.ravel()], axis=1))
    return np.concatenate([rays, np.ones((len(rays), 1))], axis=1)


def picture(board: Board, lens: Lens, T_cam_board: Float64, noise: float = 2.0) -> UInt8:
    """What a camera sees of a board in front of grey."""
    texture = blurred_texture_of(board)
    rays = rays_of_all_pixels(lens.width, lens.height, lens.distortion_model, tuple(lens.parameters.tolist()))
    T = inverse_pose(T_cam_board)
    origin, directions = T[:3, 3], rays @ T[:3, :3].T
    on_board = origin + directions * (-origin[2] / directions[:, 2])[:, None]
    at = ((on_board[:, :2] - texture.origin) * texture.scale).astype(np.float32).reshape(lens.height, lens.width, 2)
    seen = cv2.remap(texture.image, at, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=(128,))
    rng = np.random.default_rng(0)
    return np.clip(seen + rng.normal(0, noise, seen.shape), 0, 255).astype(np.uint8)


def a_lens(model: str = "plumb_bob", width: int = 640, height: int = 480, focal: float = 520.0) -> Lens:
    K = np.array([[focal, 0.0, width / 2 + 6.0], [0.0, focal * 1.001, height / 2 - 5.0], [0.0, 0.0, 1.0]])
    D = {
        "plumb_bob": [-0.25, 0.08, 0.001, -0.0005, 0.0],
        "rational_polynomial": [0.2, -0.1, 0.0005, 0.001, 0.02, 0.5, -0.05, 0.03],
        "equidistant": [0.02, -0.01, 0.004, -0.002],
    }
    return Lens(width, height, K, model, np.array(D[model]))


def around(count: int, radius: float = 2.0, arc: float = 1.2) -> list[Float64]:
    """`T_base_cam` of cameras on an arc that look at the middle from above."""
    angles = np.linspace(-arc, arc, count)
    centres = np.stack([radius * np.cos(angles) * 0.8, radius * np.sin(angles) * 0.8, np.full(count, 0.6 * radius)], 1)
    return [looking_at(centre, np.zeros(3)) for centre in centres]


def waved(seconds: float, phase: float = 0.0) -> Float64:
    """`T_base_board` of a board that somebody waves about the middle, its face up; smooth in time."""
    a, b, c = np.sin(0.9 * seconds + phase), np.sin(0.7 * seconds + 1.0 + phase), np.sin(1.1 * seconds + 2.0)
    turn = Rotation.from_euler("xyz", [np.pi + 0.5 * a, 0.5 * b, 0.6 * c]).as_matrix()
    return pose(turn, np.array([0.25 * b, 0.25 * c, 0.1 + 0.15 * a]))


def seen_corners(board: Board, lens: Lens, T_cam_board: Float64) -> Corners | None:
    """The corners inside the image, without noise."""
    places = transform(T_cam_board, board.points)
    pixels = project(lens, places).pixels
    inside = ((pixels > 5) & (pixels < [lens.width - 6, lens.height - 6])).all(axis=1)
    before = places[:, 2].min() > 0.05
    return Corners(np.flatnonzero(inside), pixels[inside]) if before and inside.any() else None


@dataclass(frozen=True)
class Spoiled:
    """What is wrong with a recording."""

    noise_px: float = 0.2
    outliers: float = 0.0
    """Share of images whose corners are off by many pixels."""
    clock_s: float = 0.0
    """What the camera's stamps lack."""
    rate_ppm: float = 0.0
    """By how much its clock runs slow."""
    readout_s: float = 0.0
    """From its first row to its last."""


def _row_by_row(
    board: Board, lens: Lens, T_cam_base: Float64, corners: Corners, seconds: float, readout_s: float
) -> Corners:
    """The corners where the waved board has taken them when their rows are exposed, the middle one at a time."""
    if not readout_s:
        return corners
    pixels = corners.pixels.copy()
    for number, corner in enumerate(corners.ids):
        lag = ((pixels[number, 1] + 0.5) / lens.height - 0.5) * readout_s
        place = transform(T_cam_base @ waved(seconds + lag), board.points[corner : corner + 1])
        pixels[number] = project(lens, place).pixels[0]
    return Corners(corners.ids, pixels)


def record(
    board: Board,
    lens: Lens,
    T_base_cam: Float64,
    name: str,
    rng: np.random.Generator,
    spoiled: Spoiled | None = None,
    seconds: float = 12.0,
    rate_hz: float = 10.0,
    rests_at_s: float = np.inf,
    pace: float = 1.0,
) -> CameraRecording:
    """A video of the waved board, which is held still from a time on, with the stamps of the camera's own clock.

    `pace`: how much faster than usual it is waved.
    """
    spoiled = spoiled or Spoiled()
    times = np.arange(0, seconds, 1 / rate_hz) + rng.uniform(0, 1 / rate_hz)
    found: list[Corners | None] = []
    for time in times.tolist():
        T, at = inverse_pose(T_base_cam), pace * min(time, rests_at_s)
        corners = seen_corners(board, lens, T @ waved(at))
        if corners is not None:
            corners = _row_by_row(board, lens, T, corners, at, pace * spoiled.readout_s)
            noise = rng.normal(0, spoiled.noise_px, corners.pixels.shape)
            if rng.uniform() < spoiled.outliers:
                noise += rng.normal(0, 15, 2) + rng.normal(0, 3, corners.pixels.shape)
            corners = Corners(corners.ids, corners.pixels + noise)
        found.append(corners)
    stamps = np.rint((times * (1 - spoiled.rate_ppm * 1e-6) - spoiled.clock_s + 100) * 1e9).astype(np.int64)
    names = tuple(f"frame {i}" for i in range(len(times)))
    return CameraRecording(name, (lens.width, lens.height), stamps, names, tuple(found))
