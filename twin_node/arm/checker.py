"""How far the arm is from the obstacles: now, along a trajectory, and from itself."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twin_node.arm.attachment import AllowedRegion, Attachment
from twin_node.arm.cutting import cut_at
from twin_node.arm.errors import ArmError
from twin_node.arm.narrow import axis_distances, box_distances, point_in_box, sphere_distances
from twin_node.arm.obstacle_set import ObstacleSet
from twin_node.arm.scene import CollisionScene, refuse_more
from twin_node.arm.self_collision import SelfClearance, SelfCollision
from twin_node.robot import ArmModel, PlacedCapsules, arm_model, forward_kinematics, place_capsules
from twin_node.scene import Bool, Float64, Obstacles

_PAIRS_AT_ONCE = 100_000
"""Capsule-obstacle pairs looked at in one go: arrays of 0.8 MB stay in the cache."""

_ROUNDING_M = 1e-9
"""By which bounds of distances may be off, m."""


@dataclass(frozen=True)
class Clearance:
    """The arm's closest pair."""

    distance: float
    """Between surfaces, m; zero or negative in contact, infinite where there is no obstacle."""
    link: str
    """Link or attachment; empty where there is no obstacle."""
    obstacle_id: int
    """-1 where there is no obstacle."""
    on_arm: Float64
    """[3] witness point on the arm, m, in `base_link`; NaN where there is no obstacle."""
    on_obstacle: Float64
    """[3] witness point on the obstacle, m."""


@dataclass(frozen=True)
class Sweep:
    """An arm's poses one after the other, and the obstacles about the first of them."""

    positions: Float64
    """[T, J] rad."""
    placed: PlacedCapsules
    """The capsules at all of them."""
    bounds: Float64
    """[C, n] lower bounds of the distances at the first pose, m."""

    def at(self, steps: slice | NDArray[np.int64]) -> Sweep:
        """Some of the poses, the first one among them."""
        placed = PlacedCapsules(self.placed.ends[steps], self.placed.radii, self.placed.links)
        return Sweep(self.positions[steps], placed, self.bounds)


@dataclass(frozen=True)
class Approaches:
    """Pairs of capsules and obstacles, and how their distances change while the arm alone moves."""

    capsules: NDArray[np.int64]
    """[n] row in the checker's capsules."""
    obstacles: NDArray[np.int64]
    """[n] row in the obstacles."""
    distances: Float64
    """[T, n] m, at each of the arm's positions, the obstacle standing where it is."""


@dataclass(frozen=True)
class _Pair:
    """The closest pair at one step of a trajectory."""

    step: int
    capsule: int
    row: int
    """Of the obstacle."""
    ends: Float64
    """[2, 3] of the capsule, m."""
    distance: float
    """In closed form, m."""


_NO_CLEARANCE = Clearance(float("inf"), "", -1, np.full(3, np.nan), np.full(3, np.nan))


