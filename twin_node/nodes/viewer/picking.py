"""What a click hits: the nearest obstacle or Gaussian along its ray."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_node.geometry import rotation_from_quat
from twin_node.nodes.snapshot import Snapshot, in_force
from twin_node.scene import Float64, GaussianCloud, ObstacleKind, Obstacles, ObstacleShape

SOLID = 0.2
"""Opacity from which a Gaussian can be picked: fainter ones are not what is clicked at."""
REACH_SIGMAS = 2.0
"""A ray hits a Gaussian that it passes within so many standard deviations."""


@dataclass(frozen=True)
class Ray:
    """A half line in `base_link`."""

    origin: Float64
    """[3] m."""
    direction: Float64
    """[3] of length 1."""


@dataclass(frozen=True)
class Pick:
    """What was hit."""

    id: int
    kind: ObstacleKind | None
    """Of an obstacle; None: a Gaussian."""

    @property
    def is_obstacle(self) -> bool:
        """Whether it is an obstacle, not a Gaussian."""
        return self.kind is not None


def pick(snapshot: Snapshot, ray: Ray, kinds: Collection[ObstacleKind], with_gaussians: bool) -> Pick | None:
    """The nearest thing along a ray, an obstacle of one of `kinds` or a Gaussian; None where nothing is hit.

    What is not shown is not to be asked for: the obstacles around what stands hide the Gaussians in them.
    """
    best, hit = np.inf, None
    obstacles = in_force(snapshot.obstacles, snapshot.stamp)
    distances = _to_obstacles(obstacles, ray)
    distances[~np.isin(obstacles.kinds, list(kinds))] = np.inf
    if len(distances) and distances.min() < best:
        row = int(distances.argmin())
        best, hit = float(distances[row]), Pick(int(obstacles.ids[row]), ObstacleKind(int(obstacles.kinds[row])))
    cloud = snapshot.cloud_now if with_gaussians else None
    if cloud is not None and len(cloud.means):
        distances = _to_gaussians(cloud, ray)
        if distances.min() < best:
            hit = Pick(int(cloud.ids[distances.argmin()]), None)
    return hit


def _to_obstacles(obstacles: Obstacles, ray: Ray) -> Float64:
    """[n] m along the ray to each obstacle's surface; infinite for a miss (slabs in the box's own frame)."""
    rotations = rotation_from_quat(obstacles.quats)
    origin = np.einsum("nji,nj->ni", rotations, ray.origin - obstacles.positions)
    direction = np.einsum("nji,j->ni", rotations, ray.direction)
    half = obstacles.sizes / 2
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (-half - origin) / direction, (half - origin) / direction
    enter, leave = (
        np.nanmax(np.minimum(a, b), axis=1, initial=-np.inf),
        np.nanmin(np.maximum(a, b), axis=1, initial=np.inf),
    )
    out = np.where((enter <= leave) & (leave >= 0), np.maximum(enter, 0), np.inf)
    round_ = obstacles.shapes == ObstacleShape.SPHERE
    centers, radii = obstacles.positions[round_], half[round_, 0]
    along, beside = _along_and_beside(centers, ray)
    into = np.sqrt(np.maximum(radii**2 - beside**2, 0))
    out[round_] = np.where((beside <= radii) & (along + into >= 0), np.maximum(along - into, 0), np.inf)
    return out


def _along_and_beside(centers: Float64, ray: Ray) -> tuple[Float64, Float64]:
    """[n] m along the ray to where it is nearest to each centre [n, 3], and [n] m from there to the centre."""
    along = (centers - ray.origin) @ ray.direction
    return along, np.linalg.norm(centers - ray.origin - along[:, None] * ray.direction, axis=1)


def _to_gaussians(cloud: GaussianCloud, ray: Ray) -> Float64:
    """[N] m along the ray to the middle of each solid Gaussian that it passes through; infinite for a miss."""
    centers: NDArray[np.float64] = cloud.means.astype(np.float64)
    reach = REACH_SIGMAS * cloud.scales.astype(np.float64).mean(axis=1)
    along, beside = _along_and_beside(centers, ray)
    return np.where((cloud.opacities >= SOLID) & (beside <= reach) & (along > 0), along, np.inf)
