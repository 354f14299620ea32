"""What one state shows, before any forecast: what moves and how fast, what stands, what nobody sees."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from twin_node.forecast.agreement import Estimate
from twin_node.forecast.bits import Bits
from twin_node.forecast.bound import PERSON_SPEED
from twin_node.forecast.carving import Carver
from twin_node.forecast.concealing import concealed
from twin_node.forecast.hiding import Hidden, HidingPlaces
from twin_node.forecast.landing import Landing, landing_of
from twin_node.forecast.lone import LoneSights
from twin_node.forecast.margin import RIM_S, Margin
from twin_node.forecast.nearest import nearest_one
from twin_node.forecast.neighbours import Closest, closest
from twin_node.forecast.own_space import own_space
from twin_node.forecast.part_velocities import PartVelocities
from twin_node.forecast.parts import Parts, split
from twin_node.forecast.resting import Resting
from twin_node.forecast.sights import CarvingParameters
from twin_node.forecast.specks import of_things
from twin_node.forecast.static import StaticParameters, StaticSpace
from twin_node.forecast.tables import RigTables
from twin_node.forecast.things import Whole
from twin_node.forecast.tracks import REACH
from twin_node.forecast.verdicts import Carved
from twin_node.robot import ArmModel
from twin_node.scene import Bool, Float64, Grid, OccupancyLayer, TwinState, UInt32, read_only
from twin_node.side_thread import SideThread, Task


@dataclass(frozen=True)
class Unseen:
    """What one state does not show."""

    unknown_runs: UInt32
    """[r, 2] runs of flat indices that nothing frees and nothing explains, and what the arm hides from all views."""
    hidden: Hidden
    """What may be in these."""


@dataclass(frozen=True)
class Evidence:
    """What one state shows."""

    stamp: int
    """ns."""
    parts: Parts
    """The moving space: flat indices in the outer grid, coordinates in the inner one."""
    motion: Estimate
    """Of the parts."""
    whole: Whole
    """What following small things as wholes tells of them."""
    landing: Landing
    """What those of them meet that fall."""
    static: OccupancyLayer
    """What stands."""
    near: Task[Closest]
    """Which parts are nearest to each, found out meanwhile: only their forecast asks for it."""
    unseen: Task[Unseen]
    """Found out meanwhile, for no forecast depends on it."""
    resting: NDArray[np.int64]
    """[n] flat indices in the outer grid of what stands, but moved a while ago and may start again (`Resting`)."""
    has_lone_sights: bool
    """Whether one camera alone shows something move that it does not measure (`LoneSights`)."""
    warnings: tuple[str, ...]
    """What a reader must know of the cameras (`LookingPast`)."""


@dataclass(frozen=True)
class _Standing:
    """What stands, as several states in a row use it."""

    source: OccupancyLayer
    """In the outer grid."""
    mask: Bits
    """Of the outer grid."""
    inner: OccupancyLayer
    """In the inner grid."""

    @classmethod
    def of(cls, static: OccupancyLayer, margin: Margin) -> _Standing:
        """Of a layer of the outer grid."""
        mask = Bits.of_indices(margin.outer.dims, static.indices)
        standing = margin.cropped(mask).indices().astype(np.uint32)
        certain = np.full(len(standing), 255, np.uint8)
        return cls(static, mask, OccupancyLayer(static.horizon_ns, read_only(standing), read_only(certain)))


class Observer:
    """Turns states into evidence on one grid and a rim about it."""

    def __init__(
        self, grid: Grid, carving: CarvingParameters, static: StaticParameters, arm: ArmModel | None = None
    ) -> None:
        """`arm`: where the states' joints are those of this arm, its own space is left out."""
        self._arm = arm
        self.margin = Margin(grid, PERSON_SPEED * RIM_S)
        self.grid = self.margin.outer
        self.tables = RigTables(self.grid)
        self._carver = Carver(self.tables, carving)
        self._velocities = PartVelocities(self.tables)
        self._static = StaticSpace(self.grid, static)
        self._hiding = HidingPlaces(self.grid)
        self._side_thread = SideThread(patience_s=_PATIENCE_S)
        self._task: Task[Unseen] | None = None
        self._resting = Resting(self.grid)
        self._lone = LoneSights(self.tables)
        self._standing: _Standing | None = None
        self._unseen = Bits.none(self.grid.dims)
        self._last_centers = np.zeros((0, 3))
        self._last = Estimate.unknown(0)
        self._last_stamp = 0

    def observe(self, state: TwinState, anew: bool = False) -> Evidence:
        """The evidence of a state; states come in rising order of stamps.

        `anew`: what was known of how things move no longer holds.
        """
        own = self._own_space(state)
        shown = self._carve(state, own)
        found = shown if own is None else shown.without(own)  # its shadow stays unknown
        if anew:
            self._velocities = PartVelocities(self.tables)
            self._last_centers, self._last = np.zeros((0, 3)), Estimate.unknown(0)
        parts, carved = self._without_specks(found)
        near = self._side_thread.begin(partial(closest, parts.centers))
        static = self._static.update(state, self._carver, own, shown)
        if self._standing is None or self._standing.source is not static:
            self._standing = _Standing.of(static, self.margin)
        stands = self._standing.mask
        hiding, self._unseen = concealed(carved, own is not None, stands, self._unseen)
        is_lone = self._lone.update(state, parts.indices, hiding)
        someone = carved.may_move | Bits.of_indices(self.grid.dims, self._lone.within)
        behind = self._look_behind(state.stamp, hiding, someone, stands)
        motion, whole = self._velocities.update(state, parts, self._expected(state.stamp, parts.centers))
        self._last_stamp, self._last_centers, self._last = state.stamp, parts.centers, motion
        limbs = parts.likely & ~whole.alone[parts.labels]
        return Evidence(
            stamp=state.stamp,
            parts=replace(parts, places=self.margin.places(parts.places)),
            motion=motion,
            whole=whole,
            landing=landing_of(self.grid, stands, parts.centers, parts.solid, whole, own),
            static=self._standing.inner,
            near=near,
            unseen=behind,
            resting=self._resting.update(state.stamp, parts.indices[limbs], stands),
            has_lone_sights=is_lone,
            warnings=self._carver.warnings,
        )

    def _carve(self, state: TwinState, own: Bits | None) -> Carved:
        """What the views say of the outer grid. Of the first ones what stands is found first, for some of them may not
        measure it."""
        if self._standing is None:
            self._carver.carve(state, 0.0)
            self._standing = _Standing.of(self._static.update(state, self._carver, own), self.margin)
        return self._carver.carve(state, self._speed(), self._static.opaque)

    def _look_behind(self, stamp: int, unknown: Bits, moving: Bits, stands: Bits) -> Task[Unseen]:
        """What there may be in the inner grid's `unknown` space; states are followed one after the other."""
        before, self._task = self._task, None  # one that failed says so once
        if before is not None:
            before.result()
        unseen = self._unseen

        def look() -> Unseen:
            hidden = self._hiding.update(stamp, unknown, moving, stands)
            return Unseen(
                self.margin.cropped(unseen).runs(),
                Hidden(self.margin.cropped(hidden.reachable), self.margin.cropped(hidden.maybe_full)),
            )

        self._task = self._side_thread.begin(look)
        return self._task

    def frees(self, state: TwinState, indices: NDArray[np.int64]) -> Bool:
        """Whether some camera frees each of the voxels `indices` [n] of the outer grid, by the last state."""
        return self._carver.frees(state, indices)

    def places(self, indices: NDArray[np.int64]) -> NDArray[np.int32]:
        """Voxel coordinates [3, n] in the inner grid, also of voxels beside it, of flat `indices` [n] in the outer."""
        return self.margin.places(np.stack(np.unravel_index(indices, self.grid.dims)).astype(np.int32))

    def _without_specks(self, carved: Carved) -> tuple[Parts, Carved]:
        """The moving space in parts, and what is carved, without specks: nothing explains those."""
        moving = carved.may_move.listed(carved.likely_moves)
        parts = split(self.grid, moving.indices.astype(np.int64), moving.marked)
        kept = of_things(self.grid, parts)
        if kept.all():
            return parts, carved
        parts = parts.of(kept)
        return parts, carved.moved_only(Bits.of_indices(self.grid.dims, parts.indices))

    def _own_space(self, state: TwinState) -> Bits | None:
        """What the arm takes up itself; None where there is none, or nobody tells of its joints."""
        if self._arm is None or state.frames.joints is None:
            return None
        return own_space(self.grid, self._arm, state.frames.joints.at(state.frames.stamp))

    def _speed(self) -> float:
        """How fast things moved last, m/s: so that `_FAST_SHARE` of the parts were slower."""
        speeds = np.sort(np.linalg.norm(self._last.velocities, axis=1))
        if len(speeds) == 0:
            return 0.0
        place = _FAST_SHARE * (len(speeds) - 1)
        slower, faster = speeds[int(place)], speeds[min(int(place) + 1, len(speeds) - 1)]
        return float(slower + (faster - slower) * (place % 1))

    def _expected(self, stamp: int, centers: Float64) -> Estimate:
        """How the parts move that were nearest before, as far as that still holds; nothing is known of others."""
        before = self._last.after((stamp - self._last_stamp) * 1e-9)
        if len(self._last_centers) == 0 or len(centers) == 0:
            return Estimate.unknown(len(centers))
        return before.of(nearest_one(centers, self._last_centers, REACH).rows)


_PATIENCE_S = 1e-3
"""Tasks take less than this from who asks for them where their thread is scheduled, s."""
_FAST_SHARE = 0.95
"""Of the parts; single ones may be told wrong."""
