"""What bundle adjustment of a rig over a board takes and gives (Triggs et al., A Modern Synthesis, 1999).

Unknowns are the cameras' poses, clocks, shutters and lenses, the board's course and, as an option, the places of its
corners. Every corner is held against the board at the time of its own row of its own image, so that clocks are told by
all that moves, and nothing is interpolated that was measured. The first camera is the origin and its clock the rig's.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from twin_node.rig.calibrate.boards import Corners
from twin_node.rig.calibrate.course import Course, Placed
from twin_node.rig.calibrate.course_prior import Hands
from twin_node.rig.calibrate.lenses import Lens
from twin_node.scene import Bool, Float64


@dataclass(frozen=True)
class Sighting:
    """The board as one camera saw it in one image."""

    camera: int
    board: int
    """Number of the set whose images share the board's pose, or of the stretch of its course."""
    corners: Corners
    time_s: float = 0.0
    """By the camera's own clock, from where the course's time begins; of no matter where the board stands still."""


@dataclass(frozen=True)
class BundleState:
    """What bundle adjustment estimates."""

    T_cam_rig: Float64
    """[C, 4, 4] map the rig's frame to each optical frame; the first is fixed."""
    course: Course
    """Of the board, in the rig's frame."""
    lenses: tuple[Lens, ...]
    points: Float64
    """[P, 3] the board's corners, m."""
    clocks: Float64
    """[C, 2] seconds to add to each camera's time at `reference_s`, and how fast that grows; the first are fixed."""
    readouts: Float64
    """[C] s from a camera's first row to its last, as a rolling shutter exposes them; stamps are the middle row's."""
    delays: Float64
    """[V] s by which each image was taken later than its stamp and its camera's clock say."""
    reference_s: float = 0.0
    """Time at which the clocks' offsets hold."""

    def rig_times(self, cameras: NDArray[np.int64], times: Float64) -> Float64:
        """[V] times (s) on the rig's clock of times [V] on those of cameras [V]."""
        offset, rate = self.clocks[cameras].T
        return np.asarray(times + offset + rate * (times - self.reference_s))

    def placed(self, sightings: Sequence[Sighting]) -> Placed:
        """The board's poses at the stamps of images of it."""
        cameras, boards = (np.array([getattr(s, name) for s in sightings]) for name in ("camera", "board"))
        times = self.rig_times(cameras, np.array([sighting.time_s for sighting in sightings]))
        return self.course.at(self.course.blend(boards, times))


class BoardFreedom(Enum):
    """What shape the board may have."""

    FLAT = "as stated"
    SHEET = "stretched along some direction, and bowed, as a sheet may be"
    BENT = "every corner somewhere else"


@dataclass(frozen=True)
class BundleOptions:
    """What is free."""

    lenses: bool = True
    """Focal lengths, principal points and distortion."""
    board: BoardFreedom = BoardFreedom.FLAT
    """The places of the board's corners, held by how far off boards are."""
    clocks: bool = True
    """Clock offsets and rates, where the board moves."""
    readouts: bool = True
    """How long rolling shutters take, where the board moves."""
    delays: bool = True
    """What stamps are off by one by one, where clocks are free."""


@dataclass(frozen=True)
class Layout:
    """Where each unknown beside the board's course stands in the covariance."""

    cameras: int
    lens_sizes: tuple[int, ...]
    """Parameters of each lens; empty where lenses are fixed."""
    clocks: bool
    readouts: bool
    shape: int
    """Numbers of the board's shape that are free, 0 where it is fixed."""

    def camera(self, i: int) -> slice:
        """Pose of camera i: turn about its own axes (rad), translation (m), as in `moved`; empty for the first."""
        return slice(6 * max(i - 1, 0), 6 * i)

    def lens(self, i: int) -> slice:
        """`Lens.parameters` of camera i; empty where lenses are fixed."""
        start = 6 * (self.cameras - 1) + sum(self.lens_sizes[:i])
        return slice(start, start + (self.lens_sizes[i] if self.lens_sizes else 0))

    def clock(self, i: int) -> slice:
        """Offset (s) and rate of camera i's clock; empty for the first and where clocks are fixed."""
        start = 6 * (self.cameras - 1) + sum(self.lens_sizes)
        return slice(start + 2 * max(i - 1, 0), start + 2 * i) if self.clocks else slice(start, start)

    def readout(self, i: int) -> slice:
        """Readout (s) of camera i; empty where they are fixed."""
        start = self.clock(self.cameras - 1).stop + (i if self.readouts else 0)
        return slice(start, start + self.readouts)

    @property
    def board(self) -> slice:
        """The board's shape: shares of the `sheet_shapes`; or all of its corners (m)."""
        start = self.readout(self.cameras - 1).stop
        return slice(start, start + self.shape)

    @property
    def size(self) -> int:
        """Number of these unknowns."""
        return int(self.board.stop)


@dataclass(frozen=True)
class BundleResult:
    """The estimate, what it leaves over and how sure it is."""

    state: BundleState
    sightings: tuple[Sighting, ...]
    """What was used, without outliers."""
    residuals: tuple[Float64, ...]
    """Per sighting: [N, 2] found minus projected, pixels."""
    noise_px: Float64
    """[C] 1 sigma of each camera's corners, pixels."""
    jitter_s: Float64
    """[C] 1 sigma of each camera's `delays`, s; 0 where they are fixed."""
    hands: Hands
    """How the board was moved."""
    doubt: Callable[[], Float64]
    """Works out the `covariance`."""
    layout: Layout
    left_out: tuple[Sighting, ...]
    """Sightings with too few corners that fit; the corners are those that were found."""
    kept: Bool
    """[V, P] which corners of the board were used, of all sightings that were given."""

    @cached_property
    def covariance(self) -> Float64:
        """[n, n] of the unknowns in `layout`; worked out when first asked for, as of two boards tried one is left."""
        return self.doubt()
