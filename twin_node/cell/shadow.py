"""What moves in a cell as points with radii over time: quick, exact answers for a loop that asks thousands of times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_node.cell.shapes import Form, Shape
from twin_node.cell.world import World
from twin_node.scene import Float64

_COARSENESS = 1.2
"""Spacing of the covering spheres along a capsule, in radii: they stand out by 17 % of the radius."""
_MOST_ALONG, _MOST_ACROSS = 64, 8
"""Spheres along a capsule, and along a side of a box, at most: those of thinner things stand out farther."""


@dataclass(frozen=True)
class Spheres:
    """Spheres that together hold a shape, in the shape's own frame."""

    centers: Float64
    """[K, 3] m."""
    radius: float


@dataclass(frozen=True)
class Limbs:
    """The capsules that people are made of, over time."""

    ends: Float64
    """[T, P, 2, 3] m, in `base_link`."""
    radii: Float64
    """[P] m."""


class Shadow:
    """A world's moving bodies and people, sampled once: covering spheres for perception, capsules for the truth."""

    def __init__(self, world: World, start_ns: int, stop_ns: int, step_ns: int) -> None:
        self.start_ns, self.step_ns = start_ns, step_ns
        stamps = np.arange(start_ns, stop_ns + step_ns, step_ns)
        frames = [world.moving(int(stamp)) for stamp in stamps]
        self.shapes = tuple(solid.placed.shape for solid in frames[0])
        self.owners: NDArray[np.int64] = np.array([solid.owner for solid in frames[0]], dtype=np.int64)
        self._poses = np.array([[solid.placed.T_base_shape for solid in frame] for frame in frames])
        self._poses = self._poses.reshape(len(stamps), len(self.shapes), 4, 4)
        covers = [covering_spheres(shape) for shape in self.shapes]
        counts = [len(cover.centers) for cover in covers]
        self._shape_of: NDArray[np.int64] = np.repeat(np.arange(len(covers)), counts)
        self.radii = np.repeat([cover.radius for cover in covers], counts).astype(np.float64)
        """[K] m."""
        local = np.concatenate([np.empty((0, 3)), *(cover.centers for cover in covers)])
        carried = self._poses[:, self._shape_of]
        self.points: Float64 = np.einsum("tkij,kj->tki", carried[..., :3, :3], local) + carried[..., :3, 3]
        """[T, K, 3] centres of the covering spheres, m, in `base_link`."""
        self._people = np.isin(self.owners, world.people_owners)

    def frame(self, stamp: int) -> int:
        """Row of the sample at or just before a stamp; the first and the last beyond the span."""
        return int(np.clip((stamp - self.start_ns) // self.step_ns, 0, len(self.points) - 1))

    def limbs(self, frames: NDArray[np.integer]) -> Limbs:
        """The people's capsules at samples [T]; people are made of capsules and spheres alone."""
        rows = np.flatnonzero(self._people)
        radii, half, _ = np.array([self.shapes[row].lengths for row in rows]).reshape(-1, 3).T
        poses = self._poses[np.asarray(frames)][:, rows]
        offset = poses[..., :3, 2] * half[:, None]
        middle = poses[..., :3, 3]
        return Limbs(np.stack([middle - offset, middle + offset], axis=2), radii)


def covering_spheres(shape: Shape) -> Spheres:
    """Few spheres of one size that together hold a shape."""
    if shape.form is Form.SPHERE:
        return Spheres(np.zeros((1, 3)), shape.size[0])
    if shape.form is Form.CAPSULE:
        radius, length = shape.size
        count = min(max(int(np.ceil(length / (_COARSENESS * radius))), 1), _MOST_ALONG)
        centers = np.zeros((count + 1, 3))
        centers[:, 2] = np.linspace(-length / 2, length / 2, count + 1)
        return Spheres(centers, float(np.hypot(radius, length / count / 2)))
    half = np.array(shape.size) / 2
    counts = np.ceil(half / max(half.min(), half.max() / _MOST_ACROSS)).astype(int)
    cell = half / counts
    axes = [np.arange(1, 2 * n, 2) * c - h for n, c, h in zip(counts, cell, half, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return Spheres(grid, float(np.linalg.norm(cell)))
