"""What a simulated cell's cameras have seen of its moving things: the truths that forecasts are scored against."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from twin_node.cell import SimulatedRig
from twin_node.cell.shapes import touched_voxels
from twin_node.cell.solids import Solid
from twin_node.forecast.comparison import Truth
from twin_node.forecast.score import litres_per_voxel
from twin_node.geometry import inverse_pose, transform
from twin_node.model.rays import back_project
from twin_node.scene import Float32, Float64, FrameSet, Grid, View

SEEN_PX = 3
"""A thing of which all cameras together show fewer pixels has not been seen: one may be noise."""
HALF_DIAGONAL = np.sqrt(3) / 2
"""Farthest from a voxel's middle that a surface through it can be, voxels."""


@dataclass(frozen=True)
class _Glance:
    """What one camera showed of the moving things at one time."""

    stamp: int
    """Of its exposure, ns."""
    surfaces: Mapping[int, Float32]
    """By thing, the points [n, 3] in m of its surface that are in view."""


class Sightings:
    """Exactly what the cameras of a simulated cell have seen of its moving things, set by set.

    Nothing of it comes from what the twin made of the images.
    """

    def __init__(self, simulated: SimulatedRig, grid: Grid) -> None:
        self.grid = grid
        self._simulated, self._world = simulated, simulated.world
        self._rows = {camera.name: row for row, camera in enumerate(simulated.cameras)}
        self._stamps: list[int] = []
        self._glances: list[tuple[_Glance, ...]] = []
        self._first_seen: dict[int, int] = {}
        self._first_moved: dict[int, int] = {}

    def look(self, frames: FrameSet) -> None:
        """Takes note of what a set's cameras see; sets come in rising order of stamps."""
        glances = tuple(self._glance(view) for view in frames.views)
        self._stamps.append(frames.stamp)
        self._glances.append(glances)
        for thing in self._world.moving_owners:
            shown = sum(len(glance.surfaces[thing]) for glance in glances)
            if thing not in self._first_seen and shown >= SEEN_PX:
                self._first_seen[thing] = frames.stamp
            is_new = thing in self._first_seen and thing not in self._first_moved
            if is_new and self._has_moved(thing, self._first_seen[thing], frames.stamp):
                self._first_moved[thing] = frames.stamp

    def seen_by(self, stamp: int) -> frozenset[int]:
        """Things that the cameras had seen at a stamp."""
        return frozenset(thing for thing, first in self._first_seen.items() if first <= stamp)

    def seen_moving_by(self, stamp: int) -> frozenset[int]:
        """Those that by then had moved by a voxel since they were first seen: what never did cannot be told to."""
        return frozenset(thing for thing, first in self._first_moved.items() if first <= stamp)

    def touched(self, stamp: int, things: Iterable[int]) -> Float64:
        """[n, 3] centres of the grid's voxels that some of the things touch at a stamp, m."""
        solids = self._solids(stamp, things)
        return self._centers([touched_voxels(solid.placed, self.grid) for solid in solids])

    def touched_by_seen(self, stamp: int, things: Iterable[int], evidence: int) -> Float64:
        """The same, only by what was in view at the newest set not after `evidence`.

        A voxel's middle, carried back with the solid that touches the voxel, must have been no farther than half a
        voxel's diagonal from a point of the same thing that a camera showed.
        """
        row = bisect_right(self._stamps, evidence) - 1
        if row < 0:
            return np.zeros((0, 3))
        chosen = frozenset(things)
        later = self._solids(stamp, chosen)
        touched = [touched_voxels(solid.placed, self.grid) for solid in later]
        shown = [np.zeros(len(voxels), np.bool_) for voxels in touched]
        for glance in self._glances[row]:
            trees = {thing: cKDTree(glance.surfaces[thing]) for thing in chosen if len(glance.surfaces[thing])}
            for number, then in enumerate(self._solids(glance.stamp, chosen)):
                if then.owner in trees and len(touched[number]):
                    back = then.placed.T_base_shape @ inverse_pose(later[number].placed.T_base_shape)
                    places = transform(back, self.grid.centers(touched[number]))
                    reach = HALF_DIAGONAL * self.grid.voxel_size
                    shown[number] |= np.isfinite(trees[then.owner].query(places, distance_upper_bound=reach)[0])
        return self._centers([voxels[mine] for voxels, mine in zip(touched, shown, strict=True)])

    def occupied(self, stamp: int) -> Float64:
        """[n, 3] centres of all voxels that a moving thing touches, m."""
        return self.touched(stamp, self._world.moving_owners)

    def _glance(self, view: View) -> _Glance:
        seen = self._simulated.see(self._rows[view.camera.name], view.stamp)
        points = back_project(view.camera, seen.depth).astype(np.float32)
        surfaces = {thing: points[seen.owners == thing] for thing in self._world.moving_owners}
        return _Glance(view.stamp, surfaces)

    def _has_moved(self, thing: int, since: int, now: int) -> bool:
        before, after = (self._solids(stamp, (thing,)) for stamp in (since, now))
        ways = [np.abs(b.placed.corners - a.placed.corners).max() for b, a in zip(before, after, strict=True)]
        return float(max(ways)) > self.grid.voxel_size

    def _solids(self, stamp: int, things: Iterable[int]) -> list[Solid]:
        chosen = frozenset(things)
        return [solid for solid in self._world.moving(stamp) if solid.owner in chosen]

    def _centers(self, voxels: list[NDArray[np.int64]]) -> Float64:
        return self.grid.centers(np.unique(np.concatenate([np.empty(0, np.int64), *voxels])))


class SeenThings(Truth):
    """Whole things of which anything had been seen by the forecast's evidence: their hidden sides and limbs too."""

    source = "things of the simulated cell that had been seen"

    def __init__(self, sightings: Sightings) -> None:
        self._sightings = sightings

    def points(self, stamp: int, evidence: int) -> Float64 | None:
        """[n, 3] centres of the voxels that they touch at a stamp, m."""
        return self._sightings.touched(stamp, self._sightings.seen_by(evidence))

    def occupied(self, stamp: int) -> Float64 | None:
        """The same of all that moves, seen or not."""
        return self._sightings.occupied(stamp)

    def volume_l(self, stamp: int) -> float | None:
        """Litres of these."""
        return len(self._sightings.occupied(stamp)) * litres_per_voxel(self._sightings.grid)


class SeenSurfaces(SeenThings):
    """What of the moving things was in view of a camera at the forecast's evidence, wherever it is when that is due.

    Things count from when they had moved by a voxel since they were first seen.
    """

    source = "surfaces of the simulated cell that a camera saw when the forecast was made"

    def points(self, stamp: int, evidence: int) -> Float64 | None:
        """[n, 3] centres of the voxels that they touch at a stamp, m."""
        return self._sightings.touched_by_seen(stamp, self._sightings.seen_moving_by(evidence), evidence)
