"""How long an arm takes to stop, and how far it goes meanwhile: tables per arm, measured at full reach and payload."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from twin_node.arm.errors import ArmError
from twin_node.scene import Float64

FASTEST_RAD_S = 15.0
"""No joint of an arm is faster: who gives more means degrees."""


@dataclass(frozen=True)
class Stop:
    """A stop from given joint speeds."""

    duration_s: float
    """From the arm's first braking to standstill."""
    travel_s: float
    """Distance gone meanwhile as a time at the speed before: metres per m/s, radians per rad/s."""


@dataclass(frozen=True)
class StoppingTable:
    """Stopping times and angles of joints at measured speeds.

    Between rows, and down to rest, the time and the angle per speed are linear: so they are under steady braking.
    """

    speeds: Float64
    """[R] rad/s, rising, above zero, at most `FASTEST_RAD_S`."""
    times: Float64
    """[R, J] s."""
    angles: Float64
    """[R, J] rad gone until standstill."""

    def __post_init__(self) -> None:
        """Raises `ArmError` for rows that do not rise or fit each other, for degrees, and for impossible values."""
        rows = len(self.speeds)
        shapes_fit = self.times.ndim == 2 and self.times.shape == self.angles.shape and len(self.times) == rows
        if rows == 0 or not shapes_fit or not np.diff(self.speeds, prepend=0.0).min() > 0:
            raise ArmError(
                f"stopping table: expected rising speeds [R] and times and angles [R, J], found "
                f"{self.speeds.tolist()}, {self.times.shape} and {self.angles.shape}; correct the table"
            )
        if not self.speeds[-1] <= FASTEST_RAD_S:
            raise ArmError(
                f"stopping table: expected speeds in rad/s, at most {FASTEST_RAD_S:g}, found {self.speeds[-1]:g}; "
                "divide degrees by 57.3, angles too"
            )
        values = np.concatenate([self.times, self.angles])
        if not (np.isfinite(values).all() and (values >= 0).all()):
            raise ArmError(
                f"stopping table: expected finite times and angles of 0 or more, found {values.tolist()}; correct the "
                "table"
            )

    def stop(self, speeds: NDArray[np.floating]) -> Stop:
        """The longest stop among the joints at speeds [J] (rad/s); speeds beyond the table go on along its last row.

        Raises `ArmError` for an arm of another number of joints than the table's.
        """
        magnitudes = np.abs(np.asarray(speeds, dtype=np.float64))
        if magnitudes.shape != self.times.shape[1:]:
            raise ArmError(
                f"stopping table: expected speeds of {self.times.shape[1]} joints, found {magnitudes.size}; give the "
                "arm a table of its own"
            )
        duration_s, travel_s = self._read(magnitudes)
        return Stop(float(duration_s), float(travel_s))

    def slower_of(self, other: StoppingTable) -> StoppingTable:
        """The table of an arm that stops by this one or by another, whichever is slower, joint by joint.

        Raises `ArmError` for tables of arms with different numbers of joints.
        """
        if self.times.shape[1] != other.times.shape[1]:
            raise ArmError(
                f"stopping table: expected one of {self.times.shape[1]} joints, found one of {other.times.shape[1]}; "
                "give the arm a table of its own"
            )
        speeds = np.union1d(self.speeds, other.speeds)
        times = np.maximum(self._at(self.times, speeds), other._at(other.times, speeds))
        travels = np.maximum(self._at(self._travels, speeds), other._at(other._travels, speeds))
        return StoppingTable(speeds, times, travels * speeds[:, None])

    def _at(self, columns: Float64, speeds: Float64) -> Float64:
        """The columns' values [R, J] at other speeds [S], as `stop` reads them: [S, J]."""
        within = np.stack([np.interp(speeds, self._knots, [0.0, *column]) for column in columns.T], axis=1)
        read: Float64 = within * np.maximum(speeds / self.speeds[-1], 1.0)[:, None]
        return read

    @cached_property
    def _travels(self) -> Float64:
        """[R, J] angles per speed, s."""
        return self.angles / self.speeds[:, None]

    @cached_property
    def _rows(self) -> Float64:
        """[2, R + 1, J] times and travels, s, from rest on."""
        rows = np.stack([self.times, self._travels])
        return np.concatenate([np.zeros_like(rows[:, :1]), rows], axis=1)

    @cached_property
    def _knots(self) -> Float64:
        """[R + 1] speeds of the rows from rest on, rad/s."""
        return np.concatenate([[0.0], self.speeds])

    def _read(self, speeds: Float64) -> Float64:
        """Largest time and travel [2] at speeds [J]; in proportion to speed below the first row and above the last."""
        joints, knots = np.arange(len(speeds)), self._knots
        after = np.minimum(self.speeds.searchsorted(speeds) + 1, len(self.speeds))
        low_speed, low = knots[after - 1], self._rows[:, after - 1, joints]
        share = (speeds - low_speed) / (knots[after] - low_speed)
        read = low + np.minimum(share, 1.0) * (self._rows[:, after, joints] - low)
        largest: Float64 = (read * np.maximum(speeds / knots[-1], 1.0)).max(axis=1, initial=0.0)
        return largest


def _from_base_shoulder_elbow(speed_deg: float, times_s: Float64, angles_rad: Float64) -> StoppingTable:
    """A one-row table; the wrists, which no manual lists, are lighter than the elbow and taken as slow as it."""
    row = [0, 1, 2, 2, 2, 2]
    return StoppingTable(np.deg2rad([speed_deg]), times_s[None, row], angles_rad[None, row])


_UR3 = _from_base_shoulder_elbow(183, np.array([0.159, 0.154, 0.092]), np.array([0.18, 0.20, 0.15]))
_UR5 = _from_base_shoulder_elbow(183, np.array([0.244, 0.530, 0.164]), np.array([0.31, 0.70, 0.22]))
_TABLES = {
    "ur3e": _UR3,
    "ur5e": _UR5,
    "ur10e": StoppingTable(_UR5.speeds, 2 * _UR5.times, 2 * _UR5.angles),
    "ur16e": StoppingTable(_UR5.speeds, 2 * _UR5.times, 2 * _UR5.angles),
}


def stopping_table(arm: str, joints: int = 6) -> StoppingTable:
    """Stopping data of an arm by its name and number of joints; the UR5e's, doubled, for an arm without data.

    Source: user manuals of the UR3 (3.10) and UR5 (3.4.5), appendix A.1: stop category 0, full reach, full payload,
    downwards. For the e-Series UR publishes plots only; its UR3e and UR5e are taken to stop as their predecessors. For
    arms that are larger or carry more twice the UR5's times and angles are assumed: measure them, or set the
    controller's stopping-time limit and enter that. Where an arm has not six joints, nobody knows which is its
    shoulder: all stop as late as that one.
    """
    table = _TABLES.get(arm, _TABLES["ur10e"])
    if joints == table.times.shape[1]:
        return table
    slowest = (values.max(axis=1, keepdims=True).repeat(joints, axis=1) for values in (table.times, table.angles))
    return StoppingTable(table.speeds, *slowest)
