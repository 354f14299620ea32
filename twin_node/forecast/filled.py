"""Depth that no camera measured: filled in around a hole, behind somebody whom colours alone show.

Filters of depth cameras fill what these did not measure, dark cloth and hair above all, with what stands beside it, the
farthest as a rule. It would then free all space before the ground, the person's own too. Light that changes on the
ground looks likewise in one image; but who sees that ground from elsewhere sees it change as well, where behind
somebody it is as it was.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from twin_node.forecast.backdrops import UNSEEN, Backdrops, stands_out
from twin_node.forecast.sights import LEAST_BLANK, Look
from twin_node.forecast.unprojection import points_at
from twin_node.geometry import project
from twin_node.scene import Bool, Float32, TwinState

SAME_SHARE, SAME_M = 0.03, 0.03
"""Two cameras see the same place where their depths of it differ by no more than this share of it, plus this, m."""
LEAST_OF, MOST_OF = 3e-3, 0.5
"""Of an image: what seems to change in less of it is the rim of what moves, and in more of it is its exposure."""
_Window = tuple[slice, slice]
"""Rows and columns of an image."""
_CROSS = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
_AROUND = np.ones((5, 5), np.uint8)
"""What changes in one image is looked for so far about its place in another."""


class FilledDepth:
    """Finds it, state by state."""

    def __init__(self) -> None:
        self._passed: dict[str, Bool] = {}
        """Per camera, [H, W] where something moves and another depth has been measured meanwhile than of what stood
        there: it has come or gone, and ground that is measured since is believed."""

    def update(self, state: TwinState, backdrops: Backdrops) -> None:
        """Takes in what a state measures of what moves, beside `backdrops` that have not taken it in yet.

        States come in rising order of stamps.
        """
        for view, moving in zip(state.frames.views, state.moving_masks, strict=True):
            if view.depth is None:
                continue
            passed = np.zeros_like(moving)
            window = _window(moving, 1)
            depth, backdrop, within = view.depth[window], backdrops.of(view)[window], moving[window]
            other = within & (depth > 0) & (backdrop < UNSEEN)
            other &= stands_out(depth, backdrop) | stands_out(backdrop, depth)
            if other.any():  # single ones are noise
                passed[window] = cv2.morphologyEx(other.astype(np.uint8), cv2.MORPH_OPEN, _CROSS)
            before = self._passed.get(view.camera.name)
            if before is not None and before.shape == moving.shape:
                passed |= before & moving
            self._passed[view.camera.name] = passed

    def without(self, looks: Sequence[Look]) -> list[Look]:
        """The looks at the last state, with depth unknown where another look tells that it was filled in."""
        measured = [look for look in looks if look.view.depth is not None]
        if len(measured) < 2:
            return list(looks)
        found = [_blobs(look, self._passed.get(look.view.camera.name)) for look in looks]
        if not any(map(len, found)):
            return list(looks)
        unchanged = [_unchanged(look) for look in measured]
        pairs = list(zip(measured, unchanged, strict=True))
        return [
            _without_filled(look, blobs, [pair for pair in pairs if pair[0] is not look]) if len(blobs) else look
            for look, blobs in zip(looks, found, strict=True)
        ]


@dataclass(frozen=True)
class _Blobs:
    """Ground that seems to change in an image, in blobs that may be somebody."""

    rows: NDArray[np.int64]
    """[n] of their pixels."""
    columns: NDArray[np.int64]
    """[n]."""
    numbers: NDArray[np.int64]
    """[n] of the blob that each is of, from 1 on."""

    def __len__(self) -> int:
        """How many pixels there are."""
        return len(self.rows)


def _blobs(look: Look, passed: Bool | None) -> _Blobs:
    """Of a look, but for what has `passed` [H, W]; none of one without depth."""
    nothing = _Blobs(*np.zeros((3, 0), np.int64))
    if look.view.depth is None:
        return nothing
    window = _window(look.moving)
    ground = _ground(look, window)
    if passed is not None and passed.shape == look.moving.shape:
        ground &= ~passed[window]
    if np.count_nonzero(ground) < LEAST_BLANK:
        return nothing
    _, labels, stats, _ = cv2.connectedComponentsWithStats(ground.astype(np.uint8))
    shares = stats[:, cv2.CC_STAT_AREA] / look.moving.size
    rows, columns = np.nonzero(ground & ((shares >= LEAST_OF) & (shares <= MOST_OF))[labels])
    return _Blobs(rows + window[0].start, columns + window[1].start, labels[rows, columns].astype(np.int64))


def _unchanged(look: Look) -> Bool:
    """[H, W] where a look tells that all is as it was."""
    hidden = look.hidden
    changed = look.moving if hidden is None else look.moving | hidden
    unchanged: Bool = cv2.dilate(changed.astype(np.uint8), _AROUND) == 0
    return unchanged


def _without_filled(look: Look, blobs: _Blobs, others: Sequence[tuple[Look, Bool]]) -> Look:
    """A look with depth, beside others and where these are unchanged.

    Each blob of ground that seems to change is light or somebody, as most of what others see of that ground tells.
    """
    points = points_at(look.view, blobs.rows, blobs.columns)
    bare, lit = np.zeros((2, len(points)), np.bool_)
    for other, unchanged in others:
        seen, same = _seen(other, points, unchanged)
        bare |= seen & same
        lit |= seen & ~same
    bare &= ~lit
    count = blobs.numbers.max() + 1
    bares, lits = (np.bincount(blobs.numbers[told], minlength=count) for told in (bare, lit))
    filled = (bares > lits)[blobs.numbers]
    if not filled.any():
        return look
    assert look.view.depth is not None
    depth = look.view.depth.copy()
    depth[blobs.rows[filled], blobs.columns[filled]] = 0
    return replace(look, view=replace(look.view, depth=depth))


def _ground(look: Look, window: _Window) -> Bool:
    """[h, w] where, in a window of a look with depth, something moves and what stands there is measured."""
    assert look.view.depth is not None and look.backdrop is not None
    depth = look.view.depth[window]
    ground: Bool = look.moving[window] & (depth > 0)
    ground &= ~stands_out(depth, look.backdrop[window])
    hidden = look.hidden
    return ground if hidden is None else ground & ~hidden[window]


def _window(mask: Bool, rim: int = 0) -> _Window:
    """Rows and columns that hold all of a mask [H, W] and `rim` more; none where it is empty."""
    left, top, width, height = cv2.boundingRect(mask.astype(np.uint8))
    return slice(max(top - rim, 0), top + height + rim), slice(max(left - rim, 0), left + width + rim)


def _seen(look: Look, points: Float32, unchanged: Bool) -> tuple[Bool, Bool]:
    """[n] which points a look measures, and which lie where it is `unchanged` [H, W]."""
    assert look.view.depth is not None
    u, v, z = project(look.view.camera.K, look.view.camera.viewmat, points).T
    height, width = unchanged.shape
    inside = (z > 0) & (u >= 0) & (u < width) & (v >= 0) & (v < height)
    rows, columns = (np.where(inside, along, 0).astype(np.int64) for along in (v, u))
    depth = look.view.depth[rows, columns]
    seen = inside & (depth > 0) & (np.abs(depth - z) <= SAME_SHARE * z + SAME_M)
    if look.view.valid is not None:
        seen &= look.view.valid[rows, columns]
    return seen, unchanged[rows, columns]
