"""A made-up rig around a workspace and exact silhouettes of balls in it."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from twin_node.geometry import looking_at, pose, project
from twin_node.scene import (
    Bool,
    Camera,
    Float32,
    Float64,
    FrameSet,
    GaussianCloud,
    Grid,
    NodeStates,
    TwinState,
    View,
)

WIDTH, HEIGHT = 96, 72
WORKSPACE = np.array([[-0.6, -0.6, 0.0], [0.6, 0.6, 0.9]])
GRID = Grid(WORKSPACE[0], 0.03, (40, 40, 30))


def camera(name: str, eye: Float64, sigma_m: float = 0.002, roll: float = 0.0) -> Camera:
    """A camera at `eye` that looks at the middle of the workspace, turned about its axis by `roll` (rad)."""
    rolled = Rotation.from_rotvec([0, 0, roll]).as_matrix()
    K = np.array([[90.0, 0, WIDTH / 2], [0, 90.0, HEIGHT / 2], [0, 0, 1]])
    return Camera(name, WIDTH, HEIGHT, K, looking_at(eye, WORKSPACE.mean(axis=0)) @ pose(rolled, np.zeros(3)), sigma_m)


RIG = tuple(
    camera(f"cam{number}", np.array([2.0 * np.cos(angle), 2.0 * np.sin(angle), 1.2]), roll=0.2 * (number == 1))
    for number, angle in enumerate(np.deg2rad([0, 100, 190, 280]))
)


def rays(cam: Camera) -> Float64:
    """[H, W, 3] directions in base of the rays through the pixel centres, of length 1 along the optical axis."""
    v, u = np.mgrid[: cam.height, : cam.width] + 0.5
    local = np.stack([(u - cam.K[0, 2]) / cam.K[0, 0], (v - cam.K[1, 2]) / cam.K[1, 1], np.ones_like(u)], axis=-1)
    return np.asarray(local @ cam.T_base_cam[:3, :3].T)


def ball_depth(cam: Camera, center: Float64, radius: float) -> Float32:
    """[H, W] depth of a ball's surface, infinite beside it."""
    directions = rays(cam)
    offset = cam.T_base_cam[:3, 3] - center
    a = (directions**2).sum(axis=-1)
    b = (directions * offset).sum(axis=-1)
    inside = b**2 - a * (offset @ offset - radius**2)
    return np.where(inside > 0, (-b - np.sqrt(np.maximum(inside, 0))) / a, np.inf).astype(np.float32)


def floor_depth(cam: Camera) -> Float32:
    """[H, W] depth of the floor z = 0, far where a ray does not meet it."""
    down = rays(cam)[..., 2]
    return np.where(down < -1e-3, -cam.T_base_cam[2, 3] / np.minimum(down, -1e-3), 9.0).astype(np.float32)


def texture(points: Float64) -> Float64:
    """[..., 3] colours of a pattern that sticks to a surface, 0 to 255."""
    waves = np.sin(points * 70) + np.sin(points[..., [1, 2, 0]] * 43)
    return np.asarray(128 + 60 * waves)


def state_of(
    stamp: int,
    center: Float64 | None,
    radius: float = 0.12,
    cameras: tuple[Camera, ...] = RIG,
    with_depth: bool = False,
    robot_masks: tuple[Bool | None, ...] | None = None,
) -> TwinState:
    """The state of a twin that sees a textured ball at `center` (None: nothing) over a floor, with exact masks."""
    views, masks = [], []
    for cam in cameras:
        floor = floor_depth(cam)
        ball = np.full(floor.shape, np.inf, np.float32) if center is None else ball_depth(cam, center, radius)
        mask = ball < floor
        depth = np.minimum(ball, floor)
        points = cam.T_base_cam[:3, 3] + rays(cam) * depth[..., None]
        shift = np.zeros(3) if center is None else center
        rgb = texture(np.where(mask[..., None], points - shift, points)).clip(0, 255).astype(np.uint8)
        views.append(View(cam, stamp, rgb, depth if with_depth else None))
        masks.append(mask)
    robots = (None,) * len(cameras) if robot_masks is None else robot_masks
    frames = FrameSet(stamp, tuple(views))
    return TwinState(stamp, frames, GaussianCloud.none(), NodeStates.none(), tuple(masks), robots)


def ball_voxels(center: Float64, radius: float = 0.12, grid: Grid = GRID) -> np.ndarray:
    """Flat indices of voxels whose centres lie in a ball."""
    centers = grid.centers(np.arange(grid.size))
    return np.flatnonzero(np.linalg.norm(centers - center, axis=1) < radius)


def pixels_of(cam: Camera, points: Float64) -> np.ndarray:
    """Flat pixels [n] of points, -1 outside the image."""
    u, v, z = project(cam.K, cam.viewmat, points).T
    inside = (z > 0) & (u >= 0) & (u < WIDTH) & (v >= 0) & (v < HEIGHT)
    return np.where(inside, np.floor(v).astype(int) * WIDTH + np.floor(u).astype(int), -1)
