"""Sight past what others measure: a camera looks into a mirror, through a pane, or from elsewhere than it should.

What a mirror shows is measured behind it. Who looks into one would free all of that, whoever stands there and is
measured from another side.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from twin_node.forecast.backdrops import STEP_SHARE, stands_out
from twin_node.forecast.sights import Look
from twin_node.forecast.unprojection import points_at
from twin_node.scene import Bool, Float32, Float64, Grid, UInt8
from twin_node.turns import Turns

CLEAR_M = 0.06
"""A point is seen past where so much about it is, m: rigs, clocks and edges err by less."""
HELD_NS = 2_000_000_000
"""For so long a pixel that has seen past something shows nothing, ns: until what stands has been looked at again."""
PERIOD_NS = 500_000_000
"""What a camera measures to stand is held against the others this often, one camera after the other, ns."""
PATCH = 3
"""Width in pixels that what is seen past has in the image that measures it: edges may be measured anywhere. Of what
stands, and of what moves at first, every so manieth pixel is looked at, across and down."""
TELLING_SHARE = 3e-3
"""Of an image: where fewer pixels see past something they are the rims of what moves."""
_LOOKS_PAST = (
    "sees past what other cameras measure, and frees nothing there: look for mirrors and glass, clocks that are off, "
    "and cameras out of place"
)
_NEVER = np.iinfo(np.int64).min // 2
_FAR = np.float32(1e6)
_PATCH = np.ones((PATCH, PATCH), np.uint8)
_ABOUT = np.ones((2 * PATCH - 1, 2 * PATCH - 1), np.uint8)


class LookingPast:
    """Finds the pixels of depth cameras that do so, state by state."""

    def __init__(self, grid: Grid) -> None:
        self._grid = grid
        self._caught: dict[str, NDArray[np.int64]] = {}
        """Per camera, [H, W] when each pixel last did, ns."""
        self._turns = Turns()
        self._looked_at: int | None = None
        self.warnings: tuple[str, ...] = ()
        """What a reader must know as of the last state: one line per camera of which more than rims of things do so."""

    def of(self, looks: Sequence[Look], stamp: int) -> list[Bool | None]:
        """Per look at a state, [H, W] what must free nothing; None where all may. States come in rising order."""
        sights = [_DeepSight(look) for look in looks if look.view.depth is not None]
        if len(sights) > 1:
            self._compare(sights, stamp)
        doubted = [self._doubted(look, stamp) for look in looks]
        pairs = zip(looks, doubted, strict=True)
        told = [look for look, mask in pairs if mask is not None and mask.mean() >= TELLING_SHARE]
        self.warnings = tuple(f"forecast: camera {look.view.camera.name} {_LOOKS_PAST}" for look in told)
        return doubted

    def _compare(self, sights: Sequence[_DeepSight], stamp: int) -> None:
        """Holds what moves, and in turn what stands, against all others."""
        moves = [_Measured(sight.look, _measured(sight.look, moving=True)) for sight in sights]
        for found in self._seen_past(moves, PATCH, sights):
            for whole in self._seen_past([found.surroundings()], 1, [found.by]):
                self._catch(whole, 1, stamp)
        if self._looked_at is None or (stamp - self._looked_at) * len(sights) >= PERIOD_NS:
            self._looked_at = stamp
            look = sights[self._turns.whose([sight.look.view.camera.name for sight in sights])].look
            self._turns.take([look.view.camera.name])
            for found in self._seen_past([_Measured(look, _measured(look, moving=False))], PATCH, sights):
                self._catch(found, PATCH, stamp)

    def _seen_past(self, measured: Sequence[_Measured], every: int, by: Sequence[_DeepSight]) -> Iterator[_SeenPast]:
        """Which pixels, of every so manieth, measure what each of `by` sees past; where there are any."""
        sparse = [np.ascontiguousarray(one.where[::every, ::every]) for one in measured]
        at = [np.flatnonzero(mask) for mask in sparse]
        points = np.concatenate(
            [
                _points(one, *np.divmod(own, mask.shape[1]), every)
                for one, own, mask in zip(measured, at, sparse, strict=True)
            ]
        )
        inside = np.flatnonzero(self._grid.indices(points) >= 0)
        points, ends = points[inside], np.cumsum([len(own) for own in at])
        for other in by if len(points) else ():
            past = np.zeros(ends[-1], np.bool_)
            past[inside[other.past(points).which]] = True
            for one, own, mask, of_one in zip(measured, at, sparse, np.split(past, ends[:-1]), strict=True):
                if of_one.any():
                    pixels = np.zeros_like(mask)
                    pixels.ravel()[own[of_one]] = True
                    yield _SeenPast(one, other, pixels)

    def _catch(self, found: _SeenPast, every: int, stamp: int) -> None:
        """Remembers where another saw past what a look measures, by every so manieth of its pixels."""
        rows, columns = np.nonzero(cv2.morphologyEx(found.past.astype(np.uint8), cv2.MORPH_OPEN, _PATCH))
        if not len(rows):
            return
        other = found.by
        image = np.zeros(other.look.moving.shape, np.uint8)
        image.ravel()[other.past(_points(found.measured, rows, columns, every)).pixels] = 1
        camera = other.look.view.camera.name
        caught = self._caught.get(camera)
        if caught is None or caught.shape != image.shape:
            caught = self._caught[camera] = np.full(image.shape, _NEVER)
        caught[cv2.dilate(image, other.around) > 0] = stamp

    def _doubted(self, look: Look, stamp: int) -> Bool | None:
        caught = self._caught.get(look.view.camera.name)
        if caught is None or caught.shape != look.moving.shape:
            return None
        doubted: Bool = stamp - caught <= HELD_NS
        return doubted if doubted.any() else None


class _Measured(NamedTuple):
    """What a look measures."""

    look: Look
    where: Bool
    """[H, W]."""


class _SeenPast(NamedTuple):
    """What one look measures and another sees past."""

    measured: _Measured
    by: _DeepSight
    past: Bool
    """[h, w] of every so manieth pixel of the former."""

    def surroundings(self) -> _Measured:
        """All pixels of patches of which one was looked at, every `PATCH`th, and is seen past."""
        look, where = self.measured
        near = np.zeros(where.shape, np.uint8)
        near[::PATCH, ::PATCH] = self.past
        return _Measured(look, where & (cv2.dilate(near, _ABOUT) > 0))


def _points(measured: _Measured, rows: NDArray[np.int64], columns: NDArray[np.int64], every: int) -> Float32:
    """Points [n, 3] of every so manieth pixel of a look."""
    return points_at(measured.look.view, rows * every, columns * every)


def _measured(look: Look, moving: bool) -> Bool:
    """[H, W] where a look measures what moves, or all that it measures."""
    assert look.view.depth is not None and look.backdrop is not None
    known = look.view.depth > 0
    if moving:
        known &= look.moving & stands_out(look.view.depth, look.backdrop)
    hidden = look.hidden
    return known if hidden is None else known & ~hidden


class _DeepSight:
    """How far one look with depth sees."""

    def __init__(self, look: Look) -> None:
        self.look = look
        side = 2 * round(CLEAR_M * look.table.pixels_per_metre + look.error_pixels) + 1
        self.around: UInt8 = np.ones((side, side), np.uint8)
        """Pixels of what must be clear about a point, and of what may be off."""

    @cached_property
    def clear_until(self) -> Float32:
        """[H, W] how far it sees, and everywhere near by, m; 0 near what it does not measure, but for single pixels."""
        view = self.look.view
        assert view.depth is not None
        hole = cv2.dilate((view.depth > 0).astype(np.uint8), _PATCH) == 0
        if view.valid is not None:
            hole |= ~view.valid
        far = np.where(view.depth > 0, view.depth, _FAR)
        far[hole] = 0
        return cv2.erode(far, self.around).astype(np.float32)

    @cached_property
    def _matrix(self) -> Float64:
        """[3, 4] from the base to pixels times depth, and depth."""
        camera = self.look.view.camera
        return np.asarray(camera.K @ camera.viewmat[:3])

    def past(self, points: Float32) -> _Past:
        """Which points [n, 3] it sees past."""
        camera, matrix = self.look.view.camera, self._matrix
        across, down, z = matrix[:, :3] @ points.T + matrix[:, 3:]
        inside = (across >= 0) & (across < camera.width * z) & (down >= 0) & (down < camera.height * z)
        which = np.flatnonzero(inside & (z > 0))
        z = z[which]
        pixels = (down[which] / z).astype(np.int64) * camera.width + (across[which] / z).astype(np.int64)
        deep = self.clear_until.ravel()[pixels] > z * (1 + STEP_SHARE) + CLEAR_M
        return _Past(which[deep], pixels[deep])


class _Past(NamedTuple):
    """Points that a look sees past."""

    which: NDArray[np.int64]
    """[m] of the points, in their order."""
    pixels: NDArray[np.int64]
    """[m] of its image, counted row by row."""
