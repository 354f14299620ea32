"""Parts of the moving space and how they move: the nodes of a rig that has images and no model yet."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from twin_node.geometry import project, transform
from twin_node.scene import Bool, Camera, Float32, Float64, Grid, TwinState, UInt8, View

PART_SIZE = 0.08
"""Edge of a part, m: about as thick as a forearm, so that limbs and torso get parts of their own."""


@dataclass(frozen=True)
class Parts:
    """Moving voxels in cubes of about `PART_SIZE`."""

    indices: NDArray[np.int64]
    """[n] flat voxel indices."""
    points: Float64
    """[n, 3] voxel centres, m."""
    labels: NDArray[np.int64]
    """[n] part of each voxel."""
    centers: Float64
    """[M, 3] mean of each part's voxels, m."""

    @property
    def count(self) -> int:
        """M, the number of parts."""
        return len(self.centers)


def split(grid: Grid, indices: NDArray[np.int64]) -> Parts:
    """Parts of the voxels `indices` [n]: one per occupied cell of a coarser lattice."""
    points = grid.centers(indices)
    cells = np.floor((points - grid.origin) / PART_SIZE).astype(np.int64)
    keys = (cells[:, 0] * 4096 + cells[:, 1]) * 4096 + cells[:, 2]
    _, labels = np.unique(keys, return_inverse=True)
    labels = labels.reshape(-1).astype(np.int64)
    counts = np.bincount(labels)
    sums = np.stack([np.bincount(labels, points[:, axis]) for axis in range(3)], axis=1)
    return Parts(indices, points, labels, sums / np.maximum(counts, 1)[:, None])


class PartVelocities:
    """Velocities of parts from the optical flow of the views that see them."""

    def __init__(self, baseline_ns: int = 30_000_000) -> None:
        self._baseline_ns = baseline_ns
        self._past: dict[str, list[tuple[int, UInt8]]] = {}
        self._flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_FAST)
        self._flow.setFinestScale(1)

    def update(self, state: TwinState, parts: Parts, expected: Float64) -> Float64:
        """Velocities [M, 3] in m/s; `expected` [M, 3] stands where, and along directions that, no view shows.

        Least squares over the views: the image velocity of a part is its velocity seen through the projection.
        """
        precision = np.tile(np.eye(3) * _PRIOR, (parts.count, 1, 1))
        evidence = expected * _PRIOR
        for view, mask in zip(state.frames.views, state.moving_masks, strict=True):
            image_velocity = self._image_velocity(view)
            if image_velocity is None or parts.count == 0:
                continue
            mean, weight = _seen_by(view, image_velocity, mask, parts)
            jacobian = _jacobian(view.camera, parts.centers)
            scaled = jacobian * weight[:, None, None]
            precision += np.einsum("mki,mkj->mij", scaled, jacobian)
            evidence += np.einsum("mki,mk->mi", scaled, mean)
        return np.linalg.solve(precision, evidence[..., None])[..., 0]

    def _image_velocity(self, view: View) -> Float32 | None:
        """[H, W, 2] pixels per second; None without an earlier image."""
        grey = cv2.cvtColor(view.rgb, cv2.COLOR_RGB2GRAY)
        past = self._past.setdefault(view.camera.name, [])
        while len(past) > 1 and view.stamp - past[1][0] >= self._baseline_ns:
            past.pop(0)
        flow = None
        if past and past[0][0] < view.stamp and past[0][1].shape == grey.shape:
            flow = self._flow.calc(grey, past[0][1], None) / np.float32(-1e-9 * (view.stamp - past[0][0]))
        past.append((view.stamp, grey.astype(np.uint8)))
        return flow


_PRIOR = 500.0
"""Weight of the expected velocity against one view: (pixels per metre)^2, as of a view from 6 m."""


def _seen_by(view: View, image_velocity: Float32, mask: Bool, parts: Parts) -> tuple[Float64, Float64]:
    """Mean image velocity [M, 2] over each part's visible voxels in the mask, and 1 for the parts it sees."""
    u, v, z = project(view.camera.K, view.camera.viewmat, parts.points).T
    inside = (z > 0) & (u >= 0) & (u < view.camera.width) & (v >= 0) & (v < view.camera.height)
    column, row = np.where(inside, u, 0).astype(int), np.where(inside, v, 0).astype(int)
    nearest = np.full((view.camera.height // 2 + 1, view.camera.width // 2 + 1), np.inf)
    np.minimum.at(nearest, (row[inside] // 2, column[inside] // 2), z[inside])
    visible = inside & (z < nearest[row // 2, column // 2] + PART_SIZE)
    velocity = image_velocity[row, column]
    weight = (visible & mask[row, column]) * (np.linalg.norm(velocity, axis=1) + 3.0) ** 2
    total = np.bincount(parts.labels, weight, parts.count)
    mean = np.stack([np.bincount(parts.labels, weight * velocity[:, axis], parts.count) for axis in range(2)], axis=1)
    return mean / np.maximum(total, 1e-9)[:, None], (total > 0).astype(np.float64)


def _jacobian(camera: Camera, points: Float64) -> Float64:
    """Derivative [M, 2, 3] of the pixel by the base-frame point."""
    x, y, z = transform(camera.viewmat, points).T
    z = np.maximum(z, 0.05)
    rows = np.zeros((len(points), 2, 3))
    rows[:, 0, 0], rows[:, 0, 2] = camera.K[0, 0] / z, -camera.K[0, 0] * x / z**2
    rows[:, 1, 1], rows[:, 1, 2] = camera.K[1, 1] / z, -camera.K[1, 1] * y / z**2
    return rows @ camera.viewmat[:3, :3]
