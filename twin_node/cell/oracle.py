"""Perfect perception of a simulated cell: the true obstacles, and their true motion as far ahead as one chooses."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from twin_node.cell.program import RunningProgram
from twin_node.cell.shadow import Shadow
from twin_node.cell.world import World
from twin_node.geometry import quat_from_rotation
from twin_node.robot import ArmModel, forward_kinematics, place_capsules
from twin_node.scene import HORIZONS_NS, Float64, ObstacleKind, Obstacles, ObstacleShape

INTERVAL_NS = 50_000_000
"""Length of an interval that an obstacle is valid for, ns: the step of the forecast's horizons."""
_STANDS_FOR_EVER_NS = 10**15
_NO_TURN = np.array([1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True)
class _Boxes:
    """Furniture as boxes."""

    centers: Float64
    """[n, 3] m."""
    rotations: Float64
    """[n, 3, 3]."""
    quats: Float64
    """[n, 4]."""
    sizes: Float64
    """[n, 3] m."""

    def near(self, points: Float64, reach_m: float) -> _Boxes:
        """Those within a distance of any of the points [m, 3]."""
        local = np.einsum("nij,mni->mnj", self.rotations, points[:, None] - self.centers)
        gaps = np.linalg.norm(np.maximum(np.abs(local) - self.sizes / 2, 0.0), axis=2).min(axis=0, initial=np.inf)
        rows = gaps < reach_m
        return _Boxes(self.centers[rows], self.rotations[rows], self.quats[rows], self.sizes[rows])


class Oracle:
    """Says where things truly are and will be, as obstacles."""

    def __init__(self, world: World, shadow: Shadow, reach_m: float) -> None:
        """Obstacles farther than `reach_m` from every point asked about are left out: they can slow nothing."""
        self._shadow = shadow
        self._reach_m = reach_m
        self._furniture = _furniture(world)

    def present(self, evidence: int, near: Float64) -> Obstacles:
        """Where everything is at a time (ns), valid at that time alone; `near` [n, 3] are points on the arm, m."""
        return self._obstacles(evidence, (evidence, evidence), near, measures=False)

    def foreseen(self, evidence: int, valid_from: int, ahead_ns: int, near: Float64) -> Obstacles:
        """Where everything truly will be over the time `ahead_ns` after `valid_from`, and how fast it then is."""
        count = max(-(-ahead_ns // INTERVAL_NS), 1)
        times = tuple(valid_from + min(i * INTERVAL_NS, ahead_ns) for i in range(count + 1))
        return self._obstacles(evidence, times, near, measures=True)

    def _obstacles(self, evidence: int, times: tuple[int, ...], near: Float64, measures: bool) -> Obstacles:
        shadow = self._shadow
        parts = []
        for layer, (begin, end) in enumerate(pairwise(times)):
            first, last = shadow.frame(begin), shadow.frame(end)
            over = shadow.points[first : last + 2]  # up to the sample after the end
            low, high = over.min(axis=0), over.max(axis=0)
            centers = (low + high) / 2
            radii = shadow.radii + np.linalg.norm(over - centers, axis=2).max(axis=0)
            rows = np.flatnonzero(self._is_near(centers, radii, near))
            seconds = max(len(over) - 1, 1) * shadow.step_ns * 1e-9
            velocities = (over[-1] - over[0])[rows] / seconds if measures else np.zeros((len(rows), 3))
            ids = (layer << 24) + rows
            parts.append(_Layer(ids, centers[rows], radii[rows], velocities, begin, end))
        return _joined(evidence, parts, self._furniture.near(near, self._reach_m))

    def _is_near(self, centers: Float64, radii: Float64, near: Float64) -> NDArray[np.bool_]:
        gaps = np.linalg.norm(centers[:, None] - near, axis=2).min(axis=1) - radii
        return np.asarray(gaps < self._reach_m)


class Foresight(Enum):
    """How far ahead of the evidence perfect perception sees."""

    NONE = "none"
    """Where things are, and nothing of how they move."""
    FORECAST = "forecast"
    """The true motion of the next 200 ms, as far as the twin forecasts."""
    UNLIMITED = "unlimited"
    """The true motion until the arm would stand from any speed."""


class PerfectPerception:
    """The oracle seen through cameras: evidence at their rate, known after the latency of the chain behind them."""

    def __init__(self, oracle: Oracle, model: ArmModel, foresight: Foresight, timing: Timing) -> None:
        self._oracle = oracle
        self._model = model
        self._ahead_ns = {Foresight.FORECAST: HORIZONS_NS[-1], Foresight.UNLIMITED: timing.until_standstill_ns}.get(
            foresight
        )
        self._timing = timing
        self._tick = -1

    def look(self, program: RunningProgram) -> Obstacles | None:
        """Obstacles of the newest images whose latency is over; None where none are new."""
        timing = self._timing
        tick = int((program.now - timing.latency_ns - timing.start_ns) * timing.rate_hz // 1e9)
        if tick <= self._tick:
            return None
        self._tick = tick
        evidence = timing.start_ns + round(tick * 1e9 / timing.rate_hz)
        near = points_on(self._model, program.q)
        if self._ahead_ns is None:
            return self._oracle.present(evidence, near)
        return self._oracle.foreseen(evidence, evidence + timing.latency_ns, self._ahead_ns, near)


@dataclass(frozen=True)
class Timing:
    """When perception learns of what."""

    start_ns: int
    """First evidence, ns."""
    rate_hz: float
    """Images per second."""
    latency_ns: int
    """From the images to the obstacles, ns."""
    until_standstill_ns: int
    """Longest time from the obstacles until the arm would stand, ns."""


def points_on(model: ArmModel, q: Float64) -> Float64:
    """Points [n, 3] (m) along the arm at joint angles [J] (rad): ends and middles of its capsules."""
    ends = place_capsules(model, forward_kinematics(model, q)).ends
    return np.concatenate([ends[:, 0], ends[:, 1], ends.mean(axis=1)])


@dataclass(frozen=True)
class _Layer:
    """Spheres of one interval."""

    ids: NDArray[np.int64]
    centers: Float64
    radii: Float64
    velocities: Float64
    begin: int
    end: int


def _joined(evidence: int, layers: list[_Layer], furniture: _Boxes) -> Obstacles:
    """Moving spheres, then standing boxes."""
    moving = sum(len(layer.ids) for layer in layers)
    standing = len(furniture.centers)
    counts = [len(layer.ids) for layer in layers]
    diameters = 2 * np.concatenate([layer.radii for layer in layers])
    split = [moving, standing]
    return Obstacles(
        stamp=evidence,
        ids=np.concatenate([*(layer.ids for layer in layers), (1 << 31) + np.arange(standing)]).astype(np.uint32),
        kinds=np.repeat([ObstacleKind.MOVING, ObstacleKind.STATIC], split).astype(np.uint8),
        shapes=np.repeat([ObstacleShape.SPHERE, ObstacleShape.BOX], split).astype(np.uint8),
        positions=np.concatenate([*(layer.centers for layer in layers), furniture.centers]),
        quats=np.concatenate([np.tile(_NO_TURN, (moving, 1)), furniture.quats]),
        sizes=np.concatenate([np.repeat(diameters[:, None], 3, axis=1), furniture.sizes]),
        velocities=np.concatenate([*(layer.velocities for layer in layers), np.zeros((standing, 3))]),
        bounds=np.zeros(moving + standing),
        valid_from=_times([layer.begin for layer in layers], counts, evidence, standing),
        valid_to=_times([layer.end for layer in layers], counts, evidence + _STANDS_FOR_EVER_NS, standing),
    )


def _times(layers: list[int], counts: list[int], furniture: int, standing: int) -> NDArray[np.int64]:
    return np.repeat([*layers, furniture], [*counts, standing]).astype(np.int64)


def _furniture(world: World) -> _Boxes:
    """The furniture's boxes, other shapes as the boxes about them."""
    placed = [solid.placed for solid in world.static]
    poses = np.array([box.T_base_shape for box in placed]).reshape(-1, 4, 4)
    return _Boxes(
        centers=poses[:, :3, 3],
        rotations=poses[:, :3, :3],
        quats=quat_from_rotation(poses[:, :3, :3]) if len(poses) else np.empty((0, 4)),
        sizes=np.array([2 * box.shape.half_extents for box in placed]).reshape(-1, 3),
    )
