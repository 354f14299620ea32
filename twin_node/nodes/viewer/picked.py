"""What was picked, followed from picture to picture: what is known of it now, and where it has been."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_node.messages import convert
from twin_node.nodes.snapshot import Said, Snapshot, in_force, placed_obstacles
from twin_node.nodes.topics import GAUSSIANS, GAUSSIANS_MOVING, OBSTACLES
from twin_node.nodes.viewer.picking import Pick
from twin_node.scene import Float64, GaussianCloud, MotionExpert, ObstacleKind, Obstacles, ObstacleShape, Tier

HISTORY_NS = 2_000_000_000
"""How far back a thing is followed, ns: what a person remembers of a motion just seen."""
BETWEEN_NS = 50_000_000
"""Time between two remembered places, ns: half the fastest that a limb swings to and fro."""
GAP_NS = 500_000_000
"""A jump in time as long as this, or back, ns: the log was sought, and the history is read anew."""
TOLD_S = (0.5, 1.0, 1.5, 2.0)
"""Ages of the places that are told, s."""


@dataclass(frozen=True)
class Place:
    """Where a thing was."""

    stamp: int
    """ns."""
    position: Float64
    """[3] m."""


class PickedThing:
    """Follows an obstacle or a Gaussian; obstacles whose id has gone, by place: their ids name cells of space."""

    def __init__(self, picked: Pick) -> None:
        self._picked = picked
        self._places: deque[Place] = deque()
        self._is_older = True

    @property
    def trail(self) -> Float64:
        """[n, 3] m where it has been in the last two seconds, oldest first."""
        return np.array([place.position for place in self._places]).reshape(-1, 3)

    def describe(self, snapshot: Snapshot) -> str:
        """Markdown about the thing as it is now, and how it came here."""
        return self._obstacle(snapshot) if self._picked.is_obstacle else self._gaussian(snapshot)

    def _obstacle(self, snapshot: Snapshot) -> str:
        o = in_force(snapshot.obstacles, snapshot.stamp)
        row = _row_of(o, self._picked, None if self._is_sought(snapshot.stamp) else self._places[-1].position)
        if row is None:
            self._places.clear()
            return f"**Obstacle {self._picked.id}** is no more."
        self._picked = _picked_row(o, row)
        self._come_to(Place(snapshot.stamp, o.positions[row]), snapshot, (OBSTACLES,))
        size = " x ".join(f"{100 * side:.0f}" for side in o.sizes[row])
        shape = ObstacleShape(int(o.shapes[row])).name.lower()
        return "\n".join(
            [
                f"**Obstacle {o.ids[row]}**, {ObstacleKind(int(o.kinds[row])).name} {shape}",
                f"- {size} cm at {_point(o.positions[row])} m",
                f"- speed {np.linalg.norm(o.velocities[row]):.2f} m/s",
                f"- error bound {100 * o.bounds[row]:.1f} cm, inside its size",
                *_expert_of(o, row),
                *self._told(),
            ]
        )

    def _gaussian(self, snapshot: Snapshot) -> str:
        cloud = snapshot.cloud_now
        row = None if cloud is None else _row_of_gaussian(cloud, self._picked)
        if cloud is None or row is None:
            self._places.clear()
            return f"**Gaussian {self._picked.id}** is no more."
        tier = Tier(int(cloud.tiers[row]))
        sigmas = " x ".join(f"{1000 * s:.1f}" for s in cloud.scales[row])
        lines = [
            f"**Gaussian {cloud.ids[row]}**, {tier.name}",
            f"- {sigmas} mm (1 sigma) at {_point(cloud.means[row])} m, opacity {cloud.opacities[row]:.2f}",
        ]
        place = cloud.means[row].astype(np.float64)
        if tier is Tier.STATIC:
            self._places = deque([Place(snapshot.stamp, place)])
            return "\n".join([*lines, "- does not move: it has no motion parameters"])
        self._come_to(Place(snapshot.stamp, place), snapshot, (GAUSSIANS_MOVING, GAUSSIANS))
        speed = float(np.linalg.norm(cloud.velocities[row]))
        return "\n".join([*lines, f"- speed {speed:.2f} m/s", *_bound_at(snapshot, place), *self._told()])

    def _is_sought(self, stamp: int) -> bool:
        return not self._places or not 0 <= stamp - self._places[-1].stamp <= GAP_NS

    def _come_to(self, place: Place, snapshot: Snapshot, topics: Sequence[str]) -> None:
        """Remembers where the thing is now; after a jump in time, reads where it was from what was said before.

        On one of `topics` after the other: a Gaussian that moves may have stood before, which whole clouds alone tell.
        """
        if self._is_sought(place.stamp):
            self._places = deque([place])
            before = [snapshot.earlier(topic, HISTORY_NS) for topic in topics]
            self._is_older = any(before)
            for said in before:
                self._read_history(said)
        elif place.stamp - self._places[-1].stamp >= BETWEEN_NS:
            self._places.append(place)
        while place.stamp - self._places[0].stamp > HISTORY_NS:
            self._places.popleft()
            self._is_older = True

    def _read_history(self, said: Sequence[Said]) -> None:
        """Follows the thing back through messages, oldest first, until it is not there."""
        picked = self._picked
        for entry in reversed(said):
            first = self._places[0]
            if entry.stamp > first.stamp - BETWEEN_NS:
                continue
            if picked.is_obstacle:
                obstacles = placed_obstacles(entry.message)
                obstacles = in_force(obstacles, obstacles.stamp)
                row = _row_of(obstacles, picked, first.position)
                positions, picked = obstacles.positions, picked if row is None else _picked_row(obstacles, row)
            else:
                cloud = convert.gaussians_from_pointcloud2(entry.message)
                row = _row_of_gaussian(cloud, picked)
                positions = cloud.means.astype(np.float64)
            self._is_older = row is not None
            if row is None:
                return
            self._places.appendleft(Place(entry.stamp, positions[row]))

    def _told(self) -> Iterable[str]:
        """How long it has been known, how far it moved, and where it was."""
        first, now = self._places[0], self._places[-1]
        age = (now.stamp - first.stamp) / 1e9
        moved = 100 * np.linalg.norm(now.position - first.position)
        yield f"- known for {age:.1f} s{' or longer' if self._is_older else ''}; moved {moved:.1f} cm since"
        for told in TOLD_S:
            nearest = min(self._places, key=lambda place: abs((now.stamp - place.stamp) / 1e9 - told))
            if abs((now.stamp - nearest.stamp) / 1e9 - told) < 0.25:
                yield f"- {told:.1f} s ago at {_point(nearest.position)} m"


def _row_of(obstacles: Obstacles, picked: Pick, near: Float64 | None) -> int | None:
    """The obstacle of the picked id; else the one of its kind that holds the place [3] where it was last."""
    rows = np.flatnonzero((obstacles.ids == picked.id) & (obstacles.kinds == picked.kind))
    if len(rows):
        return int(rows[0])
    if near is None:
        return None
    apart = np.linalg.norm(obstacles.positions - near, axis=1)
    reach = obstacles.sizes.max(axis=1, initial=0) / 2
    candidates = np.flatnonzero((obstacles.kinds == picked.kind) & (apart <= reach))
    return int(candidates[apart[candidates].argmin()]) if len(candidates) else None


def _picked_row(obstacles: Obstacles, row: int) -> Pick:
    return Pick(int(obstacles.ids[row]), ObstacleKind(int(obstacles.kinds[row])))


def _row_of_gaussian(cloud: GaussianCloud, picked: Pick) -> int | None:
    rows = np.flatnonzero(cloud.ids == picked.id)
    return int(rows[0]) if len(rows) else None


def _bound_at(snapshot: Snapshot, place: Float64) -> list[str]:
    """The error bound of the moving obstacle about a place [3], which is that of what moves there."""
    o = in_force(snapshot.obstacles, snapshot.stamp)
    about = np.flatnonzero((o.kinds == ObstacleKind.MOVING) & (np.abs(o.positions - place) <= o.sizes / 2).all(axis=1))
    if not len(about):
        return ["- no moving obstacle holds it"]
    row = int(about[o.sizes[about].prod(axis=1).argmin()])
    return [f"- error bound {100 * o.bounds[row]:.1f} cm, of obstacle {o.ids[row]} about it", *_expert_of(o, row)]


def _expert_of(obstacles: Obstacles, row: int) -> list[str]:
    """Who forecasts it, where the twin says so."""
    if obstacles.experts is None or obstacles.experts[row] == MotionExpert.NO_EXPERT:
        return []
    return [f"- forecast mostly by {MotionExpert(int(obstacles.experts[row])).name.lower().replace('_', ' ')}"]


def _point(place: NDArray[np.floating]) -> str:
    return "(" + ", ".join(f"{value:.2f}" for value in place) + ")"
