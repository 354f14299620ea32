"""How the errors of matches change with the cameras and the plane that they are held against."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_node.geometry import inverse_pose, transform
from twin_node.rig.calibrate.birds_eye import plane_hits
from twin_node.rig.calibrate.lenses import BEHIND_M, homogeneous, pixel_rays, project
from twin_node.rig.calibrate.matches import NOWHERE_M
from twin_node.rig.calibrate.rotations import cross_matrix
from twin_node.scene import Float64, RigCamera


@dataclass(frozen=True)
class Slopes:
    """Derivatives of N errors, pixels.

    A camera's columns: its turn about the base's axes (rad), its move along them (m), then its lens's parameters as
    `Lens.parameters` orders them.
    """

    by_a: Float64
    """[N, 6 + 4 + D] by the first camera."""
    by_b: Float64
    """[N, 6 + 4 + D] by the second camera."""
    by_plane: Float64
    """[N, 4] by the plane's normal and offset."""


def transfer_slopes(a: RigCamera, b: RigCamera, plane: Float64, pixels_a: Float64) -> Slopes:
    """Of `matches.transfer_px`, its rows flattened: [2 n]."""
    rays, by_lens_a = _rays(a, pixels_a)
    R_a, R_b, centre_b = a.T_base_cam[:3, :3], b.T_base_cam[:3, :3], b.T_base_cam[:3, 3]
    g = homogeneous(rays) @ R_a.T
    hits = plane_hits(a, plane, pixels_a)
    there = np.isfinite(hits[:, :1])
    hits = np.where(there, hits, NOWHERE_M)
    # Along the ray, per length across the plane; what meets no plane stays where it is.
    along = np.where(there, g / np.where(there, g @ plane[:3, None], 1.0), 0.0)
    slide = np.where(there[..., None], np.eye(3), 0.0) - along[:, :, None] * plane[:3]
    depth = np.linalg.norm(hits - a.T_base_cam[:3, 3], axis=1) / np.linalg.norm(g, axis=1)
    local = transform(inverse_pose(b.T_base_cam), hits)
    projection = project(b, local)
    before = np.array([1.0, 1.0, 0.0]) + (local[:, 2:] > BEHIND_M) * np.array([0.0, 0.0, 1.0])
    by_hit = projection.by_point * before[:, None] @ R_b.T
    by_centre = by_hit @ slide
    by_ray = by_centre * depth[:, None, None]
    by_a = np.concatenate([-by_ray @ cross_matrix(g), by_centre, by_ray @ R_a[:, :2] @ by_lens_a], axis=2)
    by_b = np.concatenate([by_hit @ cross_matrix(hits - centre_b), -by_hit, projection.by_lens], axis=2)
    offset = -by_hit @ along[..., None]
    by_plane = np.concatenate([offset * hits[:, None], offset], axis=2)
    return Slopes(by_a.reshape(-1, by_a.shape[2]), by_b.reshape(-1, by_b.shape[2]), by_plane.reshape(-1, 4))


def epipolar_slopes(a: RigCamera, b: RigCamera, pixels_a: Float64, pixels_b: Float64) -> Slopes:
    """Of `matches.epipolar_px`: [n]."""
    (rays_a, by_lens_a), (rays_b, by_lens_b) = _rays(a, pixels_a), _rays(b, pixels_b)
    E, by_poses = _essential(a, b)
    p, q = homogeneous(rays_a), homogeneous(rays_b)
    line_b, line_a = p @ E.T, q @ E
    off = (q * line_b).sum(1, keepdims=True)
    line_b[:, 2] = line_a[:, 2] = 0  # of lines, only the directions count from here on
    square = (line_a**2 + line_b**2).sum(1, keepdims=True)
    focal = np.sqrt(2 * a.K[0, 0] * b.K[0, 0])
    scale, share = focal / np.sqrt(square), off / square
    across = q[:, :, None] * (p - share * line_a)[:, None] - (share * line_b)[:, :, None] * p[:, None]
    by_pose = (scale[..., None] * across).reshape(-1, 9) @ by_poses.reshape(12, 9).T
    by_ray_a = scale * ((q - share * line_b) @ E)[:, :2]
    by_ray_b = scale * ((p - share * line_a) @ E.T)[:, :2]
    by_focal = scale * off / 2
    by_a, by_b = (
        np.concatenate([own, np.einsum("ni,nij->nj", by_ray, by_lens)], axis=1)
        for own, by_ray, by_lens in ((by_pose[:, :6], by_ray_a, by_lens_a), (by_pose[:, 6:], by_ray_b, by_lens_b))
    )
    by_a[:, 6] += by_focal[:, 0] / a.K[0, 0]
    by_b[:, 6] += by_focal[:, 0] / b.K[0, 0]
    return Slopes(by_a, by_b, np.zeros((len(p), 4)))


def _rays(camera: RigCamera, pixels: Float64) -> tuple[Float64, Float64]:
    """Rays [n, 2] of raw pixels, and their derivatives [n, 2, 4 + D] by the lens's parameters."""
    rays = pixel_rays(camera, pixels)
    projection = project(camera, homogeneous(rays))
    return rays, np.asarray(-np.linalg.solve(projection.by_point[..., :2], projection.by_lens), np.float64)


def _essential(a: RigCamera, b: RigCamera) -> tuple[Float64, Float64]:
    """The essential matrix [3, 3] between two cameras, and its derivatives [12, 3, 3] by both poses."""
    back, apart = b.T_base_cam[:3, :3].T, a.T_base_cam[:3, 3] - b.T_base_cam[:3, 3]
    R, t = back @ a.T_base_cam[:3, :3], back @ apart
    length = max(float(np.linalg.norm(t)), 1e-9)
    t = t / length
    none = np.zeros((3, 3))
    turns = np.hstack([back, none, -back, none])
    moves = np.hstack([none, back, back @ cross_matrix(apart), -back])
    moves = (np.eye(3) - np.outer(t, t)) @ moves / length
    E: Float64 = cross_matrix(t) @ R
    return E, (cross_matrix(moves.T) + cross_matrix(t) @ cross_matrix(turns.T)) @ R
