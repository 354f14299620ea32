"""Where the bodies that nodes carry will be: the motion experts on poses, turns included."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_node.forecast.experts import EXPERT_NAMES
from twin_node.forecast.prediction import Predictor
from twin_node.forecast.tracks import Tracks
from twin_node.geometry import rotation_from_quat
from twin_node.scene import Float64, NodeStates

ARM_M = 0.1
"""Distance of the points that stand for a node's turn from its middle, m: the half of a hand, or of a block."""
CORNERS = ARM_M * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0], [0, -1, 0], [0, 0, -1]])
"""[7, 3] m, the points whose paths stand for a node's: their middle, and six about it."""


@dataclass(frozen=True)
class Moves:
    """Rigid motions of M nodes from now to a later time: x -> R (x - middle) + middle + shift."""

    R: Float64
    """[M, 3, 3]."""
    shifts: Float64
    """[M, 3] m."""
    middles: Float64
    """[M, 3] m, where the nodes are now."""

    def moved(self, points: Float64, node: int) -> Float64:
        """Points [n, 3] (m) of a node, by its row, at the later time."""
        middle = self.middles[node]
        there: Float64 = (points - middle) @ self.R[node].T + middle + self.shifts[node]
        return there


class NodeMotion:
    """Forecasts nodes set by set.

    A pose is the places of `CORNERS`, which the experts forecast as they do any points; the rigid motion that fits
    their forecasts best is the node's (Kabsch, 1976). So a turn is forecast by the experts too, and mixed by how well
    each did.
    """

    def __init__(self) -> None:
        self._predictor = Predictor()
        self._tracks = Tracks()
        self._ids = np.zeros(0, np.int64)

    def advance(self, stamp: int, nodes: NodeStates, horizon_s: float) -> None:
        """Takes in the nodes at `stamp` (ns) and forecasts them for `horizon_s` from then."""
        ids = nodes.ids.astype(np.int64)
        known = {int(node): row for row, node in enumerate(self._ids)}
        before = np.array([known.get(int(node), -1) for node in ids], np.int64)
        count = len(CORNERS)
        rows = np.where(before[:, None] < 0, -1, count * before[:, None] + np.arange(count)).reshape(-1)
        turned = np.einsum("mij,kj->mki", rotation_from_quat(nodes.quats), CORNERS)
        corners = (nodes.positions[:, None] + turned).reshape(-1, 3)
        association = self._tracks.extend(stamp * 1e-9, corners, rows)
        self._predictor.advance(self._tracks.history, association, horizon_s)
        self._ids = ids

    def ahead(self, horizon_s: float) -> Moves:
        """What the mixture of experts expects of the nodes of the last `advance` after `horizon_s`."""
        return self._fitted(self._predictor.predict(np.array([horizon_s])).displacements[0])

    def ahead_by(self, expert: str, horizon_s: float) -> Moves:
        """What one expert, a name of `EXPERT_NAMES`, expects."""
        return self._fitted(self._predictor.single(np.array([horizon_s]))[EXPERT_NAMES.index(expert), 0])

    def _fitted(self, displacements: Float64) -> Moves:
        """The rigid motions that displacements [7 M, 3] of the corners are nearest to."""
        here = self._tracks.positions[-1].reshape(-1, len(CORNERS), 3)
        there = here + displacements.reshape(here.shape)
        a, b = here - here.mean(1, keepdims=True), there - there.mean(1, keepdims=True)
        U, _, Vt = np.linalg.svd(np.swapaxes(b, 1, 2) @ a)
        U[..., -1] *= np.sign(np.linalg.det(U @ Vt))[:, None]
        return Moves(U @ Vt, (there - here).mean(1), here.mean(1))
