"""Motion nodes: SE(3) frames that moving Gaussians live in, their filtered motion, and where they have been."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from twin_node.model.chosen import rows_where
from twin_node.model.kernels import kernels
from twin_node.model.node_requests import AdvanceRequest, MovedRequest
from twin_node.model.rotations import conjugate, quat_from_vector, quat_product, vector_from_quat
from twin_node.model.writes import Writes
from twin_node.native_library import address_of
from twin_node.scene import Float64, Tier

POSITION_GAIN, VELOCITY_GAIN = 0.9, 0.35
"""Alpha-beta filter of a node's pose: alpha near one because the measurement is the image itself, beta a quarter of the
critically damped value for that alpha, because published velocities are extrapolated 200 ms (Kalata, 1984)."""

MAX_SPEED, MAX_TURN = 5.0, 15.0
"""m/s and rad/s that no node exceeds: above a thrown arm's 4 m/s; more is a fit gone wrong."""

FORETOLD_NS = 1_000_000_000
"""Time from one set to the next for which nodes are foretold to go on as they did, ns: whoever reaches or walks has
turned or stopped after longer, and at constant velocity they would be metres away."""

NEVER: int = torch.iinfo(torch.int64).min
"""Stamp of a set of the window that has not come yet, before all others: clocks may begin anywhere."""


@dataclass(frozen=True)
class Poses:
    """Node poses at several times at once."""

    positions: Tensor
    """[T, M, 3] m."""
    quats: Tensor
    """[T, M, 4]."""


