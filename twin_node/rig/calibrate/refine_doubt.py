"""How sure a rig without a board is: what matches and surfaces leave open, which the gaps that are left do not show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin_node.geometry import inverse_pose, transform
from twin_node.rig.calibrate.lenses import homogeneous, lens_of, pixel_rays, project
from twin_node.rig.calibrate.matches import Matches
from twin_node.rig.calibrate.results import LEAST_DEPTH_M, metres_per_pixel, settled, sight_sigmas
from twin_node.rig.calibrate.rotations import cross_matrix
from twin_node.scene import Float64, RigCamera
from twin_node.thinning import thinned

WITNESSES_PER_PAIR = 24
"""Matches, evenly picked, about which the cameras' agreement is judged."""
LIFTS = (0.0, 0.15, 0.3)
"""Shares of the way from a match to the cameras' middle: what is worked with stands on what was matched."""


@dataclass(frozen=True)
class Doubt:
    """What is left open of cameras, without what moves the rig as a whole (a free network: Triggs 1999, section 9)."""

    pose_covariances: Float64
    """[C, 6, 6] of `T_base_cam`: position (m), turns about the base's axes (rad)."""
    sigmas_m: Float64
    """[C] 1 sigma per axis of where each camera sees a point of the working volume, m; 0 where none is known."""


def doubt_of(cameras: Sequence[RigCamera], covariance: Float64, witnesses: Float64) -> Doubt:
    """The doubt about cameras at points [W, 3] m of the base.

    `covariance` [n, n]: of each camera's turn about the base's axes (rad), its move along them (m) and, where they were
    free, its lens's parameters, camera by camera (the columns of `match_slopes.Slopes`).
    """
    poses = np.stack([camera.T_base_cam for camera in cameras])
    lenses = [lens_of(camera) for camera in cameras]
    told = len(covariance) > 6 * len(cameras)
    starts = np.cumsum([0] + [6 + (len(lens.parameters) if told else 0) for lens in lenses])
    J = np.zeros((6 * len(cameras), len(covariance)))
    moves = np.zeros((len(cameras), len(witnesses), 2, len(covariance)))
    shared = np.zeros((*moves.shape[:3], 6))
    for i, (lens, T) in enumerate(zip(lenses, poses, strict=True)):
        own = starts[i]
        J[6 * i : 6 * i + 3, own + 3 : own + 6] = J[6 * i + 3 : 6 * i + 6, own : own + 3] = np.eye(3)
        seen = transform(inverse_pose(T), witnesses)
        projection = project(lens, seen)
        to_metres = metres_per_pixel(lens, seen)[:, None, None]
        by_place = projection.by_point * to_metres @ T[:3, :3].T
        moves[i, ..., own : own + 3] = by_place @ cross_matrix(witnesses - T[:3, 3])
        moves[i, ..., own + 3 : own + 6] = -by_place
        if told:
            moves[i, ..., own + 6 : starts[i + 1]] = projection.by_lens * to_metres
        shared[i] = np.concatenate([by_place, -by_place @ cross_matrix(witnesses)], axis=2)
    J = settled(poses, J)
    whole = (J @ covariance @ J.T).reshape(len(cameras), 6, len(cameras), 6)
    blocks = np.stack([whole[i, :, i] for i in range(len(cameras))])
    return Doubt(blocks, sight_sigmas(moves, shared, covariance) if len(witnesses) else np.zeros(len(cameras)))


def witnesses_of(cameras: Sequence[RigCamera], matches: Sequence[Matches]) -> Float64:
    """[W, 3] m places of matches before their two cameras, and some way from there to the middle of all cameras."""
    found = [np.zeros((0, 3))]
    for pair in matches:
        rows = np.array(thinned(range(len(pair)), WITNESSES_PER_PAIR), np.int64)
        found.append(_places(cameras[pair.a], cameras[pair.b], pair.pixels_a[rows], pair.pixels_b[rows]))
    places = np.concatenate(found)
    middle = np.mean([camera.T_base_cam[:3, 3] for camera in cameras], axis=0)
    return np.concatenate([places + lift * (middle - places) for lift in LIFTS])


def _places(a: RigCamera, b: RigCamera, pixels_a: Float64, pixels_b: Float64) -> Float64:
    """[n, 3] m the points nearest to both rays of matches [n, 2], of those before both cameras."""
    across, right = np.zeros((len(pixels_a), 3, 3)), np.zeros((len(pixels_a), 3))
    for camera, pixels in ((a, pixels_a), (b, pixels_b)):
        rays = homogeneous(pixel_rays(camera, pixels))
        rays = (rays / np.linalg.norm(rays, axis=1, keepdims=True)) @ camera.T_base_cam[:3, :3].T
        off = np.eye(3) - rays[:, :, None] * rays[:, None, :]
        across += off
        right += off @ camera.T_base_cam[:3, 3]
    places = (np.linalg.pinv(across) @ right[..., None])[..., 0]
    depths = [transform(inverse_pose(camera.T_base_cam), places)[:, 2] for camera in (a, b)]
    return np.asarray(places[np.minimum(*depths) > LEAST_DEPTH_M])