class ArmCollisionChecker:
    """Distances between an arm and the obstacles it was last given.

    Distances are in closed form, of the few pairs that bounds leave over; MuJoCo measures the closest pair again, for
    its witness points and depth, and the smaller distance counts. The first link does not move and is not looked at.
    Not thread-safe: one checker per thread.
    """

    def __init__(
        self,
        model: ArmModel | str | Path = "ur5e",
        tool: Attachment | None = None,
        max_obstacles: int = 1024,
        allowed: Sequence[AllowedRegion] = (),
    ) -> None:
        """`model` is an arm, or what `arm_model` takes; it takes at most `max_obstacles` spheres and as many boxes.

        Raises `RobotError` for an unknown arm.
        """
        self.bare_model = model if isinstance(model, ArmModel) else arm_model(model)
        self._allowed = tuple(allowed)
        self._max_obstacles = max_obstacles
        self._obstacles = ObstacleSet.empty()
        self._rebuild({} if tool is None else {tool.name: tool})

    @property
    def model(self) -> ArmModel:
        """The arm with all that it carries."""
        return self._model

    @property
    def capsule_names(self) -> tuple[str, ...]:
        """Link or attachment of each capsule of `model` [C]."""
        return self._names

    @property
    def obstacles(self) -> ObstacleSet:
        """The obstacles given last."""
        return self._obstacles

    def attach(self, part: Attachment) -> None:
        """Adds a part to what the arm carries, in place of one of the same name; rebuilds the scene.

        Raises `RobotError` for a part in millimetres; the arm then carries what it did.
        """
        self._rebuild({**self._attachments, part.name: part})

    def detach(self, name: str) -> None:
        """Takes an attachment off; raises `ArmError` where there is none of that name."""
        if name not in self._attachments:
            held = ", ".join(self._attachments) or "nothing"
            raise ArmError(f"attachment {name}: expected one that is attached, found {held}; check the name")
        self._rebuild({held: part for held, part in self._attachments.items() if held != name})

    def update(self, obstacles: Obstacles) -> None:
        """Takes the place of all obstacles given before.

        Raises `ArmError` for obstacles with values that are not finite, of unknown shape, or too many of them; the
        obstacles given before then stay.
        """
        incoming = ObstacleSet.of(obstacles)
        refuse_more(obstacles, self._max_obstacles)
        pieces = cut_at(obstacles, self._allowed, self._max_obstacles)
        self._obstacles, self._placed = incoming if pieces is obstacles else ObstacleSet.of(pieces), -1
        self._exempt = self._exemptions()

    def scene(self) -> CollisionScene:
        """The arm and the obstacles given last, of all layers, in a MuJoCo scene of its own.

        For viewers, planners and whoever steps it; there is room for `max_obstacles` spheres and as many boxes. The
        first one takes 0.2 s, others some milliseconds; nothing that is given later changes it.
        """
        scene = CollisionScene(self._model, self._max_obstacles)
        scene.place(self._obstacles.source)
        return scene

    def distance(self, q: NDArray[np.floating], stamp: int | None = None) -> Clearance:
        """Closest pair at joint angles [J] (rad), among the obstacles that count at a time (ns), or among all.

        Which count, `check` says. Raises `RobotError` for a wrong number of angles or one that is not finite, and
        `ArmError` for a time that the obstacles say nothing of.
        """
        angles = self._model.check_positions(q).reshape(1, -1)
        if stamp is None:
            return self._closest(angles, np.ones((1, len(self._obstacles)), bool))[0]
        return self._closest(angles, self._obstacles.counting_at(np.array([stamp])))[0]

    def check(self, positions: NDArray[np.floating], stamps: NDArray[np.integer]) -> tuple[Clearance, ...]:
        """Closest pair at every step of a trajectory: positions [T, J] (rad) at stamps [T] (ns), time against time.

        An obstacle counts at a step if it is valid at that step's stamp; before the forecast begins those count that it
        begins with. Raises `RobotError` or `ArmError` for a trajectory of the wrong shape or with values that are not
        finite, and for stamps that the obstacles say nothing of: of what comes after the last forecast nobody knows.
        """
        angles, times = self._trajectory(positions, stamps)
        return self._closest(angles, self._obstacles.counting_at(times))

    def sweep(self, positions: NDArray[np.floating]) -> Sweep:
        """Poses [T, J] (rad) among the obstacles given last, for `closest` and `approaches`.

        Raises `RobotError` for positions of the wrong shape or with values that are not finite, `ArmError` without any.
        """
        angles = self._model.check_positions(positions)
        if angles.ndim != 2 or len(angles) == 0:
            raise ArmError(
                f"sweep: expected positions [T, {self._model.joints}] of a pose at least, found {angles.shape}"
            )
        placed = place_capsules(self._model, forward_kinematics(self._model, angles))
        bounds = axis_distances(placed.ends[0], self._obstacles.centers)
        bounds -= placed.radii[:, None]
        bounds -= self._obstacles.outer_radii
        return Sweep(angles, placed, bounds)

    def closest(self, sweep: Sweep, stamps: NDArray[np.integer]) -> Clearance:
        """Closest pair over all steps of a trajectory; as `check`, but only that one gets its witness points."""
        angles, times = self._trajectory(sweep.positions, stamps)
        if len(self._obstacles) == 0:
            return _NO_CLEARANCE
        valid, placed = self._obstacles.counting_at(times), sweep.placed
        capsules, rows = np.nonzero(self._contenders(sweep, np.asarray(valid.any(axis=0))))
        if len(capsules) == 0:
            return _NO_CLEARANCE
        lower = self._outer(placed.ends[:, capsules], placed.radii[capsules], rows)
        lower[~valid[:, rows]] = np.inf
        steps, pairs = np.nonzero(lower <= (lower + self._obstacles.slack[rows]).min())
        capsules, rows = capsules[pairs], rows[pairs]
        distances = self._exact(placed.ends[steps, capsules], placed.radii[capsules], rows)
        best = int(distances.argmin())
        step, capsule = int(steps[best]), int(capsules[best])
        found = _Pair(step, capsule, int(rows[best]), placed.ends[step, capsule], float(distances[best]))
        return self._witnessed(angles, found)

    def approaches(self, sweep: Sweep, reach: Float64) -> Approaches:
        """Pairs within reach [n] (m, per obstacle; negative: leave it out) of the first of the poses.

        Their distances are given at all poses, the obstacles standing still.
        """
        placed = sweep.placed
        capsules, rows = np.nonzero((sweep.bounds <= reach) & (reach >= 0) & ~self._exempt)
        distances = self._exact(placed.ends[:, capsules], placed.radii[capsules], rows)
        near = distances[0] <= reach[rows]
        return Approaches(capsules[near], rows[near], distances[:, near])

    def self_distance(self, q: NDArray[np.floating]) -> SelfClearance:
        """Closest pair of the arm's own links and attachments at joint angles [J] (rad).

        Raises `RobotError` for a wrong number of angles or one that is not finite.
        """
        return self._self_collision.closest(self._model.check_positions(q))

    def _trajectory(
        self, positions: NDArray[np.floating], stamps: NDArray[np.integer]
    ) -> tuple[Float64, NDArray[np.int64]]:
        """Positions [T, J] and stamps [T] that fit each other."""
        angles = self._model.check_positions(positions)
        if angles.ndim != 2 or np.shape(stamps) != (len(angles),):
            raise ArmError(
                f"trajectory: expected positions [T, {self._model.joints}] and stamps [T], found {angles.shape} and "
                f"{np.shape(stamps)}; give one stamp per row"
            )
        return angles, np.asarray(stamps, dtype=np.int64)

    def _closest(self, positions: Float64, valid: Bool) -> tuple[Clearance, ...]:
        """Closest pair at each of the positions [T, J] among obstacles valid [T, n] there."""
        if len(self._obstacles) == 0:
            return (_NO_CLEARANCE,) * len(positions)
        pairs = self._nearest(positions, valid)
        return tuple(_NO_CLEARANCE if pair is None else self._witnessed(positions, pair) for pair in pairs)

    def _nearest(self, positions: Float64, valid: Bool) -> list[_Pair | None]:
        """Closest pair at each of the positions [T, J] among obstacles valid [T, n] there; None without any."""
        rows = max(_PAIRS_AT_ONCE // (len(self._names) * len(self._obstacles)), 1)
        found: list[_Pair | None] = []
        for first in range(0, len(positions), rows):
            part = slice(first, first + rows)
            placed = place_capsules(self._model, forward_kinematics(self._model, positions[part]))
            lower = self._axis_distances(placed) - placed.radii[:, None]
            lower -= self._obstacles.outer_radii
            lower[np.broadcast_to(self._exempt, lower.shape)] = np.inf
            lower[np.broadcast_to(~valid[part, None], lower.shape)] = np.inf
            found += self._among_candidates(first, placed, lower)
        return found

    def _among_candidates(self, first: int, placed: PlacedCapsules, lower: Float64) -> list[_Pair | None]:
        """Closest pair at each step from `first` on, given lower bounds [T, C, n] (infinite: leave out)."""
        upper = (lower + self._obstacles.slack).min(axis=(1, 2))
        steps, capsules, rows = np.nonzero((lower <= upper[:, None, None]) & np.isfinite(lower))
        distances = self._exact(placed.ends[steps, capsules], placed.radii[capsules], rows)
        starts = np.searchsorted(steps, np.arange(len(lower) + 1))
        found: list[_Pair | None] = []
        for step, (begin, end) in enumerate(itertools.pairwise(starts)):
            if begin == end:
                found.append(None)
                continue
            best = begin + int(distances[begin:end].argmin())
            capsule = int(capsules[best])
            ends = placed.ends[step, capsule]
            found.append(_Pair(first + step, capsule, int(rows[best]), ends, float(distances[best])))
        return found

    def _witnessed(self, positions: Float64, nearest: _Pair) -> Clearance:
        """A pair's clearance with the points that MuJoCo finds; where it misses a contact, a point inside both."""
        shapes, row = self._obstacles, nearest.row
        if row != self._placed:
            self._scene.place(shapes.source.only(np.array([row])))
            self._placed = row
        self._scene.pose(positions[nearest.step])
        pair = self._scene.measure(nearest.capsule, 0)
        on_arm, on_obstacle = pair.on_arm, pair.on_obstacle
        if nearest.distance <= 0 < pair.distance:
            box = (shapes.centers[row], shapes.rotations[row], shapes.half[row])
            on_arm = on_obstacle = point_in_box(nearest.ends, *box)
        smaller = min(nearest.distance, pair.distance)
        return Clearance(smaller, self._names[nearest.capsule], int(shapes.ids[row]), on_arm, on_obstacle)

    def _contenders(self, sweep: Sweep, valid: Bool) -> Bool:
        """[C, n] pairs of valid [n] obstacles one of which is the closest at some step.

        From one step to another no pair's distance changes by more than the capsule's faster end has moved.
        """
        ends = sweep.placed.ends
        travel = np.linalg.norm(ends - ends[0], axis=-1).max(axis=(0, 2))[:, None]
        lower = np.where(self._exempt | ~valid, np.inf, sweep.bounds)
        upper = (lower + (self._obstacles.slack + travel)).min()
        return np.asarray((lower <= upper + _ROUNDING_M + travel) & np.isfinite(lower))

    def _outer(self, ends: Float64, radii: Float64, rows: NDArray[np.int64]) -> Float64:
        """Distances [..., n] of capsules (ends [..., n, 2, 3], radii [n]) to spheres about obstacles (rows [n]), m."""
        shapes = self._obstacles
        return sphere_distances(ends, radii, shapes.centers[rows], shapes.outer_radii[rows])

    def _axis_distances(self, placed: PlacedCapsules) -> Float64:
        """Distances [T, C, n] of the capsules' axes to the obstacles' centres, m."""
        flat = axis_distances(placed.ends.reshape(-1, 2, 3), self._obstacles.centers)
        return flat.reshape(*placed.ends.shape[:2], -1)

    def _exact(self, ends: Float64, radii: Float64, rows: NDArray[np.int64]) -> Float64:
        """Exact distances [..., n] of capsules (ends [..., n, 2, 3], radii [n]) to obstacles (rows [n]), m."""
        shapes = self._obstacles
        round_ = shapes.is_sphere[rows]
        if not round_.any():
            return self._to_boxes(ends, radii, rows)
        out = np.empty(ends.shape[:-2])
        chosen, boxes = rows[round_], ~round_
        out[..., round_] = sphere_distances(
            ends[..., round_, :, :], radii[round_], shapes.centers[chosen], shapes.half[chosen, 0]
        )
        out[..., boxes] = self._to_boxes(ends[..., boxes, :, :], radii[boxes], rows[boxes])
        return out

    def _to_boxes(self, ends: Float64, radii: Float64, rows: NDArray[np.int64]) -> Float64:
        shapes = self._obstacles
        rotations = shapes.rotations[rows] if shapes.any_turned else None
        return box_distances(ends, radii, shapes.centers[rows], rotations, shapes.half[rows])

    def _rebuild(self, attachments: dict[str, Attachment]) -> None:
        model = self.bare_model
        names = [self.bare_model.link_names[link] for link in self.bare_model.capsules.links]
        for part in attachments.values():
            model = model.carrying(part.ends, part.radii)
            names += [part.name] * len(part.radii)
        self._attachments = attachments
        self._model = model
        self._names = tuple(names)
        self._self_collision = SelfCollision(self._model, self._names)
        self._scene = CollisionScene(self._model, capacity=1)  # of each shape: only one pair is measured at a time
        self._placed = -1
        """Row of the obstacle that stands in the scene; -1: none does."""
        self._exempt = self._exemptions()

    def _exemptions(self) -> Bool:
        """True [C, n] for pairs that are not looked at: the standing base's, and allowed contacts."""
        exempt = np.zeros((len(self._names), len(self._obstacles)), bool)
        exempt[self._model.capsules.links == 0] = True
        for region in self._allowed:
            rows = self._obstacles.is_static & self._obstacles.inside(region.lower, region.upper)
            rows |= self._obstacles.is_unseen & self._obstacles.reaching_into(region.lower, region.upper)
            exempt |= np.isin(self._names, region.links)[:, None] & rows
        return exempt