class Nodes:
    """At most `capacity` nodes (rows); poses are those at `stamp`, torch float64 on the CPU (they are few)."""

    def __init__(self, capacity: int, window: int) -> None:
        self.capacity = capacity
        self.stamp = 0
        self.alive = torch.zeros(capacity, dtype=torch.bool)
        self.ids = torch.zeros(capacity, dtype=torch.int64)
        self.tiers = torch.full((capacity,), int(Tier.RIGID), dtype=torch.uint8)
        self.positions = torch.zeros(capacity, 3, dtype=torch.float64)
        self.quats = torch.zeros(capacity, 4, dtype=torch.float64)
        self.velocities = torch.zeros(capacity, 3, dtype=torch.float64)
        self.angular_velocities = torch.zeros(capacity, 3, dtype=torch.float64)
        self.sigmas = torch.zeros(capacity, dtype=torch.float64)
        self.evidence = torch.zeros(capacity, dtype=torch.float64)
        self.anchors = torch.zeros(capacity, 3, dtype=torch.float64)
        self.births = torch.zeros(capacity, dtype=torch.int64)
        self.quats[:, 0] = 1
        self.history_stamps = torch.full((window,), NEVER, dtype=torch.int64)
        self._history_ids = torch.full((window, capacity), -1, dtype=torch.int64)
        self._history_positions = torch.zeros(window, capacity, 3, dtype=torch.float64)
        self._history_quats = torch.zeros(window, capacity, 4, dtype=torch.float64)
        self._slot = -1
        self._begun_positions, self._begun_quats = self.positions.clone(), self.quats.clone()
        self._next_id = 0
        self._learned, self._writes = torch.zeros(0, dtype=torch.int64), Writes()

    @property
    def rows(self) -> Tensor:
        """[m] rows of living nodes."""
        return rows_where(self.alive)

    @property
    def learned_rows(self) -> Tensor:
        """[m] rows of living nodes whose motion is learned: the arm's links follow its joints instead.

        Sought anew only when lives or tiers have changed. Callers must not write to them.
        """
        if self._writes.have_come(self.alive, self.tiers):
            learned = self.alive.numpy() & (self.tiers.numpy() != int(Tier.ROBOT))
            self._learned = torch.from_numpy(learned.nonzero()[0])
        return self._learned

    @property
    def free(self) -> int:
        """How many more nodes can be born."""
        return self.capacity - int(self.alive.count_nonzero())

    def give_birth(
        self, position: Tensor, velocity: Tensor, tier: Tier = Tier.RIGID, quat: Tensor | None = None
    ) -> int:
        """A node at `position` [3] with `velocity` [3] m/s, turned by `quat` [4] (None: not at all); returns its row.

        What the newest set has shown is not touched: its nodes may have ended since, and this one have taken a row.
        """
        row = int(torch.nonzero(~self.alive)[0, 0])
        self.alive[row] = True
        self.ids[row] = self._next_id
        self.tiers[row] = int(tier)
        self.positions[row] = position
        self.anchors[row] = position
        self.quats[row] = torch.tensor([1.0, 0, 0, 0], dtype=torch.float64) if quat is None else quat
        self._begun_positions[row], self._begun_quats[row] = self.positions[row], self.quats[row]
        self.velocities[row] = velocity
        self.angular_velocities[row] = 0
        self.sigmas[row] = 0.05
        self.evidence[row] = 0
        self.births[row] = self.stamp
        self._next_id += 1
        return row

    def retire(self, rows: Tensor) -> None:
        """Ends nodes; their rows are free again."""
        self.alive[rows] = False

    def predict(self, stamp: int, damping: float) -> None:
        """Moves poses on to `stamp` (ns) at constant velocity; velocities keep `damping` of themselves.

        After a pause of more than `FORETOLD_NS` nodes are looked for where they were. The arm's links stay where they
        are: where its joints have taken them is for `drive` to say.
        """
        elapsed_ns, driven = stamp - self.stamp, (self.tiers == int(Tier.ROBOT))[:, None]
        ahead = self.extrapolated([elapsed_ns * 1e-9 if elapsed_ns <= FORETOLD_NS else 0.0])
        self.positions = torch.where(driven, self.positions, ahead.positions[0])
        self.quats = torch.where(driven, self.quats, ahead.quats[0])
        self.velocities = self.velocities * damping
        self.angular_velocities = self.angular_velocities * damping
        self.stamp = stamp

    def correct(self, rows: Tensor, shifts: Tensor, turns: Tensor, dt_s: float) -> None:
        """Takes what the poses of `rows` were measured to be off by; updates velocities by an alpha-beta filter.

        `shifts` [m, 3] m and `turns` [m, 3] rad lead from the poses as they are to those measured; `dt_s` is the time
        since the set before.
        """
        positions, quats = (of.index_select(0, rows) for of in (self.positions, self.quats))
        at = advanced(positions, quats, shifts, turns, [POSITION_GAIN])
        self.positions.index_copy_(0, rows, at.positions[0])
        self.quats.index_copy_(0, rows, at.quats[0])
        velocities, angular = (of.index_select(0, rows).numpy() for of in (self.velocities, self.angular_velocities))
        gain = VELOCITY_GAIN / max(dt_s, 1e-3)
        self.set_velocities(rows, velocities + gain * shifts.numpy(), angular + gain * turns.numpy())

    def set_velocities(self, rows: Tensor, velocities: Float64, turns: Float64) -> None:
        """Nodes `rows` [m] have `velocities` [m, 3] m/s and `turns` [m, 3] rad/s from now on, as far as any may."""
        self.velocities.index_copy_(0, rows, torch.from_numpy(_limited(velocities, MAX_SPEED)))
        self.angular_velocities.index_copy_(0, rows, torch.from_numpy(_limited(turns, MAX_TURN)))

    def drive(self, rows: Tensor, positions: Tensor, quats: Tensor, dt_s: float) -> None:
        """Sets poses that are known (arm links) and derives their velocities from the step of `dt_s` that led there."""
        if dt_s > 0:
            self.velocities[rows] = (positions - self.positions[rows]) / dt_s
            turn = vector_from_quat(quat_product(quats, conjugate(self.quats[rows])))
            self.angular_velocities[rows] = turn / dt_s
        self.positions[rows] = positions
        self.quats[rows] = quats

    def remember(self) -> None:
        """Writes the present poses over the oldest of the window, or over those of the same stamp."""
        stamps = self.history_stamps.numpy()
        if stamps[self._slot] != self.stamp:
            self._slot = (self._slot + 1) % len(stamps)
        stamps[self._slot] = self.stamp
        for past, now in (
            (self._history_ids, self.ids),
            (self._history_positions, self.positions),
            (self._history_quats, self.quats),
        ):
            past.numpy()[self._slot] = now.numpy()
        self._begun_positions.copy_(self.positions)
        self._begun_quats.copy_(self.quats)

    @property
    def moved(self) -> Tensor:
        """[M, 6] m and rad (in `base_link`) from the poses remembered last, or at birth since, to the present ones."""
        library = kernels()
        if library is None:
            return self.moved_reference()
        moved = torch.empty(self.capacity, 6, dtype=torch.float64)
        held = [t.contiguous() for t in (self.positions, self.quats, self._begun_positions, self._begun_quats)]
        library.run(MovedRequest(self.capacity, *(t.data_ptr() for t in (*held, moved))))
        return moved

    def moved_reference(self) -> Tensor:
        """The same in torch: the reference of the compiled kernel."""
        turn = vector_from_quat(quat_product(self.quats, conjugate(self._begun_quats)))
        return torch.cat([self.positions - self._begun_positions, turn], 1)

    def poses_at(self, stamp: int) -> Poses:
        """Poses of one time, `stamp` (ns): interpolated inside the window, at constant velocity after its newest end.

        Before the window they are its oldest. A row that has changed hands between two sets has the newer node's pose,
        one that has done so since the newest set that node's at this set.
        """
        order = self._sets()
        older, newer = order[self.history_stamps[order] <= stamp], order[self.history_stamps[order] >= stamp]
        if not len(newer):
            ahead, last = self.extrapolated([(stamp - self.stamp) * 1e-9]), order[-1]
            same = (self._history_ids[last] == self.ids)[:, None]
            return Poses(
                torch.where(same, ahead.positions, self._history_positions[last]),
                torch.where(same, ahead.quats, self._history_quats[last]),
            )
        b = newer[0]
        a = older[-1] if len(older) else b
        span = float(self.history_stamps[b] - self.history_stamps[a])
        part = 1.0 if span == 0 else float(stamp - self.history_stamps[a]) / span
        share = torch.full((self.capacity, 1), part, dtype=torch.float64)
        share[self._history_ids[a] != self._history_ids[b]] = 1.0
        positions = torch.lerp(self._history_positions[a], self._history_positions[b], share)
        turn = vector_from_quat(quat_product(self._history_quats[b], conjugate(self._history_quats[a])))
        quats = quat_product(quat_from_vector(turn * share), self._history_quats[a])
        return Poses(positions[None], quats[None])

    def poses_before(self, stamp: int, ago_ns: int) -> Poses:
        """Poses, `ago_ns` before `stamp` (ns), of the nodes that `poses_at` tells of at `stamp`.

        Those that were not there yet have not moved: what had their rows then is another's.
        """
        now, before = self.poses_at(stamp), self.poses_at(stamp - ago_ns)
        same = (self._owners_at(stamp) == self._owners_at(stamp - ago_ns))[:, None]
        return Poses(torch.where(same, before.positions, now.positions), torch.where(same, before.quats, now.quats))

    def _owners_at(self, stamp: int) -> Tensor:
        """[M] ids of the nodes that `poses_at` tells of."""
        order = self._sets()
        newer = order[self.history_stamps[order] >= stamp]
        return self._history_ids[newer[0] if len(newer) else order[-1]]

    def _sets(self) -> Tensor:
        """Where in the window's arrays its sets are, oldest first."""
        known = torch.nonzero(self.history_stamps > NEVER)[:, 0]
        return known[self.history_stamps[known].argsort()]

    def extrapolated(self, seconds: list[float]) -> Poses:
        """Poses [T, M, ...] at `stamp` plus each of `seconds`, at constant velocity."""
        return advanced(self.positions, self.quats, self.velocities, self.angular_velocities, seconds)


