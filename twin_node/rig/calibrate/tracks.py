"""Corners of a moving board between the images of one camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from twin_node.rig.calibrate.boards import Corners
from twin_node.scene import Float64

MAX_GAP = 1.6
"""Longest pause between two images that is interpolated over, in median periods: one lost image breaks a track."""


@dataclass(frozen=True)
class MovingCorners:
    """Corners of a board at one time, and how they move."""

    corners: Corners
    velocities: Float64 | None
    """[N, 2] pixels per second; None where nothing is known to move."""
    jitter_px: float = 0.0
    """1 sigma of what the corners are off by because stamps jitter and they move."""


class CornerTracks:
    """Places of the corners over time, of one camera: cubic splines through what was found."""

    def __init__(self, stamps: NDArray[np.int64], found: Sequence[Corners | None]) -> None:
        """`stamps` [T] ns, increasing; `found`: what each image shows."""
        seconds = (stamps - stamps[0]) / 1e9
        self._origin = int(stamps[0])
        periods = np.diff(seconds) if len(stamps) > 1 else np.zeros(1)
        self._period = float(np.median(periods))
        # A period has the jitter of two stamps; its median absolute deviation knows nothing of lost images.
        self._jitter = 1.4826 * float(np.median(np.abs(periods - self._period))) / np.sqrt(2)
        self._pieces: dict[int, list[CubicSpline]] = {}
        seen: dict[int, list[tuple[float, Float64]]] = {}
        for second, corners in zip(seconds.tolist(), found, strict=True):
            if corners is not None:
                for corner, pixel in zip(corners.ids.tolist(), corners.pixels, strict=True):
                    seen.setdefault(corner, []).append((second, pixel))
        for corner, places in seen.items():
            self._pieces[corner] = self._splines(np.array([t for t, _ in places]), np.array([p for _, p in places]))

    def at(self, stamp: int) -> MovingCorners | None:
        """The corners at a time, ns; None where no track goes through it."""
        second = (stamp - self._origin) / 1e9
        ids, pixels, velocities = [], [], []
        for corner, pieces in sorted(self._pieces.items()):
            for spline in pieces:
                if spline.x[0] <= second <= spline.x[-1]:
                    ids.append(corner)
                    pixels.append(spline(second))
                    velocities.append(spline(second, 1))
        if not ids:
            return None
        speed = float(np.median(np.linalg.norm(velocities, axis=1)))
        return MovingCorners(Corners(np.array(ids), np.stack(pixels)), np.stack(velocities), speed * self._jitter)

    def _splines(self, seconds: Float64, pixels: Float64) -> list[CubicSpline]:
        breaks = np.flatnonzero(np.diff(seconds) > MAX_GAP * self._period) + 1
        pieces = zip(np.split(seconds, breaks), np.split(pixels, breaks), strict=True)
        return [CubicSpline(t, p) for t, p in pieces if len(t) > 1]


class StillCorners:
    """Corners of a board that stood still, or that all cameras took at once: no image tells of other times."""

    def __init__(self, stamps: NDArray[np.int64], found: Sequence[Corners | None]) -> None:
        """`stamps` [T] ns: equal for images of one set; `found`: what each image shows."""
        self._found = dict(zip(stamps.tolist(), found, strict=True))

    def at(self, stamp: int) -> MovingCorners | None:
        """The corners at exactly this time, ns, without velocities; None where there is no image or no board in it."""
        corners = self._found.get(stamp)
        return None if corners is None else MovingCorners(corners, None)


CornerSource = CornerTracks | StillCorners
