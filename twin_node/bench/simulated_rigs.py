"""Made-up rigs that record a board in somebody's hands, with all that is wrong with real ones, and the truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from twin_node.geometry import inverse_pose, looking_at, pose, transform
from twin_node.rig.calibrate.boards import CharucoBoard, Corners
from twin_node.rig.calibrate.lenses import Lens, project
from twin_node.rig.calibrate.tracks import CameraRecording
from twin_node.scene import Float64

BOARD = CharucoBoard(9, 7, 0.08, 0.06)
"""A board on a sheet of A1: the largest that hands can wave, and what is seen well from two metres."""

START_NS = 1_700_000_000_000_000_000
"""Stamp of the beginning: clocks of real recordings count from 1970."""


@dataclass(frozen=True)
class RigSpread:
    """What rigs are drawn from, evenly unless said otherwise."""

    cameras: tuple[int, int] = (3, 6)
    distance_m: tuple[float, float] = (1.8, 2.2)
    """Of the cameras from the middle of the cell."""
    width: int = 1280
    height: int = 720
    field_deg: tuple[float, float] = (55.0, 75.0)
    """Horizontal field of view."""
    noise_px: tuple[float, float] = (0.3, 0.5)
    """1 sigma of a camera's corners, each axis."""
    outliers: float = 0.2
    """Share of wrong corners: half of them alone, half in images whose board is misread as a whole."""
    offset_s: float = 0.05
    """Clock offsets are within plus and minus this."""
    rate_ppm: float = 100.0
    """The same of clock rates."""
    frame_rates_hz: tuple[float, ...] = (7.5, 10.0, 15.0)
    seconds: float = 60.0
    """Length of a recording."""
    bow_m: tuple[float, float] = (0.0, 0.005)
    """By how much the board's farthest corners stand off the plane in its middle: sheets are never flat."""


@dataclass(frozen=True)
class SimulatedRig:
    """What cameras recorded of a board, and the truth."""

    recordings: tuple[CameraRecording, ...]
    lenses: tuple[Lens, ...]
    T_base_cam: Float64
    """[C, 4, 4]."""
    offsets_s: Float64
    """[C] to add to a camera's stamps at `START_NS` to give the true time."""
    rates_ppm: Float64
    """[C] how fast that grows with the camera's own time."""


def simulated_rig(spread: RigSpread, rng: np.random.Generator) -> SimulatedRig:
    """A rig drawn from `spread` and its recording of the board."""
    count = int(rng.integers(spread.cameras[0], spread.cameras[1] + 1))
    poses = _placed(count, spread, rng)
    motion, points = _Motion(rng), _bowed(spread, rng.spawn(1)[0])
    offsets = rng.uniform(-spread.offset_s, spread.offset_s, count)
    rates = rng.uniform(-spread.rate_ppm, spread.rate_ppm, count)
    recordings, lenses = [], []
    for i, T in enumerate(poses):
        rate_hz = float(rng.choice(spread.frame_rates_hz))
        times = np.arange(0, spread.seconds, 1 / rate_hz) + rng.uniform(0, 1 / rate_hz)
        own = (times - offsets[i]) / (1 + rates[i] * 1e-6)
        lens = _lens(spread, rng)
        lenses.append(lens)
        noise = rng.uniform(*spread.noise_px)
        seen = (inverse_pose(T) @ motion.at(t) for t in times.tolist())
        found = tuple(_seen(points, lens, T_cam_board, noise, spread.outliers, rng) for T_cam_board in seen)
        stamps = START_NS + np.rint(own * 1e9).astype(np.int64)
        images = tuple(f"frame {number}" for number in range(len(times)))
        recordings.append(CameraRecording(f"cam_{i}", (lens.width, lens.height), stamps, images, found))
    return SimulatedRig(tuple(recordings), tuple(lenses), poses, offsets, rates)


