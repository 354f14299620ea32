"""What is foreseen: occupied space, the obstacles that hold it, and the speed that they leave the arm."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin_node.scene.arrays import Bool, Float64, UInt8, UInt32

HORIZONS_NS = (0, 50_000_000, 100_000_000, 150_000_000, 200_000_000)
"""The forecast's horizons after evidence stamp + latency, ns."""


class ObstacleKind(IntEnum):
    """What an obstacle stands for; values as in `twin_msgs/Obstacle`."""

    MOVING = 0
    STATIC = 1
    """Stands still."""
    UNKNOWN = 2
    """Unseen space that something may come out of at any time."""
    UNSEEN = 3
    """Unseen space in which something may lie that does not come out."""


class ObstacleShape(IntEnum):
    """Shape of an obstacle; values as in `twin_msgs/Obstacle`."""

    SPHERE = 0
    BOX = 1


class MotionExpert(IntEnum):
    """What forecasts motion; values as in `twin_msgs/Obstacle`."""

    PERSISTENCE = 0
    CONSTANT_VELOCITY = 1
    DAMPED = 2
    CONSTANT_ACCELERATION = 3
    AUTOREGRESSION = 4
    FREE_FALL = 5
    NO_EXPERT = 255


@dataclass(frozen=True)
class Grid:
    """Axis-aligned voxels in `base_link`; voxel (i, j, k) has flat index (i * ny + j) * nz + k."""

    origin: Float64
    """[3] lower corner (not centre) of voxel (0, 0, 0), m."""
    voxel_size: float
    dims: tuple[int, int, int]

    @property
    def size(self) -> int:
        """Number of voxels."""
        return self.dims[0] * self.dims[1] * self.dims[2]

    def centers(self, indices: NDArray[np.integer]) -> Float64:
        """Voxel centres [n, 3] in metres of flat indices [n]."""
        ijk = np.stack(np.unravel_index(np.asarray(indices, dtype=np.int64), self.dims), axis=-1)
        return self.origin + (ijk + 0.5) * self.voxel_size

    def indices(self, points: NDArray[np.floating]) -> NDArray[np.int64]:
        """Flat indices [n] of the voxels that hold points [n, 3]; -1 outside the grid."""
        i, j, k = np.floor((points - self.origin) / self.voxel_size).T.astype(np.int64, order="C")
        nx, ny, nz = self.dims
        inside = (i >= 0) & (i < nx) & (j >= 0) & (j < ny) & (k >= 0) & (k < nz)
        flat = (i * ny + j) * nz + k
        return np.where(inside, flat, -1)


@dataclass(frozen=True)
class OccupancyLayer:
    """What moves at one horizon."""

    horizon_ns: int
    indices: UInt32
    """[n] flat voxel indices, strictly increasing."""
    probability: UInt8
    """[n] 255 is certain."""


@dataclass(frozen=True)
class Occupancy:
    """Occupied, free and unknown space now and up to 200 ms ahead. A voxel that is in no list is free."""

    stamp: int
    """Evidence, ns."""
    publish_stamp: int
    """When it was published, on the same clock, ns; layer h is valid at this time + h."""
    grid: Grid
    layers: tuple[OccupancyLayer, ...]
    """Moving space per horizon, `HORIZONS_NS` in order."""
    static: OccupancyLayer
    """Space that stands still, at every horizon."""
    unknown_runs: UInt32
    """[r, 2] start and length of runs of flat indices that no camera sees; disjoint, increasing."""


