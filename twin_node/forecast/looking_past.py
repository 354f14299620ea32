"""Sight past what others measure: a camera looks into a mirror, through a pane, or from elsewhere than it should.

What a mirror shows is measured behind it. Who looks into one would free all of that, whoever stands there and is
measured from another side.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from twin_node.forecast.backdrops import STEP, STEP_SHARE
from twin_node.forecast.sights import Look
from twin_node.forecast.unprojection import points_at
from twin_node.geometry import project
from twin_node.scene import Bool, Float32, Grid, UInt8

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


class LookingPast:
    """Finds the pixels of depth cameras that do so, state by state."""

    def __init__(self, grid: Grid) -> None:
        self._grid = grid
        self._caught: dict[str, NDArray[np.int64]] = {}
        """Per camera, [H, W] when each pixel last did, ns."""
        self._turn = 0
        self._looked_at: int | None = None
        self.warnings: tuple[str, ...] = ()
        """What a reader must know as of the last state: one line per camera of which more than rims of things do so."""

    def of(self, looks: Sequence[Look], stamp: int) -> list[Bool | None]:
        """Per look at a state, [H, W] what must free nothing; None where all may. States come in rising order."""
        sights = [_DeepSight(look) for look in looks if look.view.depth is not None]
        standing = self._standing(len(sights), stamp)
        for number, sight in enumerate(sights):
            others = [other for other in sights if other is not sight]
            moves = _measured(sight.look, moving=True)
            for other, past in zip(others, self._seen_past(sight.look, moves, PATCH, others), strict=True):
                if past.any():
                    (whole,) = self._seen_past(sight.look, moves, 1, (other,))
                    self._catch(sight.look, whole, 1, other, stamp)
            if number == standing:
                stands = _measured(sight.look, moving=False)
                for other, past in zip(others, self._seen_past(sight.look, stands, PATCH, others), strict=True):
                    self._catch(sight.look, past, PATCH, other, stamp)
        doubted = [self._doubted(look, stamp) for look in looks]
        pairs = zip(looks, doubted, strict=True)
        told = [look for look, mask in pairs if mask is not None and mask.mean() >= TELLING_SHARE]
        self.warnings = tuple(f"forecast: camera {look.view.camera.name} {_LOOKS_PAST}" for look in told)
        return doubted

    def _standing(self, count: int, stamp: int) -> int | None:
        """Which camera's turn it is to be looked at for what stands."""
        if count and (self._looked_at is None or (stamp - self._looked_at) * count >= PERIOD_NS):
            self._looked_at = stamp
            self._turn += 1
            return self._turn % count
        return None

    def _seen_past(self, look: Look, where: Bool, every: int, others: Sequence[_DeepSight]) -> list[Bool]:
        """Which pixels, of every so manieth of `where` [H, W], measure what each of the others sees past."""
        sparse = where[::every, ::every]
        rows, columns = np.nonzero(sparse)
        if not len(rows):
            return [np.zeros_like(sparse)] * len(others)
        points = points_at(look.view, rows * every, columns * every)
        inside = self._grid.indices(points) >= 0
        found = []
        for other in others:
            past = np.zeros_like(sparse)
            past[rows, columns] = other.past(points).past & inside
            found.append(past)
        return found

    def _catch(self, look: Look, past: Bool, every: int, other: _DeepSight, stamp: int) -> None:
        """Remembers where another saw `past` what a look measures, by every so manieth of its pixels."""
        rows, columns = np.nonzero(cv2.morphologyEx(past.astype(np.uint8), cv2.MORPH_OPEN, _PATCH))
        if not len(rows):
            return
        seen = other.past(points_at(look.view, rows * every, columns * every))
        image = np.zeros(other.look.moving.shape, np.uint8)
        image[seen.rows, seen.columns] = 1
        camera = other.look.view.camera.name
        caught = self._caught.get(camera)
        if caught is None or caught.shape != image.shape:
            caught = self._caught[camera] = np.full(image.shape, _NEVER)
        caught[cv2.dilate(image, other.around) > 0] = stamp

    def _doubted(self, look: Look, stamp: int) -> Bool | None:
        caught = self._caught.get(look.view.camera.name)
        if caught is None or caught.shape != look.moving.shape or look.view.depth is None:
            return None
        doubted: Bool = stamp - caught <= HELD_NS
        return doubted if doubted.any() else None


def _measured(look: Look, moving: bool) -> Bool:
    """[H, W] where a look measures what moves, or all that it measures."""
    assert look.view.depth is not None and look.backdrop is not None
    known = look.view.depth > 0
    if moving:
        known &= look.moving & (look.view.depth < look.backdrop * np.float32(1 - STEP_SHARE) - np.float32(STEP))
    for hidden in (look.robot, None if look.view.valid is None else ~look.view.valid):
        if hidden is not None:
            known &= ~hidden
    return known


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

    def past(self, points: Float32) -> _Seen:
        """Which points [n, 3] it sees past."""
        camera = self.look.view.camera
        u, v, z = project(camera.K, camera.viewmat, points).T
        inside = (z > 0) & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
        columns, rows = (np.where(inside, along, 0).astype(np.int64) for along in (u, v))
        return _Seen(columns, rows, inside & (self.clear_until[rows, columns] > z * (1 + STEP_SHARE) + CLEAR_M))


class _Seen(NamedTuple):
    """Where a look has points."""

    columns: NDArray[np.int64]
    """[n]."""
    rows: NDArray[np.int64]
    """[n]."""
    past: Bool
    """[n] whether it sees past them."""