class _Motion:
    """A board waved about the middle of the cell, its face up and to all sides: sums of slow sines."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._hz = rng.uniform(0.05, 0.7, (6, 4))
        self._phase = rng.uniform(0, 2 * np.pi, (6, 4))
        # Slow waves are wide and fast ones small: all have about the same top speed.
        reach = np.array([0.5, 0.5, 0.3, 0.7, 0.7, 1.0])
        self._size = reach[:, None] / np.maximum(self._hz / 0.1, 1)

    def at(self, seconds: float) -> Float64:
        """`T_base_board` at a time, s."""
        value = (self._size * np.sin(2 * np.pi * self._hz * seconds + self._phase)).sum(axis=1)
        turn = Rotation.from_rotvec(value[3:]) * Rotation.from_euler("x", np.pi)
        return pose(turn.as_matrix(), value[:3])


def _placed(count: int, spread: RigSpread, rng: np.random.Generator) -> Float64:
    """[C, 4, 4] cameras about the cell, at least 25 degrees apart, that look down at about its middle."""
    while True:
        around = rng.uniform(0, 2 * np.pi, count)
        down = np.radians(rng.uniform(30, 65, count))
        away = np.stack([np.cos(around) * np.cos(down), np.sin(around) * np.cos(down), np.sin(down)], axis=1)
        apart = np.degrees(np.arccos(np.clip(away @ away.T, -1, 1)))[np.triu_indices(count, 1)]
        if apart.min() > 25:
            break
    centres = away * rng.uniform(*spread.distance_m, (count, 1))
    targets = rng.uniform(-0.15, 0.15, (count, 3))
    return np.stack([_looking(*ends, rng.normal(0, 0.1)) for ends in zip(centres, targets, strict=True)])


def _looking(centre: Float64, target: Float64, roll: float) -> Float64:
    """`T_base_cam` of a camera upright but for its roll, rad."""
    turned = Rotation.from_euler("z", roll).as_matrix()
    return looking_at(centre, target) @ pose(turned, np.zeros(3))


def _bowed(spread: RigSpread, rng: np.random.Generator) -> Float64:
    """[P, 3] m: the board's corners, rolled up along some direction."""
    flat = BOARD.points[:, :2] - BOARD.points[:, :2].mean(axis=0)
    direction = rng.uniform(0, np.pi)
    along = flat @ [np.cos(direction), np.sin(direction)] / np.linalg.norm(flat, axis=1).max()
    return np.asarray(BOARD.points + np.outer(rng.uniform(*spread.bow_m) * along**2, [0.0, 0.0, 1.0]))


def _lens(spread: RigSpread, rng: np.random.Generator) -> Lens:
    """A lens with the barrel distortion, off-centre sensor and tilt of what is on sale."""
    focal = spread.width / 2 / np.tan(np.radians(rng.uniform(*spread.field_deg)) / 2)
    middle = (np.array([spread.width, spread.height]) - 1) / 2 + rng.normal(0, 0.01 * spread.width, 2)
    k1 = rng.uniform(-0.3, 0.1)
    D = np.array([k1, rng.normal(-0.3 * k1, 0.03), *rng.normal(0, 5e-4, 2), 0.0])
    K = np.array([[focal, 0, middle[0]], [0, focal * (1 + rng.normal(0, 5e-4)), middle[1]], [0, 0, 1]])
    return Lens(spread.width, spread.height, K, "plumb_bob", D)


def _seen(
    points: Float64, lens: Lens, T_cam_board: Float64, noise_px: float, outliers: float, rng: np.random.Generator
) -> Corners | None:
    """The corners of a board [P, 3] in one image; None where it shows none."""
    places = transform(T_cam_board, points)
    if places[:, 2].min() < 0.2 or (T_cam_board[:3, 2] @ T_cam_board[:3, 3]) < 0.25 * np.linalg.norm(
        T_cam_board[:3, 3]
    ):
        return None  # behind the camera, from behind, or too slanted for a detector
    pixels = project(lens, places).pixels
    inside = ((pixels > 4) & (pixels < [lens.width - 5, lens.height - 5])).all(axis=1)
    ids = np.flatnonzero(inside)
    found = pixels[inside] + rng.normal(0, noise_px, (len(ids), 2))
    if rng.uniform() < outliers / 2:
        found += rng.normal(0, 15, 2) + rng.normal(0, 3, found.shape)
    stray = rng.uniform(size=len(ids)) < outliers / 2
    found[stray] += rng.normal(0, 15, (int(stray.sum()), 2))
    return Corners(ids, found) if len(ids) else None