@dataclass(frozen=True)
class Obstacles:
    """Convex shapes that together hold every occupied voxel over its whole interval."""

    stamp: int
    """Evidence, ns."""
    ids: UInt32
    """[n] stable under small motion."""
    kinds: UInt8
    """[n] values of `ObstacleKind`."""
    shapes: UInt8
    """[n] values of `ObstacleShape`."""
    positions: Float64
    """[n, 3] centres, m."""
    quats: Float64
    """[n, 4] w, x, y, z."""
    sizes: Float64
    """[n, 3] full extents of a box; diameter three times for a sphere, m."""
    velocities: Float64
    """[n, 3] m/s."""
    bounds: Float64
    """[n] calibrated error already inside the shape, m."""
    valid_from: NDArray[np.int64]
    """[n] ns."""
    valid_to: NDArray[np.int64]
    """[n] ns."""
    experts: UInt8 | None = None
    """[n] values of `MotionExpert`: which had the most weight in the forecast; None where nobody says."""
    reach_speeds: Float64 | None = None
    """[n] m/s, of what was seen: while forecasts are valid it is no farther from where it was seen than this times the
    time since the evidence less `reach_delays`. 0 where nobody says; None where that is so of all."""
    reach_delays: Float64 | None = None
    """[n] s, negative where it may be farther."""

    @classmethod
    def none(cls, stamp: int = 0) -> Obstacles:
        """No obstacle at all, by evidence of a stamp, ns."""
        three, one, kinds, times = np.zeros((0, 3)), np.zeros(0), np.zeros(0, np.uint8), np.zeros(0, np.int64)
        return cls(
            stamp, np.zeros(0, np.uint32), kinds, kinds, three, np.zeros((0, 4)), three, three, one, times, times
        )

    def only(self, chosen: Bool | NDArray[np.int64]) -> Obstacles:
        """Those of a mask [n], or of rows."""
        columns: dict[str, Any] = {name: values for name, values in vars(self).items() if name != "stamp"}
        columns = {name: None if values is None else values[chosen] for name, values in columns.items()}
        return Obstacles(stamp=self.stamp, **columns)

    @property
    def as_seen(self) -> Bool:
        """[n] what moved where it was seen: valid at the evidence alone; a forecast of the same things follows it."""
        return np.asarray((self.valid_to <= self.stamp) & (self.kinds == ObstacleKind.MOVING))

    @property
    def begins(self) -> int:
        """When the forecast of what moves, or else of the rest, begins, ns; that of the evidence if there is none."""
        told = ~self.as_seen
        moving = told & (self.kinds == ObstacleKind.MOVING)
        forecast = self.valid_from[moving if moving.any() else told]
        return int(forecast.min()) if len(forecast) else self.stamp


NO_EVIDENCE = 0
"""Evidence stamp of a decision that stands on none: nobody has forecast anything yet."""


@dataclass(frozen=True)
class Separation:
    """The arm's distance from the obstacles, what the law requires, and the speed it leaves."""

    stamp: int
    """When it was decided, ns."""
    evidence_stamp: int
    """Stamp of the obstacles' evidence, ns; `NO_EVIDENCE` where there is none."""
    distance: float
    """Smallest distance of any pair along the arm's next 200 ms, m; infinite without obstacles. Not always that of the
    pair named below."""
    required: float
    """Protective distance at full speed of the pair that decides, which falls most short of its own, m: the sum of the
    terms; 0 where none is closing in."""
    term_human: float
    """What the obstacle may cover until the arm stands still, m."""
    term_reaction: float
    """What the arm covers until it reacts, m."""
    term_stopping: float
    """What the arm covers while it stops, m."""
    term_intrusion: float
    """How far a body may reach before it is seen, m."""
    term_uncertainty: float
    """Position error of the obstacle and of the arm, m."""
    link: str
    """Of the pair that decides; where none is closing in, of the closest one; empty without obstacles."""
    obstacle_id: int
    """Of the same pair; -1 without obstacles."""
    speed_fraction: float
    """0 to 1."""
    reason: str

    @classmethod
    def without_pair(cls, stamp: int, evidence_stamp: int, speed_fraction: float, reason: str) -> Separation:
        """A speed that no pair of arm and obstacle decides: nothing near, no distance required. Stamps in ns."""
        return cls(
            stamp=stamp,
            evidence_stamp=evidence_stamp,
            distance=float("inf"),
            required=0.0,
            term_human=0.0,
            term_reaction=0.0,
            term_stopping=0.0,
            term_intrusion=0.0,
            term_uncertainty=0.0,
            link="",
            obstacle_id=-1,
            speed_fraction=speed_fraction,
            reason=reason,
        )
