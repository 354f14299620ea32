"""Paths through waypoints: where a body is at any time."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from twin_node.cell.errors import CellError
from twin_node.geometry import pose
from twin_node.scene import Float64

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

GRAVITY = 9.81
"""m/s^2."""

FARTHEST_M = 1000.0
"""Nothing stands, looks, goes or reaches farther along an axis, m: who gives more means millimetres."""

BETWEEN = ("linear", "minimum_jerk", "ballistic", "spline")
"""Ways to get from one waypoint to the next."""


@dataclass(frozen=True)
class Path:
    """A motion through waypoints; before the first and after the last the body rests there."""

    times_s: tuple[float, ...] = (0.0,)
    """[n] strictly increasing, s after the scenario's start."""
    positions: tuple[tuple[float, float, float], ...] = ((0.0, 0.0, 0.0),)
    """[n] m in `base_link`."""
    rpy_deg: tuple[tuple[float, float, float], ...] = ()
    """[n] roll, pitch, yaw about the fixed axes x, y, z in degrees; empty: no rotation. May exceed a turn."""
    between: str = "minimum_jerk"
    """linear; minimum_jerk: rests at each waypoint (Flash and Hogan 1985, a human reach); ballistic: in free flight
    from one waypoint to the next; spline: smooth through all, C2."""
    repeat: bool = False
    """Start again at the first waypoint after the last."""

    def __post_init__(self) -> None:
        times = np.array(self.times_s)
        if not len(times) or np.any(np.diff(times) <= 0):
            raise CellError(f"path: times_s must be one or more rising numbers, found {list(self.times_s)}")
        if len(self.positions) != len(times) or len(self.rpy_deg) not in (0, len(times)):
            raise CellError(
                f"path: {len(times)} times_s need {len(times)} positions and as many rpy_deg or none, "
                f"found {len(self.positions)} and {len(self.rpy_deg)}"
            )
        if not (np.abs(self.positions) <= FARTHEST_M).all():
            farthest = max(self.positions, key=lambda position: float(np.abs(position).max()))
            raise CellError(
                f"path: expected positions in metres, at most {FARTHEST_M:g} from base_link, found {list(farthest)}"
            )
        if self.between not in BETWEEN:
            raise CellError(f"path: between must be one of {', '.join(BETWEEN)}, found '{self.between}'")

    @property
    def moves(self) -> bool:
        """Whether the body ever leaves its first pose; what is thrown straight up does."""
        flies = self.between == "ballistic" and len(self.positions) > 1
        return flies or len(set(self.positions)) > 1 or len(set(self.rpy_deg)) > 1

    @cached_property
    def _knots(self) -> Float64:
        """[n, 6] positions in metres and rotations in degrees."""
        return np.hstack([self.positions, self.rpy_deg or np.zeros((len(self.times_s), 3))]).astype(np.float64)

    @cached_property
    def _spline(self) -> CubicSpline:
        from scipy.interpolate import CubicSpline  # loads slowly, and who only reads a scenario never asks

        return CubicSpline(self.times_s, self._knots, bc_type="clamped")

    def pose(self, t: float, pace: float = 1.0) -> Float64:
        """Pose [4, 4] in `base_link` at `t` seconds after the start, where so many of these go by in a second.

        At another pace flights are as long as that makes them, and what flies falls as fast as ever.
        """
        from scipy.spatial.transform import Rotation  # loads slowly, and who only reads a scenario never asks

        values = self._values(t, pace)
        return pose(Rotation.from_euler("xyz", values[3:], degrees=True).as_matrix(), values[:3])

    def position(self, t: float, pace: float = 1.0) -> Float64:
        """Position [3] in `base_link` at `t` seconds after the start, m; `pace` as for `pose`."""
        place: Float64 = self._values(t, pace)[:3]
        return place

    def _values(self, t: float, pace: float) -> Float64:
        times = np.array(self.times_s)
        if self.repeat and t > times[-1] > times[0]:
            t = times[0] + (t - times[0]) % (times[-1] - times[0])
        t = float(np.clip(t, times[0], times[-1]))
        if len(times) == 1:
            only: Float64 = self._knots[0].copy()
            return only
        if self.between == "spline":
            return np.asarray(self._spline(t), dtype=np.float64)
        i = min(int(np.searchsorted(times, t, side="right")) - 1, len(times) - 2)
        duration = times[i + 1] - times[i]
        s = (t - times[i]) / duration
        share = s**3 * (10 - 15 * s + 6 * s**2) if self.between == "minimum_jerk" else s
        values: Float64 = self._knots[i] + share * (self._knots[i + 1] - self._knots[i])
        if self.between == "ballistic":
            values[2] += GRAVITY / 2 * (duration / pace) ** 2 * s * (1 - s)
        return values
