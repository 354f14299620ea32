"""What a click hits: the nearest obstacle or Gaussian along its ray, and what is known of it."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_node.geometry import rotation_from_quat
from twin_node.nodes.export.moments import in_force
from twin_node.nodes.playback import Snapshot
from twin_node.scene import Float64, GaussianCloud, ObstacleKind, Obstacles, ObstacleShape, Tier

HISTORY = 60
"""Places of a picked thing that are remembered: two seconds at 30 Hz."""
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

    is_obstacle: bool
    id: int


def pick(snapshot: Snapshot, ray: Ray) -> Pick | None:
    """The nearest thing along a ray: obstacles that move or are unknown, and Gaussians; None where nothing is hit.

    STATIC obstacles are boxes around what is seen anyway, so the Gaussians inside are picked instead.
    """
    best, hit = np.inf, None
    obstacles = in_force(snapshot.obstacles, snapshot.stamp)
    distances = _to_obstacles(obstacles, ray)
    distances[obstacles.kinds == ObstacleKind.STATIC] = np.inf
    if len(distances) and distances.min() < best:
        best, hit = float(distances.min()), Pick(True, int(obstacles.ids[distances.argmin()]))
    cloud = snapshot.cloud
    if cloud is not None and len(cloud.means):
        distances = _to_gaussians(cloud, ray)
        if distances.min() < best:
            hit = Pick(False, int(cloud.ids[distances.argmin()]))
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
    out[round_] = _to_spheres(obstacles.positions[round_], half[round_, 0], ray)
    return out


def _to_spheres(centers: Float64, radii: Float64, ray: Ray) -> Float64:
    along = (centers - ray.origin) @ ray.direction
    beside = np.linalg.norm(centers - ray.origin - along[:, None] * ray.direction, axis=1)
    return np.where((beside <= radii) & (along > 0), along, np.inf)


def _to_gaussians(cloud: GaussianCloud, ray: Ray) -> Float64:
    """[N] m along the ray to each solid Gaussian that it passes through; infinite for a miss."""
    centers: NDArray[np.float64] = cloud.means.astype(np.float64)
    reach = REACH_SIGMAS * cloud.scales.astype(np.float64).mean(axis=1)
    return np.where(cloud.opacities >= SOLID, _to_spheres(centers, reach, ray), np.inf)


class PickedThing:
    """Follows what was picked from picture to picture."""

    def __init__(self, picked: Pick) -> None:
        self._picked = picked
        self._places: deque[tuple[int, Float64]] = deque(maxlen=HISTORY)

    def describe(self, snapshot: Snapshot) -> str:
        """Markdown about the thing as it is now, and how it came here."""
        return self._obstacle(snapshot) if self._picked.is_obstacle else self._gaussian(snapshot)

    def _obstacle(self, snapshot: Snapshot) -> str:
        o = in_force(snapshot.obstacles, snapshot.stamp)
        rows = np.flatnonzero(o.ids == self._picked.id)
        if not len(rows):
            return f"**Obstacle {self._picked.id}** is no more."
        row = int(rows[0])
        size = " x ".join(f"{100 * side:.0f}" for side in o.sizes[row])
        return "\n".join(
            [
                f"**Obstacle {self._picked.id}**, {ObstacleKind(int(o.kinds[row])).name}",
                f"- {size} cm at {_point(o.positions[row])} m",
                f"- speed {np.linalg.norm(o.velocities[row]):.2f} m/s, error bound {100 * o.bounds[row]:.1f} cm",
                self._history(snapshot.stamp, o.positions[row]),
            ]
        )

    def _gaussian(self, snapshot: Snapshot) -> str:
        cloud = snapshot.cloud
        rows = np.flatnonzero(cloud.ids == self._picked.id) if cloud is not None else np.empty(0, np.int64)
        if cloud is None or not len(rows):
            return f"**Gaussian {self._picked.id}** is no more."
        row = int(rows[0])
        sigmas = " x ".join(f"{1000 * s:.1f}" for s in cloud.scales[row])
        return "\n".join(
            [
                f"**Gaussian {self._picked.id}**, {Tier(int(cloud.tiers[row])).name}",
                f"- {sigmas} mm (1 sigma) at {_point(cloud.means[row])} m, opacity {cloud.opacities[row]:.2f}",
                f"- speed {np.linalg.norm(cloud.velocities[row]):.2f} m/s",
                self._history(snapshot.stamp, cloud.means[row].astype(np.float64)),
            ]
        )

    def _history(self, stamp: int, place: Float64) -> str:
        if self._places and stamp <= self._places[-1][0]:
            self._places.clear()
        self._places.append((stamp, place))
        first_stamp, first = self._places[0]
        return f"- moved {100 * np.linalg.norm(place - first):.1f} cm in the {(stamp - first_stamp) / 1e9:.1f} s since"


def _point(place: NDArray[np.floating]) -> str:
    return "(" + ", ".join(f"{value:.2f}" for value in place) + ")"
