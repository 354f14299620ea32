"""What one camera saw of a board over time, and where the board's corners were between its images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_node.rig.calibrate.boards import Corners
from twin_node.rig.calibrate.lenses import Lens
from twin_node.scene import Bool, Float64

MAX_GAP = 1.6
"""Longest pause between two images that is interpolated over, in median periods: one lost image breaks a track."""


@dataclass(frozen=True)
class CameraRecording:
    """What one camera saw of the board."""

    name: str
    size: tuple[int, int]
    """Width and height, pixels."""
    stamps: NDArray[np.int64]
    """[T] ns, increasing; equal numbers belong together where `moving` is False."""
    images: tuple[str, ...]
    """[T] what each image is called in messages."""
    found: tuple[Corners | None, ...]
    """[T] the board in each image."""
    moving: bool = True
    """Whether the corners may be interpolated between stamps (a video), or every image stands for itself (stills)."""
    lens: Lens | None = None
    """Where it is known already."""

    @property
    def period_s(self) -> float:
        """Median time between images, s; infinite for a single one."""
        return float(np.median(np.diff(self.stamps))) / 1e9 if len(self.stamps) > 1 else np.inf


class CornerTracks:
    """Places of the corners over time, of one camera: cubic Hermite pieces through what was found."""

    def __init__(self, stamps: NDArray[np.int64], found: Sequence[Corners | None]) -> None:
        """`stamps` [T] ns, increasing; `found`: what each image shows."""
        self._origin = int(stamps[0])
        self._times = (stamps - stamps[0]) / 1e9
        count = max(
            (int(corners.ids.max()) + 1 for corners in found if corners is not None and len(corners)), default=0
        )
        self._pixels = np.full((len(stamps), count, 2), np.nan)
        for place, corners in zip(self._pixels, found, strict=True):
            if corners is not None:
                place[corners.ids] = corners.pixels
        periods = np.diff(self._times)
        self._whole = periods <= MAX_GAP * np.median(periods) if len(periods) else np.zeros(0, bool)
        self._slopes = _slopes(self._pixels, periods, self._whole)

    def at(self, stamp: int) -> Corners | None:
        """The corners at a time, ns; None where no track goes through it."""
        time = (stamp - self._origin) / 1e9
        i = min(int(np.searchsorted(self._times, time, side="right")) - 1, len(self._times) - 2)
        if i < 0 or time > self._times[-1] or not self._whole[i]:
            return None
        period = self._times[i + 1] - self._times[i]
        u = (time - self._times[i]) / period
        pixels = (1 + 2 * u) * (1 - u) ** 2 * self._pixels[i] + u**2 * (3 - 2 * u) * self._pixels[i + 1]
        pixels += period * (u * (1 - u) ** 2 * self._slopes[i] - u**2 * (1 - u) * self._slopes[i + 1])
        ids = np.flatnonzero(np.isfinite(pixels).all(1))
        return Corners(ids, pixels[ids]) if len(ids) else None


def _slopes(pixels: Float64, periods: Float64, whole: Bool) -> Float64:
    """[T, P, 2] pixels per second at every image, of parabolas through it and its neighbours, or one of them."""
    between = np.diff(pixels, axis=0) / periods[:, None, None]
    between[~whole] = np.nan
    missing = np.full((1, *pixels.shape[1:]), np.nan)
    before, after = np.concatenate([missing, between]), np.concatenate([between, missing])
    ahead, behind = np.append(periods, 1.0)[:, None, None], np.insert(periods, 0, 1.0)[:, None, None]
    both = (before * ahead + after * behind) / (ahead + behind)
    return np.asarray(np.where(np.isfinite(both), both, np.where(np.isfinite(before), before, after)))


class StillCorners:
    """Corners of a board that stood still, or that all cameras took at once: no image tells of other times."""

    def __init__(self, stamps: NDArray[np.int64], found: Sequence[Corners | None]) -> None:
        """`stamps` [T] ns: equal for images of one set; `found`: what each image shows."""
        self._found = dict(zip(stamps.tolist(), found, strict=True))

    def at(self, stamp: int) -> Corners | None:
        """The corners at exactly this time, ns; None where there is no image or no board in it."""
        return self._found.get(stamp)


CornerSource = CornerTracks | StillCorners


def source_of(camera: CameraRecording) -> CornerSource:
    """A recording's corners by time."""
    source = CornerTracks if camera.moving else StillCorners
    return source(camera.stamps, camera.found)
