"""How far the arm is from itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_node.arm.narrow import segment_distances
from twin_node.robot import ArmModel, forward_kinematics, place_capsules
from twin_node.scene import Bool, Float64

_SAMPLES = 256
"""Random poses in which pairs are tried."""
_ALWAYS = 0.5
"""A pair that overlaps in more than this share of random poses overlaps by the way it is built."""


@dataclass(frozen=True)
class SelfClearance:
    """The arm's closest pair of its own links."""

    distance: float
    """Between surfaces, m; zero or negative in contact."""
    first: str
    """Link or attachment."""
    second: str


class SelfCollision:
    """Distances between the links of an arm that can meet.

    Neighbours are not paired, nor links that the model says never meet, nor capsules that overlap in most poses.
    """

    def __init__(self, model: ArmModel, names: tuple[str, ...]) -> None:
        """`names` [C] says what each of the model's capsules belongs to."""
        self._model = model
        self._names = names
        self._first, self._second = np.nonzero(self._can_meet())

    def distances(self, positions: NDArray[np.floating]) -> Float64:
        """Smallest distance [T] (m) at joint angles [T, J] (rad); infinite for an arm of which no links can meet."""
        nearest: Float64 = self._gaps(positions).min(axis=1, initial=np.inf)
        return nearest

    def closest(self, q: NDArray[np.floating]) -> SelfClearance:
        """Closest pair at joint angles [J] (rad)."""
        if len(self._first) == 0:
            return SelfClearance(float("inf"), "", "")
        gaps = self._gaps(np.asarray(q)[None])[0]
        pair = int(gaps.argmin())
        return SelfClearance(float(gaps[pair]), self._names[self._first[pair]], self._names[self._second[pair]])

    def _gaps(self, positions: NDArray[np.floating]) -> Float64:
        return self._pair_gaps(positions, self._first, self._second)

    def _pair_gaps(
        self, positions: NDArray[np.floating], first: NDArray[np.int64], second: NDArray[np.int64]
    ) -> Float64:
        """Distances [T, P] of pairs of capsules, m."""
        placed = place_capsules(self._model, forward_kinematics(self._model, positions))
        gaps: Float64 = segment_distances(placed.ends[:, first], placed.ends[:, second])
        return gaps - placed.radii[first] - placed.radii[second]

    def _can_meet(self) -> Bool:
        """True [C, C], upper triangle, for pairs of capsules worth looking at."""
        links = self._model.capsules.links
        apart = links[None, :] - links[:, None] >= 2
        for pair in self._model.never_meet:
            for one, other in (pair, pair[::-1]):
                apart &= ~np.outer(np.array(self._names) == one, np.array(self._names) == other)
        first, second = np.nonzero(apart)
        poses = self._model.random_positions(np.random.default_rng(0), _SAMPLES)
        overlapping = (self._pair_gaps(poses, first, second) <= 0).mean(axis=0) > _ALWAYS
        apart[first[overlapping], second[overlapping]] = False
        return np.asarray(apart)