def advanced(positions: Tensor, quats: Tensor, velocities: Tensor, turns: Tensor, seconds: list[float]) -> Poses:
    """Poses of `positions` [M, 3] and `quats` [M, 4], float64, after each of `seconds`.

    `velocities` [M, 3] m/s and `turns` [M, 3] rad/s (in `base_link`) stay as they are meanwhile.
    """
    library = kernels()
    if library is None:
        return advanced_reference(positions, quats, velocities, turns, seconds)
    given, times = [t.contiguous() for t in (positions, quats, velocities, turns)], np.array(seconds, np.float64)
    count = positions.shape[0]
    written = [torch.empty(len(seconds), count, width, dtype=torch.float64) for width in (3, 4)]
    pointers = (tensor.data_ptr() for tensor in (*given, *written))
    library.run(AdvanceRequest(len(seconds), count, address_of(times), *pointers))
    return Poses(*written)


def advanced_reference(
    positions: Tensor, quats: Tensor, velocities: Tensor, turns: Tensor, seconds: list[float]
) -> Poses:
    """The same in torch: the reference of the compiled kernel."""
    dt = torch.tensor(seconds, dtype=torch.float64)[:, None, None]
    return Poses(positions + velocities * dt, quat_product(quat_from_vector(turns * dt), quats.expand(len(dt), -1, -1)))


def _limited(vectors: Float64, longest: float) -> Float64:
    """Vectors [..., 3], those longer than `longest` cut to it."""
    length = np.sqrt(np.square(vectors).sum(-1, keepdims=True))
    cut: Float64 = vectors * np.minimum(longest / np.maximum(length, 1e-9), 1.0)
    return cut
